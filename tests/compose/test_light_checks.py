"""The layer ``light``: each fault of the mock has its bit, sound scenes have none, and recordings suffice."""

import json

import numpy as np
import pytest
from support.datasets import made

import mock_server
import omniscv
from omniscv import dataset
from omniscv.cli import run
from omniscv.compose.files import read
from omniscv.compose.light_checks import BITS
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.sources.recording import RecordedSource, Recording
from omniscv.sources.scene import open_scene

CAMERA = omniscv.cameras.create("equirectangular", 128, 64)
POSE = Pose.from_angles((0.3, -0.2, 1.45), yaw_deg=20)
MODES = ("lit", "object_mask", "depth")


def examined(source, **options):
    return omniscv.render(CAMERA, POSE, source, MODES, **{"checks": "light", "face_size": 128, **options})


def served(scene, *faults, drawn_only="", **options):
    """An image of a server with faults, and optionally with an object that is drawn, not annotated."""
    with mock_server.serve(scene, faults=faults) as server, omniscv.open_source(server.uri) as source:
        if drawn_only:
            source.objects()
            server.world.objects[drawn_only].annotated = False
        return examined(source, **options)


@pytest.mark.parametrize(
    ("scene", "faults"),
    [("open", []), ("four-wall", ["tone=film", "object-missing=Sofa"])],  # annotated when its colour is set
)
def test_a_sound_scene_has_no_bit(scene, faults):
    image = served(scene, *faults)
    assert image["light"].dtype == np.uint8
    assert image.provenance["light"] == {"objects": {}, "untested": {}}
    assert not image["light"].any()


def test_glass_is_translucent_and_an_object_without_annotation_a_mismatch():
    with omniscv.open_source("scene://four-wall?traces=0") as source:
        sofa = examined(source, checks="none")["labels"] == source.objects().label("Sofa")
    for bit, image in (
        ("translucent", served("four-wall", "glass=Sofa")),
        ("mismatch", served("four-wall", drawn_only="Sofa")),
    ):
        assert image.provenance["light"]["objects"] == {bit: {"Sofa": ["only colours show it"]}}
        at = (image["light"] & BITS[bit]) > 0
        assert (at & sofa).sum() > 0.8 * sofa.sum()
        assert (at & ~sofa).sum() < 0.4 * sofa.sum()  # pixels at its outline, a quarter of it, are mixed


def test_depth_outside_the_box_of_its_object_is_a_mismatch():
    image = served("four-wall", "depth-scale=0.1", face_size=192)
    assert {*np.unique(image["light"])} == {0, BITS["mismatch"]}
    assert ((image["light"] & BITS["mismatch"]) > 0).mean() > 0.9


def test_codes_at_the_ends_are_clipped():
    """A vignette that leaves no light in the corners of faces."""
    image = served("four-wall", "vignette=1", face_size="auto")
    clipped = (image["light"] & BITS["clipped"]) > 0
    extreme = ((image["lit"] == 0) | (image["lit"] == 255)).any(axis=-1)
    assert 0 < clipped.mean() < 0.05
    assert (extreme & ~clipped).sum() == 0


def test_a_dome_is_the_sky_by_two_signs_or_by_its_name():
    with omniscv.open_source("scene://open?traces=0") as source:
        true = examined(source, checks="none", face_size=160)
    sky = np.isinf(true["depth"])
    image = served("open", "sky-dome=100", face_size=160)
    signs = image.provenance["light"]["objects"]["dome"]["SkyDome"]
    assert signs == ["its name", "a sphere around the camera", "it follows the camera"]
    dome = (image["light"] & BITS["dome"]) > 0
    assert (dome != sky).mean() < 0.005  # at outlines
    for layer in ("depth", "labels", "depth_error", "object_mask"):
        np.testing.assert_array_equal(image[layer][dome & sky], true[layer][dome & sky])
    named = served("open", "sky-dome=300", checks="none", sky=("SkyDome",))
    assert "light" not in named.layers
    assert np.isinf(named["depth"]).any()
    with pytest.raises(ArgumentError, match="sky: expected objects of the scene, got 'Cloud'"):
        served("open", sky=("Cloud",))


def test_a_recording_gives_the_same_bits_and_says_what_it_lacks(tmp_path):
    """What ``omniscv record`` captures for a panorama serves other cameras at its place, too."""
    faults = "fault=glass=Sofa&fault=gloss=Layout_Floor"
    record = ["record", "--source", f"mock://four-wall?{faults}", "--position", "0.3,-0.2,1.45"]
    size = ["--set", "face_size=64", "--out", str(tmp_path / "checked.sqlite")]
    assert run([*record, *size, "--set", "checks=light"]) == 0
    with omniscv.open_source(f"mock://four-wall?{faults}") as source:
        online = examined(source, face_size=64)
    assert online.provenance["light"]["objects"].keys() == {"translucent", "view_dependent"}
    at = (online["light"] & BITS["view_dependent"]) > 0
    assert {online.objects.label("Layout_Floor")} == {*np.unique(online["labels"][at])}
    assert "strategy exact" in online.provenance["light"]["objects"]["view_dependent"]["Layout_Floor"][0]
    with RecordedSource(tmp_path / "checked.sqlite") as source:
        offline = examined(source)
    np.testing.assert_array_equal(online["light"], offline["light"])
    assert online.provenance["light"] == offline.provenance["light"]
    with Recording(open_scene("scene://four-wall"), tmp_path / "plain.sqlite") as source:
        examined(source, checks="none")
    with RecordedSource(tmp_path / "plain.sqlite") as source:
        image = examined(source)
    assert not image["light"].any()
    assert "view_dependent" in image.provenance["light"]["untested"]


def test_the_layer_stands_in_files_and_in_the_record_of_a_frame(tmp_path):
    more = "checks: light\nsky: []\n"
    folder = made(tmp_path, source="scene://four-wall?traces=0", more=more)
    frame = dataset.open(folder)[0]
    bits = frame.layer("light")
    assert bits.dtype == np.uint8
    assert bits.shape == frame.valid.shape
    report = json.loads(frame.files["image"].read_text())
    assert report["options"]["checks"] == "light"
    assert report["light"]["objects"] == {}
    np.testing.assert_array_equal(read(frame.files["light"], "light"), bits)
