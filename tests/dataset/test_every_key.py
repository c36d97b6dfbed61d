"""Every key of a job is changed between two runs: refused by its name, or as if it had always been so.

The keys are those of docs/job.md, found by walking the schema. A new key needs a line in ``CHANGES``.
"""

import copy

import pytest
from support.datasets import tree

from omniscv.errors import OmniscvError
from omniscv.job import keys, load
from omniscv.job.file import overridden
from omniscv.make import make

CAMERAS = {
    "pano": {"model": "equirectangular", "width": 32, "height": 16},
    "lens": {"model": "fisheye-equidistant", "width": 16, "height": 16, "fov_deg": 180},
}
STILL = {
    "source": "scene://four-wall",
    "cameras": CAMERAS,
    "poses": [{"position": [0, 0, 1.5]}, {"position": [0.8, 0.2, 1.4], "yaw_deg": 40}],
    "modes": ["lit", "object_mask", "depth"],
    "face_size": 16,
    "out": "made",
}


def base(**more):
    return {**STILL, **more}


RULES = {"rules": [{"match": "Ball", "class": "ball"}, {"match": "*", "class": "thing"}]}
RANDOM = {"count": 2, "low": [-1, -1, 1.2], "high": [1, 1, 1.8], "clearance": 0.2}
PATH = {"waypoints": [[-1, 0, 1.5], [1, 0.3, 1.5], [0, -0.8, 1.5]], "speed": 1, "rate": 1, "look": "level"}
PLACES = [{"position": [0.01 * i, 0, 1.2], "time": i / 2} for i in range(3)]
MOTION = [{"time": 0, "position": [-2, -0.6, 0.85]}, {"time": 1, "position": [-1.2, 0.8, 0.85]}]
BASES = {
    "still": STILL,
    "live": base(source="mock://four-wall?dialect=N2", modes=["lit"]),
    "files": base(poses={"file": "path.tum", "frame": "camera", "unit": "m"}),
    "random": base(poses={"random": RANDOM}, classes=RULES),
    "grid": base(poses={"grid": {"low": [0, 0, 1.5], "high": [0.5, 0, 1.5], "step": 0.5}}),
    "path": base(poses={"path": PATH}),
    "rig": base(rig={"cameras": {"left": {"camera": CAMERAS["lens"], "position": [0.1, 0, 0]}}}),
    "moving": base(
        source="scene://workshop", poses=PLACES, times=[0.0, 0.5], motions={"Cabinet": MOTION}, modes=["lit"]
    ),
    "exposed": base(
        source="scene://workshop", poses=PLACES, times=[0.2, 0.5], motions={"Cabinet": MOTION}, modes=["lit"],
        exposure={"seconds": 0.1, "instants": 3},
    ),
    "sensor": base(sensor={"seed": 0}),
    "imu": base(poses={"path": {**PATH, "rate": 4}}, imu={"rate": 100, "seed": 0}, modes=["lit"]),
    "vary": base(vary={"seed": 0, "objects": {"Ball": {"shift": {"box": [[-0.1, -0.1, 0], [0.1, 0.1, 0]]}}}}),
    "truth": base(truth={"boxes": True, "boxes3d": True, "layout": True}),
    "split": base(split={"train": 0.5, "test": 0.5}),
    "accurate": base(accuracy=0.05),
}  # fmt: skip

