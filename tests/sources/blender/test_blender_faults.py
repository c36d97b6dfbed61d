"""Faults of Blender, of its process and of its scenes: one clear sentence, and nothing captured is lost."""

import json
import os
import pickle
import re

import numpy as np
import OpenImageIO
import psutil
import pytest
from support import blender
from support.faces import face_requests
from support.recordings import contents

import omniscv
from omniscv.diagnostics.doctor import examine_address
from omniscv.errors import ArgumentError, BadReplyError, DeadlineError, OmniscvError, SourceError
from omniscv.job import load
from omniscv.make import costs, run
from omniscv.sources.blender import INSIDE, blender_command

SIZE = 8
FACES = 3
ALL = face_requests(SIZE, ("lit", "object_mask", "depth", "normals"))
REQUESTS = [request for number, request in enumerate(ALL) if number % 6 < FACES]
RENDERS = 2 * FACES  # each view once for its colours and once for its data


@pytest.fixture(autouse=True)
def no_blender_of_the_machine(monkeypatch):
    monkeypatch.delenv("OMNISCV_BLENDER", raising=False)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    recorded(blender.fake(folder), folder / "room.sqlite")
    assert len(blender.renders(folder)) == RENDERS
    return contents(folder / "room.sqlite")


def recorded(address, path, **options):
    with omniscv.open_source(address, **options) as live, omniscv.record(live, path) as source:
        source.objects()
        list(source.capture(REQUESTS))


def test_without_blender_the_error_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", "")
    (tmp_path / "room.blend").touch()
    with pytest.raises(
        SourceError, match=r"found neither; install Blender 5.0 or later \(pip inst.* or name"
    ):
        omniscv.open_source(f"blender://{tmp_path / 'room.blend'}")


def test_blender_is_named_by_the_environment_or_found_on_the_path(tmp_path, monkeypatch):
    program = tmp_path / "blender"
    program.write_text("")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert blender_command()[0] == str(program)
    assert blender_command()[-2:] == ["--python", str(INSIDE)]
    python = tmp_path / "python3"
    python.hardlink_to(program)
    monkeypatch.setenv("OMNISCV_BLENDER", str(python))
    assert blender_command() == [str(python), "-P", str(INSIDE)]
    assert blender_command(str(program))[0] == str(program)
    monkeypatch.setenv("OMNISCV_BLENDER", "no-such-blender")
    with pytest.raises(ArgumentError, match=r"blender: expected a program .*, got 'no-such-blender'"):
        blender_command()


WRONG = {
    "samples=0": "samples: expected a whole number >= 1, got 0",
    "samples=many": "expected a value of samples, got 'many'",
    "denoiser=optix": "denoiser: expected optix only with device=cuda or device=optix, got device=cpu",
    "clip=5": "expected a value of clip, got '5'",
    "clip=5..1": "clip: expected a finite number > 5 and <= 1000000000, got 1",
    "processes=0": "processes: expected a whole number >= 1, got 0",
    "spp=3": "expected options among .*samples.*, got 'spp'",
}


def test_wrong_options_and_a_missing_scene_are_refused_before_anything_starts(tmp_path):
    (tmp_path / "room.blend").touch()
    none = r"expected a \.blend file, but there is none at"
    for rest, says in (("none.blend?", none), *((f"room.blend?{query}&", WRONG[query]) for query in WRONG)):
        with pytest.raises(ArgumentError, match=says) as error:
            omniscv.open_source(f"blender://{tmp_path}/{rest}blender=no-such")
        assert len(str(error.value)) <= 300


def test_a_program_that_is_not_blender_is_one_clear_sentence(tmp_path):
    program = tmp_path / "blender"
    program.write_text("#!/bin/sh\necho nonsense; echo no such option >&2; exit 3\n")
    program.chmod(0o755)
    (tmp_path / "room.blend").touch()
    wanted = "expected Blender to start, but it ended with code 3. Its last output: no such option"
    with pytest.raises(SourceError, match=wanted):
        omniscv.open_source(f"blender://{tmp_path / 'room.blend'}?blender={program}")


