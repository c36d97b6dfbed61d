"""Valid files of paths with one thing changed at random: what evo, csv and SciPy read, or one line."""

import csv
import re

import numpy as np
import pytest
from evo.tools import file_interface
from scipy.spatial.transform import Rotation

from omniscv.errors import ArgumentError
from omniscv.geometry import R_LEVEL, Pose
from omniscv.geometry.trajectory_files import read_trajectory

PER_S = {"s": 1, "ms": 1e3, "us": 1e6, "ns": 1e9, "": 1}
QUATERNION = ("qx", "qy", "qz", "qw")
HEADS = {
    "tum": (" ", ""),
    "tum-named": (" ", "# timestamp tx ty tz qx qy qz qw"),
    "tum-w-first": (" ", "# time tx ty tz qw qx qy qz"),
    "kitti": (" ", ""),
    "euroc": (",", ""),
    "euroc-named": (",", "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], "
                    "q_RS_y [], q_RS_z [], v_RS_R_x [m s^-1], v_RS_R_y [m s^-1], v_RS_R_z [m s^-1]"),
    "csv": (",", "time,x,y,z,qx,qy,qz,qw"),
    "csv-ms": (";", "x;y;z;qw;qx;qy;qz;time_ms"),
    "csv-angles": (",", "x,y,z,yaw,pitch,roll"),
    "csv-rad": ("\t", "time [us]\tx\ty\tz\tyaw_rad\tpitch_rad\troll_rad"),
    "csv-place": (" ", "x y z"),
}  # fmt: skip
NAMES = {f"{start}{axis}": axis for start in ("", "t", "p_rs_r_") for axis in "xyz"}
NAMES |= {f"{start}{axis}": f"q{axis}" for start in ("q", "q_rs_") for axis in "wxyz"}
NAMES |= {"time": "time", "timestamp": "time", "yaw": "yaw", "pitch": "pitch", "roll": "roll"}


def table(kind, draw):
    """Names and rows of cells of a valid file."""
    count = int(draw.integers(2, 9))
    start = draw.choice([0.0, 1403636579.763555])
    time = start + np.cumsum(draw.uniform(0.02, 0.5, count))
    xyz, turns = draw.normal(size=(count, 3)) * 5, Rotation.random(count, rng=draw)
    columns = dict(zip(("x", "y", "z", *QUATERNION), np.hstack([xyz, turns.as_quat()]).T, strict=True))
    columns |= dict(zip(("yaw", "pitch", "roll"), turns.as_euler("ZYX", degrees=True).T, strict=True))
    separator, head = HEADS[kind]
    if kind == "kitti":
        matrices = np.concatenate([turns.as_matrix(), xyz[..., None]], axis=2).reshape(-1, 12)
        return [], [[f"{value:.9g}" for value in row] for row in matrices]
    default = {"tum": "time x y z qx qy qz qw", "euroc": "time[ns] x y z qw qx qy qz"}
    names = re.split(r",\s*|;|\t", head.lstrip("# ")) if separator != " " else head.lstrip("# ").split()
    names, cells = names if head else [], []
    for name in names or default[kind].split():
        plain, unit = meaning(name)
        values = columns[plain] if plain in columns else time if plain == "time" else np.zeros(count)
        if plain == "time" and unit in ("ns", "us"):
            cells.append([str(round(value * PER_S[unit])) for value in time])
            continue
        values = np.radians(values) if unit == "rad" else values * (PER_S[unit] if plain == "time" else 1)
        cells.append([f"{value:.15g}" for value in values])
    return names, [list(row) for row in zip(*cells, strict=True)]


def meaning(name):
    """What a name of a column stands for, and its unit."""
    match = re.fullmatch(r"(.*?)\s*(?:\[(\w*)[^\]]*\]|_(ms|us|ns|s|rad|deg))?", name.strip(" '\"").lower())
    return NAMES.get(match[1]), match[2] or match[3] or ""


def text_of(kind, names, rows):
    separator, head = HEADS[kind]
    start = re.match(r"[# ]*", head)[0]
    joined = ", " if kind == "euroc-named" else separator
    lines = [start + joined.join(names)] if names else []
    return "\n".join([*lines, *map(separator.join, rows)]) + "\n"


def changed(kind, draw):
    """The text of a file with one change."""
    names, rows = table(kind, draw)
    pick = lambda items: int(draw.integers(len(items)))  # noqa: E731
    i, j, change = pick(rows), pick(rows[0]), draw.integers(13)
    if change == 0:
        rows[i][j] = draw.choice(
            ["up", "nan", "-inf", "", "1e400", "0,5", "0x1p3", "--1", "1.2.3", "1_0", "0"]
        )
    elif change == 1:
        del rows[i][j]
    elif change == 2:
        rows[i].insert(j, "1")
    elif change == 3:  # a column goes, or comes
        rows = [row[:j] + row[j + 1 :] for row in rows]
        names = names[:j] + names[j + 1 :] if draw.integers(2) else names
    elif change == 4:
        names, rows = names and [*names, names[j]], [[*row, row[j]] for row in rows]
    elif change == 5:  # columns in another order, and their names mostly, too
        order = draw.permutation(len(rows[0]))
        rows = [[row[k] for k in order] for row in rows]
        names = [names[k] for k in order] if names and draw.integers(3) else names
    elif change == 6:
        rows.insert(i, list(rows[i]))
        rows[i][-1] = rows[i][-1] if draw.integers(2) else "0.5"
    elif change == 7:
        rows[i], rows[0] = rows[0], rows[i]
    elif change == 8:  # whole columns of another size
        factor = draw.choice([0.001, 1000, 1e6, 1e9])
        rows = [[*row[:j], f"{float(row[j]) * factor:.15g}", *row[j + 1 :]] for row in rows]
    text = text_of(kind, names, rows)
    at = pick(text)
    if change == 9:
        text = text[:at] + chr(draw.integers(32, 127)) + text[at + 1 :]
    elif change == 10:
        text = text[:at] + text[at + 1 :]
    elif change == 11:
        text = text[:at] + chr(draw.integers(9, 127)) + text[at:]
    elif change == 12:
        text = draw.choice(["\ufeff", "", "\n\n# a word\n"]) + text.replace(
            "\n", draw.choice(["\r\n", " \n", "\n\n"])
        )
    return text