CHANGES = {
    "source": ("still", "scene://six-wall"),
    "poses": ("still", [{"position": [0, 0, 1.5]}, {"position": [0.7, 0.2, 1.4], "yaw_deg": 40}]),
    "poses.file": ("files", "other.tum"),
    "poses.frame": ("files", "body"),
    "poses.unit": ("files", "cm"),
    "poses.random.count": ("random", 3),
    "poses.random.low": ("random", [-0.9, -1, 1.2]),
    "poses.random.high": ("random", [0.9, 1, 1.8]),
    "poses.random.clearance": ("random", 0.4),
    "poses.random.start": ("random", [0.1, 0, 1.5]),
    "poses.random.seed": ("random", 1),
    "poses.random.yaw_deg": ("random", [0, 90]),
    "poses.random.pitch_deg": ("random", 5),
    "poses.random.roll_deg": ("random", 5),
    "poses.random.visible": ("random", {"class": "ball", "share": 0.001}),
    "poses.grid.low": ("grid", [0.1, 0, 1.5]),
    "poses.grid.high": ("grid", [1.0, 0, 1.5]),
    "poses.grid.step": ("grid", 0.25),
    "poses.grid.yaws_deg": ("grid", [30]),
    "poses.grid.clearance": ("grid", 0.1),
    "poses.grid.start": ("grid", [0.2, 0, 1.5]),
    "poses.path.waypoints": ("path", [[-1, 0, 1.5], [1, 0.4, 1.5], [0, -0.8, 1.5]]),
    "poses.path.speed": ("path", 1.5),
    "poses.path.rate": ("path", 2),
    "poses.path.closed": ("path", True),
    "poses.path.look": ("path", [0, 0, 0]),
    "cameras": ("still", {**CAMERAS, "pano": {**CAMERAS["pano"], "width": 40}}),
    "out": ("still", "elsewhere"),
    "modes": ("still", ["lit", "depth"]),
    "record": ("still", "room.sqlite"),
    "source_options": ("still", {"transfer": "srgb"}),
    "source_options.timeout_s": ("live", 16),
    "source_options.patience_s": ("live", 11),
    "source_options.retries": ("live", 6),
    "source_options.transfer": ("live", "linear"),
    "source_options.fix_exposure": ("live", True),
    "source_options.exposure": ("live", 1.0),
    "source_options.warmup": ("live", 1),
    "freeze": ("live", "pause"),
    "rig": ("rig", {"cameras": {"left": {"camera": CAMERAS["lens"], "position": [0.2, 0, 0]}}}),
    "image_format": ("still", "jpg"),
    "depth_format": ("still", "npy"),
    "store": ("still", "fast"),
    "motions": ("moving", {"Cabinet": [MOTION[0], {**MOTION[1], "yaw_deg": 60}]}),
    "times": ("moving", [0.0, 0.6]),
    "epoch": ("moving", 100),
    "exposure": ("moving", {"seconds": 0.1, "instants": 3}),
    "exposure.seconds": ("exposed", 0.2),
    "exposure.instants": ("exposed", 5),
    "exposure.camera": ("exposed", "rests"),
    "brackets": ("live", [-1, 1]),
    "sensor": ("still", {"seed": 1}),
    "sensor.preset": ("sensor", "imx250"),
    "sensor.seed": ("sensor", 1),
    "sensor.electrons": ("sensor", 5000),
    "sensor.exposure_s": ("sensor", 0.02),
    "sensor.full_well": ("sensor", 5000),
    "sensor.dark_current": ("sensor", 50),
    "sensor.read_noise": ("sensor", 2),
    "sensor.row_noise": ("sensor", 1),
    "sensor.prnu": ("sensor", 0.01),
    "sensor.dsnu": ("sensor", 1),
    "sensor.gain": ("sensor", 0.3),
    "sensor.black_level": ("sensor", 10),
    "sensor.bits": ("sensor", 10),
    "sensor.mosaic": ("sensor", "rggb"),
    "sensor.shading": ("sensor", "natural"),
    "sensor.lateral": ("sensor", [0.001, -0.001]),
    "sensor.blur": ("sensor", 0.5),
    "sensor.glare": ("sensor", 0.01),
    "imu": ("path", {"rate": 100}),
    "imu.rate": ("imu", 50),
    "imu.position": ("imu", [0.1, 0, 0]),
    "imu.yaw_deg": ("imu", 5),
    "imu.pitch_deg": ("imu", 5),
    "imu.roll_deg": ("imu", 5),
    "imu.gravity": ("imu", [0, 0, -9.8]),
    "imu.gyroscope": ("imu", {"bias": 0.1}),
    "imu.accelerometer": ("imu", {"bias": 0.1}),
    "imu.seed": ("imu", 1),
    "imu.gyroscope.bias": ("imu", 0.1),
    "imu.gyroscope.noise_density": ("imu", 0.1),
    "imu.gyroscope.random_walk": ("imu", 0.1),
    "imu.accelerometer.bias": ("imu", 0.1),
    "imu.accelerometer.noise_density": ("imu", 0.1),
    "imu.accelerometer.random_walk": ("imu", 0.1),
    "vary": ("still", {"objects": {"Ball": {"turn_deg": [0, 360]}}}),
    "vary.seed": ("vary", 1),
    "vary.per": ("vary", "world"),
    "vary.objects": ("vary", {"Ball": {"turn_deg": [0, 360]}}),
    "vary.lights": ("vary", {"Lamp": {"intensity": [1, 2]}}),
    "vary.materials": ("vary", {"Ball": {"roughness": [0, 1]}}),
    "vary.cameras": ("vary", {"lens": {"fov_deg": [170, 180]}}),
    "worlds": ("still", {"one": {"source": "scene://four-wall"}, "two": {"source": "scene://six-wall"}}),
    "failures": ("still", {"skip": 0.5}),
    "failures.skip": ("still", 0.5),
    "classes": ("still", RULES),
    "truth": ("still", {"boxes": True}),
    "truth.tolerance.abs_m": ("truth", 0.5),
    "truth.tolerance.rel": ("truth", 0.5),
    "export": ("still", ["coco"]),
    "split": ("still", {"train": 0.5, "test": 0.5}),
    "split.distance_m": ("split", 2.0),
    "split.seed": ("split", 1),
    "split.by": ("split", "world"),
    "split.rule": ("split", "hash"),
    "media": ("still", {"xmp": True}),
    "media.xmp": ("still", True),
    "media.north": ("still", 30),
    "watch": ("still", "mark"),
    "strategy": ("still", "cube"),
    "viewpoints": ("still", 4),
    "face_size": ("still", 32),
    "filter": ("still", "nearest"),
    "truth_scale": ("still", 2),
    "normals": ("still", "from-depth"),
    "color_rays": ("still", 4),
    "seams": ("still", "gains"),
    "straighten": ("still", True),
    "checks": ("still", "light"),
    "unseen": ("still", "blank"),
    "sky": ("still", ["Ball"]),
    "accuracy": ("still", 0.05),
    "most_captures": ("accurate", 100),
    "most_megapixels": ("accurate", 10),
    "capture_ms": ("still", [6, 20]),
}

