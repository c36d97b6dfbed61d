"""EXR of several layers, as Blender writes them: depth and ids beside colours come in, all else is named."""

import json

import numpy as np
import OpenImageIO
import pytest
from support.pictured import AT, FACES, SCENE, face, judge, panorama, run, seen

from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.sources.pictures import read_picture

POSE = Pose.from_angles(AT)
PLACE = ("--position", ",".join(map(str, AT)))
EVERY = ("lit", "depth", "object_mask")


def layered(path, lit, depth, labels, *, kind="float", more=()):
    """Write Blender's layers; colours are taken as light."""
    path.parent.mkdir(parents=True, exist_ok=True)
    channels = {f"ViewLayer.Combined.{name}": lit[..., i] / 255 for i, name in enumerate("RGB")}
    channels["ViewLayer.Combined.A"] = np.ones(depth.shape)
    channels["ViewLayer.Depth.Z"] = np.where(np.isfinite(depth), depth, 1e10 if kind == "float" else np.inf)
    channels["ViewLayer.IndexOB.X"] = labels
    for name in more:
        channels[name] = np.zeros(depth.shape)
    write(path, channels, kind)


def write(path, channels, kind="float"):
    pixels = np.stack([*channels.values()], axis=-1).astype(np.float32)
    spec = OpenImageIO.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], kind)
    spec.channelnames = tuple(channels)
    output = OpenImageIO.ImageOutput.create(str(path))
    assert output.open(str(path), spec)
    assert output.write_image(pixels)
    output.close()


CRYPTO = [f"ViewLayer.CryptoObject00.{name}" for name in "rgba"]
NORMAL = [f"ViewLayer.Normal.{name}" for name in "XYZ"]


def names(tmp_path):
    """JSON of the objects by the tracer's labels."""
    (tmp_path / "names.json").write_text(json.dumps(["nothing", *sorted(SCENE.objects)]))
    return ["--names", tmp_path / "names.json"]


@pytest.mark.parametrize("kind", ["float", "half"])
def test_six_faces(kind, tmp_path, capsys):
    for word in FACES:
        layered(tmp_path / f"f/{word}.exr", *seen(face(POSE, word, 64)), kind=kind)
    assert run(tmp_path / "f", tmp_path / "a.sqlite", *PLACE, *names(tmp_path)) == 0
    out = capsys.readouterr().out
    assert "6 of depth are layers of the files of colours" in out
    assert "6 of object_mask are layers of the files of colours" in out
    judge_light(tmp_path / "a.sqlite")


def judge_light(file):
    judge(file, POSE, ("depth", "object_mask"))


def test_a_panorama_whose_depth_is_along_the_ray(tmp_path, capsys):
    layered(tmp_path / "f/a.exr", *panorama(POSE), more=[*CRYPTO, *NORMAL])
    assert run(tmp_path / "f", tmp_path / "a.sqlite", *PLACE, *names(tmp_path)) == 0
    out = capsys.readouterr().out
    assert "1 of lit, 1 of depth, 1 of object_mask" in out
    said = "layers that are not taken: CryptoObject00, Normal; masks are taken of IndexOB, Blender's pass"
    assert said in out
    judge_light(tmp_path / "a.sqlite")


def test_passes_in_files_of_their_own(tmp_path, capsys):
    """As the node File Output writes them: a number behind each pass, ids in one channel of floats."""
    lit, depth, labels = panorama(POSE)
    (tmp_path / "f").mkdir()
    write(tmp_path / "f/Image0001.exr", {name: lit[..., i] / 255 for i, name in enumerate("RGB")})
    write(tmp_path / "f/Depth0001.exr", {"V": depth})
    write(tmp_path / "f/IndexOB0001.exr", {"V": labels})
    assert run(tmp_path / "f", tmp_path / "a.sqlite", *PLACE, *names(tmp_path)) == 0
    assert "1 place, 1 of lit, 1 of depth, 1 of object_mask" in capsys.readouterr().out
    judge_light(tmp_path / "a.sqlite")


def test_ids_that_are_blended_are_refused(tmp_path):
    write(tmp_path / "m.exr", {"V": np.full((4, 4), 2.5)})
    with pytest.raises(ArgumentError, match="without anti-aliasing, got 16 of 16 others such as 2"):
        read_picture(tmp_path / "m.exr", "object_mask")


def test_colours_are_those_that_the_renderer_ends_with(tmp_path):
    channels = {f"ViewLayer.{layer}.{name}": np.full((4, 8), value)
                for layer, value in (("DiffCol", 0.2), ("Combined", 0.6)) for name in "RGB"}  # fmt: skip
    write(tmp_path / "a.exr", channels | {name: np.full((4, 8), 0.9) for name in CRYPTO})
    np.testing.assert_allclose(read_picture(tmp_path / "a.exr").pixels, 0.6, rtol=1e-6)


def test_depth_in_half_floats_beside_floats_keeps_its_precision(tmp_path):
    """A file has the widest type of its channels, and depth has its own."""
    spec = OpenImageIO.ImageSpec(8, 4, 4, "float")
    spec.channelnames = ("R", "G", "B", "Z")
    spec.channelformats = ("float", "float", "float", "half")
    output = OpenImageIO.ImageOutput.create(str(tmp_path / "a.exr"))
    assert output.open(str(tmp_path / "a.exr"), spec)
    assert output.write_image(np.full((4, 8, 4), 2.2003, np.float32))
    output.close()
    picture = read_picture(tmp_path / "a.exr", "depth")
    assert picture.half_m == 1
    np.testing.assert_array_equal(picture.pixels, np.float32(np.float16(2.2003)))
    np.testing.assert_allclose(read_picture(tmp_path / "a.exr").pixels, 2.2003, rtol=1e-6)