STRANGE = {
    r"expected Blender 5.0 or later, got 4.2.3 of .*blender": {"version": "4.2.3"},
    "expected Blender to open the scene, got: not a blend file": {"refuse_scene": "not a blend file"},
    "no version": {"hello": {}},
    "another version": {"hello": {"version": "five"}},
    "noise without end": {"noise": -1},
    "a FIFO as a linked file": {"opened": {"libraries": ["FIFO"]}},
    "what it was not asked for": {"opened": {"secret": 1}},
}


@pytest.mark.parametrize(("says", "faults"), STRANGE.items(), ids=STRANGE)
def test_a_program_that_answers_nonsense_is_one_clear_sentence_and_is_ended(says, faults, tmp_path):
    os.mkfifo(tmp_path / "fifo")
    faults = json.loads(json.dumps(faults).replace("FIFO", str(tmp_path / "fifo")))
    before = set(psutil.Process().children())
    with pytest.raises(OmniscvError) as error:
        omniscv.open_source(blender.fake(tmp_path, **faults), retries=0)
    assert len(str(error.value).splitlines()) == 1
    assert not says.startswith("expected") or re.search(f"^room.blend: {says}", str(error.value))
    assert set(psutil.Process().children()) == before


@pytest.mark.parametrize(
    "boxes", [5, {"Floor": 1}, {"Floor": [[0], [[1]], []]}, {"Floor": [[0] * 3, [[1e300] * 3] * 3, [1] * 3]}]
)
def test_boxes_that_are_none_are_one_clear_sentence(boxes, tmp_path):
    with (
        omniscv.open_source(blender.fake(tmp_path, boxes=boxes), retries=0) as source,
        pytest.raises(BadReplyError, match="expected Blender to measure its objects, got another reply: "),
    ):
        source.geometry()


def test_much_noise_is_skipped_and_a_scene_without_a_world_is_a_warning(tmp_path, caplog):
    """A byte costs as much as the one before, or this does not end."""
    omniscv.open_source(blender.fake(tmp_path, world=False, noise=1_000_000)).close()
    assert caplog.messages == ["room.blend: the scene has no world: pixels without an object are black"]


def test_killed_in_every_render_it_completes_with_equal_bytes(whole, tmp_path):
    numbers = [0, 2, 3, 7]
    recorded(blender.fake(tmp_path, kill=numbers), tmp_path / "room.sqlite")
    assert len(blender.renders(tmp_path)) == RENDERS + len(numbers)
    assert contents(tmp_path / "room.sqlite") == whole


def test_a_reply_that_is_wrong_once_is_made_again(whole, tmp_path):
    faults = ["garbage", "small", "no_picture", "unknown", "fifo", "link"]
    address = blender.fake(tmp_path, **{fault: [2 * number] for number, fault in enumerate(faults)})
    recorded(address, tmp_path / "room.sqlite")
    assert len(blender.renders(tmp_path)) == RENDERS + len(faults)
    assert contents(tmp_path / "room.sqlite") == whole


def test_it_gives_up_after_some_faults_in_a_row_and_what_was_captured_stays(whole, tmp_path):
    path = tmp_path / "room.sqlite"
    says = "expected Blender to render 8 x 8 px, but it was killed, as when memory runs out.*after 2 attempts"
    with pytest.raises(SourceError, match=says) as error:
        recorded(blender.fake(tmp_path, kill=[*range(3, 5)]), path, retries=1)
    assert len(str(error.value)) <= 300
    before = contents(path)[0]
    assert len(before) == 3
    recorded(blender.fake(tmp_path), path)
    assert contents(path) == whole
    assert before.items() <= whole[0].items()
    assert len(blender.renders(tmp_path)) == RENDERS + 2


def test_what_hangs_is_ended_at_its_deadline(tmp_path):
    says = "expected Blender to render 8 x 8 px within 1 s, got nothing; raise timeout_s.*after 1 attempts"
    refused = pytest.raises(DeadlineError, match=says)
    with omniscv.open_source(blender.fake(tmp_path, hang=[0]), timeout_s=1, retries=0) as source, refused:
        list(source.capture(REQUESTS))


def test_what_blender_refuses_is_not_tried_again(tmp_path):
    with omniscv.open_source(blender.fake(tmp_path, refuse=[1])) as source:
        with pytest.raises(SourceError, match="to render 8 x 8 px, got: Error: Out of memory"):
            list(source.capture(REQUESTS))
        assert len(blender.renders(tmp_path)) == 2
        assert len(list(source.capture(REQUESTS[:2]))) == 2  # it is still there