def read_by_others(kind, path):
    """Times, positions and rotations as others read them: evo, or csv and SciPy; None where they cannot."""
    blank = str.maketrans(dict.fromkeys("\x0b\x0c\x1c\x1d\x1e\x1f", " "))  # as Python has it
    lines = [
        line.translate(blank).strip()
        for line in re.split("[\r\n]+", path.read_text("utf-8-sig"))
        if line.strip()
    ]
    lines = [line for line in lines if not line.startswith("# a word")]
    lines = [line.partition("#")[0] or line for line in lines]  # what follows a row is a comment
    separator, plain = HEADS[kind][0], path.with_suffix(".plain")  # evo takes no blank line or end
    plain.write_text("\n".join(" ".join(line.split()) for line in lines) + "\n")
    try:
        if kind == "kitti":
            matrices = np.array(file_interface.read_kitti_poses_file(plain).poses_se3)
            return None, matrices[:, :3, 3] @ R_LEVEL.T, R_LEVEL @ matrices[:, :3, :3]
        if kind in ("tum", "euroc"):
            read = {"tum": "read_tum_trajectory_file", "euroc": "read_euroc_csv_trajectory"}[kind]
            poses = getattr(file_interface, read)(plain)
            return poses.timestamps, poses.positions_xyz, np.array(poses.poses_se3)[:, :3, :3]
        first = lines[0].lstrip("#% ")
        names = re.split(r"[,;\t]", first) if separator != " " else first.split()
        if kind in ("tum-named", "tum-w-first") and lines[0].startswith(("#", "%")):  # words of a comment
            names = [name for name in re.findall(r"[a-zA-Z_]\w*", first) if meaning(name)[0]]
        found = [meaning(name) for name in names]
        rows = [line for line in lines if line.lstrip("#% ") != first and not line.startswith(("#", "%"))]
        cells = [line.split() for line in rows] if separator == " " else csv.reader(rows, delimiter=separator)
        cells = [row for row in cells if len(found) == len(row) or 1 / 0]
        names = [name for name, _ in found if name]
        columns = {
            name: np.array([float(row[i]) for row in cells]) for i, (name, _) in enumerate(found) if name
        }
        if len(columns) != len(names):
            return None
        units = dict(found)
        times = columns["time"] / PER_S[units["time"]] if "time" in columns else None
        xyz = np.stack([columns[axis] for axis in "xyz"], axis=1)
        if "qw" in columns:
            turns = Rotation.from_quat(np.stack([columns[name] for name in QUATERNION], axis=1))
            return times, xyz, turns.as_matrix()
        angles = [columns.get(name, 0 * xyz[:, 0]) for name in ("yaw", "pitch", "roll")]
        if "rad" in units.values():
            angles = np.degrees(angles)
        poses = [Pose.from_angles(at, *turn) for at, turn in zip(xyz, np.transpose(angles), strict=True)]
        return times, xyz, np.array([pose.rotation for pose in poses])
    except Exception:  # whatever a changed file makes others raise
        return None


def check_changed(count, seed, folder):
    path, draw, right, refused = folder / "path.txt", np.random.default_rng(seed), 0, 0
    for i in range(count):
        kind = list(HEADS)[i % len(HEADS)]
        text = changed(kind, draw)
        path.write_bytes(text.encode())
        try:
            ours = read_trajectory(path)
        except ArgumentError as line:
            refused += "\n" not in str(line)
            continue
        theirs = read_by_others(kind, path)
        assert theirs is not None, f"{kind}: {text!r}"
        times, xyz, turns = theirs
        if any("left out" in line for line in ours.says):
            kept = np.diff(times, prepend=-1) != 0
            times, xyz, turns = times[kept], xyz[kept], turns[kept]
        scale = next(
            (PER_S[unit] for line in ours.says for unit in PER_S if f"taken as {unit} since" in line), 1
        )
        np.testing.assert_allclose([pose.position for pose in ours], xyz, atol=1e-9, err_msg=repr(text))
        # KITTI's matrices have nine digits, and may be off a rotation by 1e-4.
        atol = 2e-4 if kind == "kitti" else 1e-9
        np.testing.assert_allclose([p.rotation for p in ours], turns, atol=atol, err_msg=repr(text))
        assert (ours.times is None) == (times is None), repr(text)
        if times is not None:  # float64 of seconds since 1970 has 2.4e-7
            np.testing.assert_allclose(ours.times, times / scale, rtol=1e-12, atol=5e-7, err_msg=repr(text))
        right += 1
    return right, refused


def test_what_is_changed_at_random_is_read_right_or_refused(tmp_path):
    right, refused = check_changed(300, 1, tmp_path)
    assert min(right, refused) > 60  # both are tried
    assert right + refused == 300


@pytest.mark.soak
def test_what_is_changed_at_random_20000_times(tmp_path):
    check_changed(20_000, 2, tmp_path)
