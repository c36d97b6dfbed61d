"""Worlds that are varied, and several of them in one dataset."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from support.datasets import image, tree

import mock_server
import omniscv
from mock_server.dialects.common import Dialect
from omniscv import make
from omniscv.dataset.checking import check, info
from omniscv.errors import ArgumentError, SourceError
from omniscv.geometry.scene_geometry import ObjectBox
from omniscv.job import load, sampling
from omniscv.job.vary import draw, read_value, uniform
from omniscv.make.frames import left_out

CAMERA = {"model": "equirectangular", "width": 32, "height": 16}
NEAR = {"shift": {"box": [[-0.3, -0.3, 0], [0.3, 0.3, 0.2]]}}
VARY = {"seed": 7, "objects": {"Ball": NEAR, "Lamp": {"shown": 0.5}, "Sofa": {"turn_deg": [0, 360]}}}


def job(out, **keys):
    description = {
        "source": "scene://four-wall",
        "cameras": {"pano": CAMERA},
        "poses": [{"position": [0.1 * i, 0, 1.2]} for i in range(4)],
        "modes": ["lit", "object_mask", "depth"],
        "truth": {"boxes": True, "boxes3d": True},
        "strategy": "cube",
        "face_size": 32,
        "out": str(out),
        "vary": VARY,
    }
    return load({key: value for key, value in (description | keys).items() if value is not None})


def test_draws_are_hashes_of_what_they_are_for_and_other_values_are_refused():
    lamp = uniform(7, "kitchen", "lights.power", "Lamp", "000000")
    assert lamp == 0.34552899183329333
    assert uniform(7, "kitchen", "lights.power", "Lamp", "000001") == 0.20661940424652303
    assert uniform(7, "kitchen", "objects.turn_deg", "Chair_1", "000000") == 0.8350593442706253
    assert uniform(8, "kitchen", "lights.power", "Lamp", "000000") == 0.41445890517668393
    known = {
        151.30101689665148: [20, 400],
        56.30845074012775: {"log": [20, 400]},
        -0.3974197094875909: {"normal": [0, 1]},
        5.0: {"choice": [4, 5, 6]},
        3.0: 3,
    }
    for expected, value in known.items():
        drawn = draw(read_value("power", value), lambda _: lamp)
        assert drawn == pytest.approx(expected, rel=1e-14)  # libraries differ in the last digit
    for other in ([1, 2, 3], [2, 1], "a", {"exp": [1, 2]}, {"log": [0, 1]}, {"choice": []}):
        with pytest.raises(ArgumentError, match=r"^power"):
            read_value("power", other)


def frames_of(out):
    return {frame.key: frame for frame in omniscv.dataset.open(out)}


@pytest.mark.parametrize("source", ["scene", "mock"])
def test_images_and_truth_show_the_world_that_was_drawn(tmp_path, source):
    """What is drawn is placed by hand in a scene of its own, which is traced."""
    size = {"scene": "auto", "mock": 64}[source]
    poses = [{"position": [0, 0, 1.2]}]
    make.make(job(tmp_path / "d", source=f"{source}://four-wall", face_size=size, poses=poses))
    (frame,) = frames_of(tmp_path / "d").values()
    drawn = frame.varied["objects"]
    room = mock_server.load_scene("four-wall")
    angle = np.radians(drawn["Sofa"]["turn_deg"])
    turned = [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    ball = room.pose("Ball")[1] + drawn["Ball"]["shift"]
    placed = room.at(0, {"Ball": (np.eye(3), ball), "Sofa": (turned, room.pose("Sofa")[1])})
    hidden = () if drawn["Lamp"]["shown"] else ("Lamp",)
    camera = frame.camera
    pose = frame.pose
    rays = camera.unproject(camera.pixels())
    hits = placed.trace(pose.position, rays.directions @ pose.rotation.T, hidden)
    # A server takes decimals of a centimetre: a pixel at an edge may go either way.
    assert np.mean(frame.layer("labels") != hits.label) < (0.01 if source == "mock" else 1e-9)
    np.testing.assert_allclose(frame.truth["poses"]["Ball"]["position"], ball, atol=1e-4)
    assert frame.truth["varied"] == frame.varied
    for box in frame.truth["boxes3d"]:
        if box["name"] == "Ball":
            center_w = pose.rotation @ box["center_camera"] + pose.position
            np.testing.assert_allclose(center_w, ball, atol=1e-4)


def test_further_rules_change_no_other_draw_and_a_recording_replays_them(tmp_path):
    poses = [{"position": [0.1 * i, 0, 1.2]} for i in range(2)]
    record = {"source": "mock://four-wall", "record": str(tmp_path / "r.sqlite")}
    make.make(job(tmp_path / "a", poses=poses, **record))
    more = {**VARY, "objects": {"Picture*": {"shift": {"choice": [[0, 0, 0.1]]}}, **VARY["objects"]}}
    make.make(job(tmp_path / "b", poses=poses, vary=more))
    make.make(job(tmp_path / "c", poses=poses, source=str(tmp_path / "r.sqlite")))
    a, b, c = (frames_of(tmp_path / name) for name in "abc")
    for key, frame in a.items():
        assert frame.varied["objects"].items() <= b[key].varied["objects"].items()
        assert c[key].varied == frame.varied
        assert c[key].truth == frame.truth
        np.testing.assert_array_equal(c[key].layer("lit"), frame.layer("lit"))
    assert len({frame.state for frame in a.values()}) == 2


def test_places_and_worlds_are_drawn_once(tmp_path):
    poses = [{"position": [x, 0, 1.2]} for x in (0, 0.1, 1, 1.1)]
    for per, worlds in (("place", 2), ("world", 1)):
        some = {"vary": {**VARY, "per": per}, "poses": poses, "split": {"train": 1.0}}
        make.make(job(tmp_path / per, **MASKS | some))
        assert len({json.dumps(frame.varied) for frame in frames_of(tmp_path / per).values()}) == worlds


def test_objects_keep_their_clearance(tmp_path):
    near = {"box": [[-1.5, -1.5, 0], [1.5, 1.5, 0]]}
    names = ("Ball", "Sofa")
    rule = {name: {"shift": near, "turn_deg": [0, 360], "clearance": 0.2} for name in names}
    with omniscv.open_source("scene://four-wall") as source:
        made = job(tmp_path, vary={"objects": rule})
        draws = make.source.draws_of(made, source)
        for i in range(20):
            instant = omniscv.Instant.drawn(draws.of(str(i)))
            with source.at(instant) as moved:
                boxes = moved.geometry().boxes
                corners = [boxes[name].corners_w() for name in names]
                (low, high), (least, most) = ((c.min(axis=0), c.max(axis=0)) for c in corners)
                apart = np.maximum(low - most, least - high)
                assert np.linalg.norm(np.maximum(apart, 0)) >= 0.2 - 1e-9
        rule["Ball"]["clearance"] = 100
        far = make.source.draws_of(job(tmp_path, vary={"objects": rule}), source)
        with pytest.raises(ArgumentError, match="Sofa: expected a free place, got none in 50 draws"):
            far.of("0")


def test_what_cannot_be_varied_is_refused_before_the_first_capture(tmp_path):
    for vary, match in (
        ({"lights": {"Sun": {"power": 1}}}, "a source that varies lights, got scene.*varies objects"),
        ({"objects": {"Stool_*": {"shown": 0.5}}}, "expected objects of the source, got none; it has .*Ball"),
        ({"objects": {"Ball": {"size": 2}}}, "unknown key 'size'; known keys: shift"),
        ({"objects": {"Ball": {"shift": 2}}}, "vary.objects.Ball.shift"),
        ({"lights": {"Sun": {"command": "vbp {name} {watts}"}}}, "only the words name in .*watts"),
    ):
        with pytest.raises(ArgumentError, match=match):
            make.make(job(tmp_path / "d", vary=vary))
        assert not (tmp_path / "d").exists()


@pytest.mark.parametrize("dialect", ["M", "N3"])
def test_commands_carry_what_was_drawn_and_a_reply_of_an_error_fails_the_frame(
    tmp_path, monkeypatch, dialect
):
    sent = []
    command = "vbp {name} set_light {roll} {yaw} 0 {power} 255 255 255"
    light = {"command": command, "power": [20, 400], "roll": 0.5, "yaw": {"choice": [90]}}
    some = {**MASKS, "vary": {"seed": 7, "lights": {"Sun": light}}, "failures": {"skip": 0.5}}

    def run_function(self, actor, function, *words):
        sent.append((actor, function, *words))
        return "error Fail to execute" if len(sent) == 2 else None

    monkeypatch.setattr(Dialect, "run_function", run_function)
    with mock_server.serve("four-wall", size=(16, 16), dialect=dialect) as server:
        assert make.make(job(tmp_path / "d", source=server.uri, **some)).failed == 1
    frames = frames_of(tmp_path / "d")
    powers = [round(frame.varied["lights"]["Sun"]["power"], 6) for frame in frames.values()]
    assert [power for words in sent if (power := float(words[5])) in powers] == powers
    assert {words[:5] for words in sent} == {("Sun", "set_light", "0.5", "90", "0")}
    (line,) = (tmp_path / "d" / "failed.jsonl").read_text().splitlines()
    assert "Fail to execute" in json.loads(line)["error"]


# -- several worlds --------------------------------------------------------------------------------------

WORLDS = {
    "four": {"source": "scene://four-wall"},
    "six": {"source": "scene://six-wall", "poses": [{"position": [x, 0.5, 1.2]} for x in (0.5, 1.5, 1.7)]},
    "test": {"source": "scene://four-wall", "split": "test"},
}
SOME = {"worlds": WORLDS, "source": None, "split": {"train": 0.5, "val": 0.5, "by": "world"}}
MASKS = {"modes": ["object_mask"], "truth": {"boxes": True}}


def test_shards_and_limits_give_the_same_bytes(tmp_path):
    some = {**SOME, **MASKS, "vary": None}
    make.make(job(tmp_path / "whole", **some))
    whole = tree(tmp_path / "whole")
    for index in (2, 0, 1):
        last = make.make(job(tmp_path / "shards", **some), shard=(index, 3))
    assert last.missing == 0
    assert tree(tmp_path / "shards") == whole
    make.make(job(tmp_path / "limit", **some), limit=5)
    part = tree(tmp_path / "limit")
    assert all(part[name] == whole[name] for name in part if name != "frames.jsonl")
    lines = (tmp_path / "limit" / "frames.jsonl").read_text().splitlines()
    assert len(lines) == 5
    assert set(lines) < set((tmp_path / "whole" / "frames.jsonl").read_text().splitlines())
    make.make(job(tmp_path / "limit", **some), existing="resume")
    assert tree(tmp_path / "limit") == whole


def test_worlds_have_their_own_poses_splits_names_and_draws(tmp_path):
    cameras = {"pano": {"width": {"choice": [32, 48]}}}
    vary = {"seed": 3, "objects": {"Door": {"turn_deg": [0, 90]}}, "cameras": cameras}
    made = job(tmp_path / "d", **{**SOME, **MASKS}, vary=vary)
    make.make(made)
    frames = frames_of(tmp_path / "d")
    counts = {"four": 4, "six": 3, "test": 4}
    assert sorted(frames) == [f"{name}-pano-{i}" for name, count in counts.items() for i in range(count)]
    split_of = {}
    for key, frame in frames.items():
        world = key.partition("-")[0]
        assert split_of.setdefault(world, frame.split) == frame.split
        assert frame.place.startswith(f"{world}/")
        assert (frame.camera_name, frame.camera.width in (32, 48)) == (f"{world}-pano", True)
    assert split_of.pop("test") == "test"
    assert {*split_of.values()} <= {"train", "val"}
    assert frames["four-pano-0"].varied != frames["test-pano-0"].varied
    shown = info(tmp_path / "d")
    assert set(shown["varied"]) == {"objects.turn_deg"}
    assert not check(tmp_path / "d", deep=True)


def test_a_world_may_vary_what_the_others_do_not_have(tmp_path):
    worlds = {name: dict(WORLDS[name]) for name in ("four", "six")}
    some = {**SOME, **MASKS, "worlds": worlds, "vary": {"objects": {"Vase": {"turn_deg": [0, 90]}}}}
    with pytest.raises(ArgumentError, match=r"worlds\.six: vary\.objects\.Vase: expected objects"):
        make.make(job(tmp_path / "none", **some))
    worlds["six"]["vary"] = {"objects": {"Ball": {"turn_deg": [0, 90]}}}
    make.make(job(tmp_path / "d", **some))
    for frame in frames_of(tmp_path / "d").values():
        assert [*frame.varied["objects"]] == ["Vase" if frame.place.startswith("four/") else "Ball"]
    assert make.make(job(tmp_path / "d", **some), existing="resume").written == 0
    worlds["six"]["vary"] = None
    with pytest.raises(ArgumentError, match=r"options\.vary_of_worlds\.six"):
        make.make(job(tmp_path / "d", **some), existing="resume")


def test_a_world_that_dies_fails_its_frames_only_and_resume_tries_them_again(tmp_path, monkeypatch):
    some = {**SOME, **MASKS, "vary": None}
    make.make(job(tmp_path / "whole", **some))
    capture = make.source.open_sources
    dead = {"scene://six-wall"}

    def open_sources(addresses, **options):
        if dead & set(addresses):
            raise SourceError("the game has ended")
        return capture(addresses, **options)

    monkeypatch.setattr(make.source, "open_sources", open_sources)
    for skip in (0, 0.2):
        with pytest.raises(SourceError, match="the game has ended"):
            make.make(job(tmp_path / f"{skip}", **some, failures={"skip": skip}))
    kept = job(tmp_path / "d", **some, failures={"skip": 0.3})
    made = make.make(kept)
    assert (made.written, made.failed) == (8, 3)
    lines = [json.loads(line) for line in (tmp_path / "d" / "failed.jsonl").read_text().splitlines()]
    told = [(line["key"], line["world"], line["error"]) for line in lines]
    assert told == [(f"six-pano-{i}", "six", "the game has ended") for i in range(3)]
    assert info(tmp_path / "d")["failed"] == 3
    assert not check(tmp_path / "d")
    dead.clear()
    assert make.make(kept, existing="resume").written == 3
    assert not (tmp_path / "d" / "failed.jsonl").exists()
    assert len(frames_of(tmp_path / "d")) == 11


def test_wrong_worlds_are_refused(tmp_path):
    for keys, match in (
        ({"source": "scene://four-wall"}, "worlds: expected worlds by name, in place of source, got both"),
        ({"worlds": {"a": {"sauce": 1}}}, "worlds.a: unknown key 'sauce'"),
        ({"worlds": {"a.b": {}}}, "worlds"),
        ({"worlds": None, "source": "scene://four-wall"}, "split.by: expected place"),
    ):
        with pytest.raises(ArgumentError, match=match):
            job(tmp_path, **(SOME | keys))
    with pytest.raises(ArgumentError, match="worlds: expected one world here; 'omniscv dataset make'"):
        make.run(job(tmp_path, **SOME))


def test_two_frames_of_one_key_are_refused_before_the_first_capture(tmp_path):
    """World hall-left with camera eye, and world hall with camera left-eye: eight frames, six files."""
    worlds = {name: {"source": "scene://nowhere"} for name in ("hall", "hall-left")}
    some = {"cameras": {"left-eye": CAMERA, "eye": CAMERA}, "worlds": worlds, "source": None, "vary": None}
    with pytest.raises(ArgumentError, match="hall-left-eye-0: expected a key of one frame, got"):
        make.make(job(tmp_path / "d", **some))
    with omniscv.dataset.Writer(tmp_path / "w") as writer:
        writer.refuse(["a"])
        with pytest.raises(ArgumentError, match="expected one that no other frame has"):
            writer.add("A", image(width=8))


# -- the watch -------------------------------------------------------------------------------------------


@pytest.mark.timeout(7200)
@pytest.mark.parametrize("count", [10, pytest.param(10_000, marks=pytest.mark.soak)])
def test_objects_that_vanish_are_found_and_no_others(tmp_path, count):
    """What a frame should show is what it shows without the fault."""
    low, high = (-1.5, -1.2, 0.8), (1.5, 1.2, 1.8)
    places = np.random.default_rng(4).uniform(low, high, (count, 3)).tolist()
    camera = {"pano": {**CAMERA, "width": 64, "height": 32}}
    some = {"vary": None, "truth": None, "modes": ["object_mask", "depth"], "cameras": camera}
    some["poses"] = [{"position": place} for place in places]
    lines = []
    with mock_server.serve("four-wall", size=(32, 32), faults=["vanishing@0.02"]) as server:
        make.make(job(tmp_path / "d", source=server.uri, watch="mark", **some), warn=lines.append)
        gone = {tuple(np.round(place, 1)): names for place, names in reversed(server.world.vanished)}
        few = some | {"poses": some["poses"][:6], "failures": {"skip": 1}}
        failed = make.make(job(tmp_path / "f", source=server.uri, watch="fail", **few)).failed
        server.faults.stop("vanishing")
        make.make(job(tmp_path / "whole", source=server.uri, **some))
    found = due = marked = 0
    whole = frames_of(tmp_path / "whole")
    for key, frame in list(frames_of(tmp_path / "d").items())[1:]:  # before the first, the server is probed
        names = gone[tuple(np.round(100 * frame.pose.position * (1, -1, 1), 1))]
        shown = np.bincount(whole[key].layer("labels").ravel(), minlength=100)
        # A capture that was repeated, as after a late reply, may show what the first one left out.
        here = set(frame.layer("labels").flat)
        ids = {name: whole[key].instances[name] for name in names}
        expected = {name for name, label in ids.items() if shown[label] >= 4 and label not in here}
        assert expected <= set(frame.watch) <= names
        found = found + len(frame.watch)
        due = due + len(expected)
        marked = marked + bool(frame.watch)
    assert found >= due > count / 10
    lines_of_failed = (tmp_path / "f" / "failed.jsonl").read_text().splitlines()
    errors = [json.loads(line)["error"] for line in lines_of_failed]
    assert 0 < len(errors) == failed < 6
    assert all(error.startswith("watch: expected ") for error in errors)
    assert any(line.startswith("watch: the world has left objects out of") for line in lines)


def test_what_only_a_second_look_leaves_out_does_not_show_what_was_behind_it():
    """The door's frame is less than a thousandth farther than the door."""
    room = mock_server.load_scene("four-wall")
    pose = omniscv.Pose.from_angles((1.3427, -0.0273, 1.5102))
    camera = omniscv.cameras.create("equirectangular", width=64, height=32)
    rays = camera.unproject().directions @ pose.R_w_c.T

    def image(*hidden):
        hits = room.trace(pose.position, rays.reshape(-1, 3), hidden=frozenset(hidden))
        layers = {"depth": hits.distance.astype(np.float32), "labels": hits.label.astype(np.uint16)}
        maps = {name: layer.reshape(32, 64) for name, layer in layers.items()}
        return SimpleNamespace(camera=camera, pose=pose, **maps)

    names = sorted(room.objects, key=room.label)
    boxes = {name: ObjectBox.of(*room.box(name), "scene") for name in names}
    labels = {name: room.label(name) for name in names}

    def watched(first, again):
        seen = SimpleNamespace(rendered=lambda: first, layer=first.__getattribute__, instances=labels)
        seen.geometry = SimpleNamespace(boxes=boxes)
        return left_out(seen, names, lambda: again)

    assert room.label("Door_Frame") in image("Door").labels
    assert watched(image(), image("Door")) == ()
    assert watched(image("Door_Frame", "Vase"), image("Door")) == ("Vase",)
    assert watched(image("Door"), image()) == ("Door",)