def test_a_scene_that_was_saved_anew_meanwhile_is_refused(tmp_path):
    with omniscv.open_source(blender.fake(tmp_path, kill=[1])) as source:
        next(iter(source.capture(REQUESTS)))
        blender.fake(tmp_path, kill=[1], content="ANOTHER")
        with pytest.raises(SourceError, match="that was opened first, got one that was changed"):
            list(source.capture(REQUESTS))


def test_the_scene_is_known_by_its_bytes(tmp_path):
    for name in ("a", "b", "c"):
        (tmp_path / name).mkdir()
    addresses = [blender.fake(tmp_path / name, content=what) for name, what in zip("abc", "xxy", strict=True)]
    found = []
    for address in addresses:
        with omniscv.open_source(address) as source:
            found.append(source.scene_identity)
    assert found[0] == found[1]
    assert found[0].differs(found[2])
    assert (found[0].name, found[0].level) == ("room", "Scene, frame 1")


def test_several_processes_share_the_work(whole, tmp_path):
    recorded(blender.fake(tmp_path) + "&processes=2", tmp_path / "room.sqlite")
    assert contents(tmp_path / "room.sqlite") == whole


def test_a_view_is_rendered_once_for_all_its_data_and_again_without_objects(tmp_path):
    with omniscv.open_source(blender.fake(tmp_path)) as source:
        shown = [capture.pixels for capture in source.capture(REQUESTS)]
        assert sorted(blender.renders(tmp_path)) == ["data"] * FACES + ["lit"] * FACES
        with source.without(["Floor"]) as hidden:
            empty = list(hidden.capture(REQUESTS[FACES : 2 * FACES]))
        assert all((capture.pixels == 0).all() for capture in empty)
        again = [capture.pixels for capture in source.capture(REQUESTS)]
        assert all(np.array_equal(a, b) for a, b in zip(shown, again, strict=True))
        with pytest.raises(ArgumentError, match="expected objects of the scene, got 'Wall'"):
            source.without(["Wall"])


def test_a_job_renders_a_scene_that_lies_beside_it(tmp_path):
    address = blender.fake(tmp_path).replace(f"{tmp_path}/room", "room")
    (tmp_path / "job.yaml").write_text(
        f"source: {address}\nmodes: [lit, depth]\nposes: [{{position: [0, 0, 1.5]}}]\n"
        "cameras: {pano: {model: equirectangular, width: 16, height: 8}}\n"
    )
    job = load(tmp_path / "job.yaml")
    assert costs(job)
    assert blender.renders(tmp_path) == []
    run(job)
    depth = OpenImageIO.ImageBuf(str(tmp_path / "out" / "pano.depth.exr")).get_pixels()
    assert np.isinf(depth[0]).all()
    assert depth[-1] == pytest.approx(1.5, abs=0.1)


def test_the_doctor_finds_what_would_spoil_captures(tmp_path):
    address = blender.fake(tmp_path, world=False, missing=["/wood.png"])
    findings = {each.name: each for each in examine_address(address, np.array([0, 0, 1.5]))}
    assert {name: each.verdict for name, each in findings.items() if each.verdict != "ok"} == {
        "linked files": "bad",
        "light": "warning",
    }
    assert findings["linked files"].value == "1 missing, /wood.png"
    assert findings["Blender"].value == "5.0.1; Scene, frame 1"
    with pytest.raises(ArgumentError, match="patience: expected none for Blender"):
        examine_address(address, patience_s=3)


def test_it_belongs_to_the_process_that_opened_it(tmp_path):
    with omniscv.open_source(blender.fake(tmp_path)) as source:
        with pytest.raises(SourceError, match="expected a source that can be pickled"):
            pickle.dumps(source)
        if (child := os.fork()) == 0:  # noqa: TID251
            try:
                source.objects()
                source.close()
                os._exit(1)
            except OmniscvError as error:
                source.close()
                os._exit(0 if "got a fork of that process; open it again there" in str(error) else 2)
        assert os.waitpid(child, 0)[1] == 0
        assert len(list(source.capture(REQUESTS[:2]))) == 2
