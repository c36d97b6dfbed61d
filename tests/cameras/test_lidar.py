"""LiDAR: known answers of sensors, and tables of other programs' files."""

import csv
import json

import numpy as np
import pytest
import yaml

from omniscv import cameras
from omniscv.errors import ArgumentError
from omniscv.geometry import R_LEVEL
from omniscv.testing.contracts import check_round_trip


def in_sensor(vectors):
    """From the camera's frame to X forward, Y left, Z up."""
    return vectors @ R_LEVEL.T


def test_timing_of_velodyne():
    """Columns of .19907 degrees at 10 Hz, 1808.449 of which are a turn; laser 15 is .1244 degrees late."""
    camera = cameras.create("lidar", preset="vlp-16")
    x, y, _ = np.moveaxis(in_sensor(camera.unproject().directions), -1, 0)
    azimuth = np.degrees(np.arctan2(y, x))
    steps = (np.diff(azimuth, axis=1) + 180) % 360 - 180
    np.testing.assert_allclose(steps, -0.1990656, rtol=0, atol=1e-9)
    assert (azimuth[-1, 0] - azimuth[0, 0] + 180) % 360 - 180 == pytest.approx(0.1244, abs=1e-4)
    np.testing.assert_allclose(camera.seconds()[0] - camera.seconds()[-1], 15 * 2.304e-6, rtol=1e-9)
    frozen = cameras.create("lidar", preset="vlp-16", frozen=True)
    assert not frozen.seconds().any()
    assert frozen.readout == 0 < camera.readout
    assert cameras.from_dict(frozen.to_dict()) == frozen != camera
    assert camera.rings.tolist() == [*range(15, -1, -1)]
    assert cameras.create("lidar", preset="hdl-32e").width == 2170
    with pytest.raises(ArgumentError, match="width: expected at most 1808 firings"):
        cameras.create("lidar", preset="vlp-16", width=1809)


OUSTER = {
    "lidar_mode": "1024x10",
    "beam_intrinsics": {
        # of row 0 of Ouster's sample os-992146000760-128: its ray in the sensor's frame is a golden number
        "beam_altitude_angles": [np.degrees(np.arcsin(0.36390159)), 0.0, -20.0],
        "beam_azimuth_angles": [np.degrees(np.arctan2(0.06935165, 0.92885197)), 1.4, -1.4],
        "lidar_origin_to_beam_origin_mm": 15.806,
    },
    "lidar_intrinsics": {"lidar_to_sensor_transform": [-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 36.18, 0, 0, 0, 1]},
}


def velodyne_points(lasers, azimuth, distance):
    """Points as the ROS driver computes them, in Velodyne's frame: y ahead, x right; here x ahead, y left."""
    e, correction, h, v = (np.array([laser[key] for laser in lasers])[:, None] for key in VELODYNE)
    a = azimuth - correction
    xy = distance * np.cos(e) - v * np.sin(e)
    x, y = xy * np.sin(a) - h * np.cos(a), xy * np.cos(a) + h * np.sin(a)
    z = distance * np.sin(e) + v * np.cos(e) + 0 * x
    return np.stack([y, -x, z], axis=-1)


VELODYNE = ("vert_correction", "rot_correction", "horiz_offset_correction", "vert_offset_correction")