# -- poses that show something ---------------------------------------------------------------------------


def test_poses_show_what_is_to_be_visible_or_fail(tmp_path, monkeypatch):
    monkeypatch.setattr(sampling, "_LOOKS", 8)
    camera = {"model": "pinhole", "width": 48, "height": 36, "fov_deg": 70}
    some = {"vary": None, "truth": None, "modes": ["object_mask"], "cameras": {"front": camera}}
    some["classes"] = {"rules": [{"match": "Chair_*", "class": "chair"}], "unmatched": "other"}
    room = mock_server.load_scene("four-wall")
    chairs = [room.label(name) for name in room.objects if name.startswith("Chair_")]

    def shares(out, share, count, **keys):
        box = {"count": count, "low": [-1.5, -1.2, 1.2], "high": [1.5, 1.2, 1.6], "clearance": 0.2}
        poses = {"random": {**box, "start": [0, 0, 1.5], "visible": {"class": "chair", "share": share}}}
        made = make.make(job(tmp_path / out, poses=poses, **some, **keys))
        for frame in frames_of(tmp_path / out).values():
            rays = frame.camera.unproject(frame.camera.pixels()).directions @ frame.pose.R_w_c.T
            yield np.isin(room.trace(frame.pose.position, rays).label, chairs).mean()
        assert made.written + made.failed == count

    assert min(shares("d", 0.05, 3)) > 0.045  # counted on a panorama of 256 px
    assert not list(shares("e", 0.9, 1, failures={"skip": 1}))
    (line,) = (tmp_path / "e" / "failed.jsonl").read_text().splitlines()
    assert json.loads(line)["error"].startswith("expected a pose that shows 0.9 of chair, got 0")
    box = {"low": [0, 0, 1], "high": [0, 0, 1], "clearance": 0.1, "count": 1}
    visible = {"random": {**box, "visible": {"class": "stool", "share": 0.1}}}
    with pytest.raises(ArgumentError, match=r"poses\.visible\.class: expected a class .*stool"):
        make.make(job(tmp_path / "f", poses=visible, **some))