OF_FRAMES = ("poses", "times", "epoch", "rig", "motions", "exposure", "split")
"""Keys that show in the lines of frames: a difference of them names the frame, and what it has otherwise."""


def test_every_key_is_tried():
    assert {key.name for key in keys()} == CHANGES.keys()


@pytest.mark.soak
@pytest.mark.timeout(600)
@pytest.mark.parametrize("state", ["complete", "interrupted"])
@pytest.mark.parametrize("key", CHANGES)
def test_a_key_that_changes_between_two_runs(key, state, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, lift in (("path.tum", 1.5), ("other.tum", 1.4)):
        rows = (f"{i} {0.2 * i} 0 {lift} 0.5 -0.5 0.5 -0.5\n" for i in range(3))
        (tmp_path / name).write_text("".join(rows), encoding="utf-8")
    name, value = CHANGES[key]
    before = copy.deepcopy(BASES[name])
    after = overridden(before, {key: value})
    if key == "worlds":
        after.pop("source")
    make(load(before))
    if state == "interrupted":
        last = sorted((tmp_path / "made").glob("*-1*.json"))[-1].stem
        for path in [tmp_path / "made" / "frames.jsonl", *(tmp_path / "made").glob(f"{last}.*")]:
            path.unlink()
    left = tree(tmp_path / "made")
    message = refusal(after)
    if message:
        assert is_named(key, message)
        assert tree(tmp_path / "made") == left
        return
    fresh = load({**after, "out": "fresh", **({"record": "fresh.sqlite"} if key == "record" else {})})
    make(fresh)
    assert tree(tmp_path / after["out"]) == tree(tmp_path / "fresh")


def refusal(description):
    """Continue a dataset by a job; return why it is refused, an empty text if it is not."""
    try:
        make(load(description), existing="resume")
    except OmniscvError as refused:
        return refused.message
    return ""


def is_named(key, message):
    """Whether a line names a key, or a frame with what it has by that key."""
    if key.partition(".")[0] in OF_FRAMES and "its frame " in message:
        return True
    if key.endswith("cameras") and "its camera '" in message:
        return True
    return any(word in message for word in (key, key.rpartition(".")[2], f"{key.partition('.')[0]}."))
