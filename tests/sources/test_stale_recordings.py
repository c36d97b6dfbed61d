"""Pictures of another view in a recording: depth and masks contradict each other."""

from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.faces import CENTER, face_requests

import omniscv
from omniscv.sources.recording.inspection import verify
from omniscv.sources.recording.replay import in_words
from omniscv.sources.recording.store import Store

MODES = ("depth", "object_mask")
REQUESTS = [each for center in (CENTER, (-0.9, 0.4, 1.2)) for each in face_requests(64, MODES, center)]


def halved(capture):
    """Depth as half floats have it."""
    if capture.mode != "depth":
        return capture
    return replace(capture, pixels=capture.pixels.astype(np.float16).astype(np.float32), payload=None)


def record(scene, path, *stale):
    """Record twelve faces; of each stale request, the picture of the one before it."""
    with omniscv.open_source(f"scene://{scene}") as source, closing(Store(path, write=True)) as store:
        store.set_objects(source.objects())
        before = None
        for capture in map(halved, source.capture(REQUESTS)):
            old = capture.request in stale
            store.add(replace(capture, pixels=before.pixels, payload=None) if old else capture)
            before = capture
    return path


@pytest.mark.parametrize("scene", ["six-wall", "fence", "open"])
def test_captures_of_sound_scenes_do_not_contradict(scene, tmp_path):
    """Also where several views show nothing but sky, and half floats round depth."""
    assert verify(record(scene, tmp_path / "sound.sqlite")).faults == []


@pytest.mark.parametrize("name", ["four-wall", "living-room"])
def test_captures_of_unreal_and_blender_do_not_contradict(name):
    assert verify(Path("captures") / f"{name}.sqlite").faults == []


@pytest.mark.parametrize("mode", MODES)
def test_a_picture_from_before_is_a_fault(mode, tmp_path):
    """Not that of the first face of a centre, before which there is one of the other mode."""
    of_mode = [each for each in REQUESTS if each.mode == mode]
    faults = verify(record("four-wall", tmp_path / "stale.sqlite", of_mode[2], of_mode[9])).faults
    for fault, i in zip(faults, (2, 9), strict=True):
        own, before = (in_words(of_mode[j].view) for j in (i, i - 1))
        assert fault.endswith(f": {mode} of {own}: expected its own picture, got that of {before}")