def test_tables_of_files(tmp_path):
    (tmp_path / "ouster.json").write_text(json.dumps(OUSTER))
    camera = cameras.create("lidar", preset=str(tmp_path / "ouster.json"))
    assert (camera.width, camera.height) == (1024, 3)
    rays = camera.unproject()
    golden = [-0.92885197, 0.06935165, 0.36390159]  # 8 digits
    np.testing.assert_allclose(in_sensor(rays.directions)[0, 0], golden, atol=1e-8)
    np.testing.assert_allclose(in_sensor(rays.origins)[0, 0], [-0.015806, 0, 0.03618], atol=1e-15)
    assert len(camera.viewpoints().centers) == 1024
    check_round_trip(camera)

    rows = (0.05, -0.1, 0.026, 0.2), (-0.3, 0.08, -0.026, 0.15)
    lasers = [dict(zip(VELODYNE, row, strict=True)) for row in rows]
    (tmp_path / "velodyne.yaml").write_text(yaml.safe_dump({"lasers": lasers, "num_lasers": 2}))
    with pytest.raises(ArgumentError, match="width: expected the firings in a turn"):
        cameras.create("lidar", preset=str(tmp_path / "velodyne.yaml"))
    camera = cameras.create("lidar", width=40, preset=str(tmp_path / "velodyne.yaml"))
    # clockwise, from behind
    rays = camera.unproject()
    azimuth = np.pi + np.arange(40) * 2 * np.pi / 40
    points = in_sensor(rays.origins + 7 * rays.directions)
    np.testing.assert_allclose(points, velodyne_points(lasers, azimuth, 7.0), atol=1e-14)

    elevation = [0.3, 0.1, -0.2]
    offsets = [0.01, 0.0, -0.01]
    columns = np.linspace(1.0, 1.0 - 2 * np.pi, 60, endpoint=False)
    ncore = {"row_elevations_rad": elevation, "row_azimuth_offsets_rad": offsets, "spinning_direction": "cw"}
    ncore |= {"column_azimuths_rad": columns.tolist(), "spinning_frequency_hz": 20.0}
    (tmp_path / "ncore.json").write_text(json.dumps(ncore))
    camera = cameras.create("lidar", preset=str(tmp_path / "ncore.json"))
    e = np.array(elevation)[:, None]
    a = columns + np.array(offsets)[:, None]
    wanted = np.stack(np.broadcast_arrays(np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)), axis=-1)
    np.testing.assert_allclose(in_sensor(camera.unproject().directions), wanted, rtol=0, atol=1e-14)
    assert camera.rate == 20
    assert cameras.from_dict(json.loads(json.dumps(camera.to_dict()))) == camera  # without the file

    with (tmp_path / "beams.csv").open("w", newline="") as file:
        csv.writer(file).writerows([("elevation_deg", "azimuth_deg"), (-5, 1), (5, -1)])
    camera = cameras.create("lidar", width=8, preset=str(tmp_path / "beams.csv"))
    np.testing.assert_allclose(camera.unproject().directions[:, 0, 1], -np.sin(np.radians([5, -5])))


def test_a_turn_while_moving():
    """At 10 m/s the first and the last column of a turn see the wall behind 1 m apart, on its own place."""
    lidar = cameras.create("lidar", preset="os1-64")
    moving = cameras.RollingShutter(1024, 64, lidar, 0.1, (0.0, 0.0, 10.0), scan="left-to-right")
    rays = moving.unproject()
    still = lidar.unproject()
    reach = (-20 - rays.origins[..., 2]) / rays.directions[..., 2]  # to a wall 20 m behind the start
    behind = reach * still.directions[..., 2] + still.origins[..., 2]  # in the frame that moves
    np.testing.assert_allclose(behind[:, 0] - behind[:, -1], 1.0 * 1023 / 1024, rtol=0, atol=1e-12)
    np.testing.assert_allclose(moving.viewpoints().centers[512], [0, -0.03618, 0.5], atol=0.02)
    some = np.s_[::7, ::16]
    points = (rays.origins + 5 * rays.directions)[some]
    pixels, seen = moving.project(points)
    assert seen.all()
    first = moving.unproject(pixels)  # of two columns near the seam, the first one
    aside = np.cross(points - first.origins, first.directions)
    assert np.abs(aside).max() < 1e-7
    assert (pixels[..., 0] < moving.pixels()[some][..., 0] + 1e-6).all()


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.json", "{}", "expected beam_altitude_angles"),
        ("a.json", '{"beam_altitude_angles": [1, 1], "beam_azimuth_angles": [0, 0], '
         '"lidar_origin_to_beam_origin_mm": 1}', "elevation_deg: expected different angles"),
        ("a.csv", "x,y\n1,2\n", "expected columns elevation_deg, azimuth_deg, got 'x,y'"),
        ("a.csv", "elevation_deg\nup\n", "elevation_deg: expected finite numbers"),
        ("a.yaml", "lasers: 3", "expected beam_altitude_angles"),
        ("a.txt", "", "preset: expected one of vlp-16"),
    ],
)  # fmt: skip
def test_other_files_are_refused(tmp_path, name, content, message):
    (tmp_path / name).write_text(content)
    with pytest.raises(ArgumentError, match=message):
        cameras.create("lidar", width=8, preset=str(tmp_path / name))
