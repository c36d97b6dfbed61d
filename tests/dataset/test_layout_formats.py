"""HorizonNet, read back by the checks and readers that people use, written out."""

import numpy as np
import pytest
from PIL import Image
from support.rooms import PLAIN, frame, plain_frame, room_of_plan

from omniscv import Pose, cameras
from omniscv.dataset import exporting
from omniscv.errors import ArgumentError
from omniscv.truth import project_layout

PANORAMA = cameras.create("equirectangular", 1024, 512)
SMALL = cameras.create("equirectangular", 128, 64)
LEVEL = Pose.from_angles((0, 0, 1.5))

KNOWN_CORNERS = """159.670 199.103
159.670 319.752
351.330 199.103
351.330 319.752
671.670 199.103
671.670 319.752
863.330 199.103
863.330 319.752
"""


def write(frames, out, **options):
    return exporting.get("horizonnet").export(frames, out, options)


def test_the_known_room_has_the_known_lines(tmp_path):
    files = write([plain_frame(tmp_path, "a", PANORAMA, LEVEL)], tmp_path / "out")
    names = [path.relative_to(tmp_path / "out").as_posix() for path in files]
    assert names == ["img/a.png", "label_cor/a.txt"]
    assert files[1].read_text() == KNOWN_CORNERS


def test_horizonnet_refuses_tilted_cameras_and_other_rooms(tmp_path):
    leaning = plain_frame(tmp_path, "b", SMALL, Pose.from_angles((0, 0, 1.5), pitch_deg=4))
    with pytest.raises(ArgumentError, match="b: expected an upright camera, got pitch 4"):
        write([leaning], tmp_path / "out")
    record = project_layout(room_of_plan(PLAIN), SMALL, LEVEL)
    record["corners"][6]["world"][2] = 3.3
    with pytest.raises(ArgumentError, match="c: layout: expected a room of upright walls"):
        write([frame(tmp_path, "c", SMALL, LEVEL, record)], tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("kind", "lit"), [("png", np.uint8), ("jpg", np.uint8), ("png", np.float32)])
def test_colours_come_as_wanted_from_whatever_the_frame_has(tmp_path, kind, lit):
    colours = np.arange(64 * 128 * 3, dtype=np.uint32).reshape(64, 128, 3) // 97
    record = project_layout(room_of_plan(PLAIN), SMALL, LEVEL)
    shade = (colours % 256).astype(np.uint8)
    low = shade / 255 / 12.92  # IEC 61966-2-1
    light = np.where(shade <= 10, low, ((shade / 255 + 0.055) / 1.055) ** 2.4)
    layers = {"lit": shade if lit is np.uint8 else light.astype(np.float32)}
    seen = frame(tmp_path, "a", SMALL, LEVEL, record, layers)
    (path, _) = write([seen], tmp_path / "out", image_format=kind)
    assert path.name == f"a.{kind}"
    found = np.asarray(Image.open(path)).astype(int)
    assert np.abs(found - shade).mean() <= (0 if kind == "png" else 4)
