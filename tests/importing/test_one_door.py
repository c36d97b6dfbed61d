"""Poses come in equal at every door, in every spelling; one thing changed at random is right or one line."""

import json
import unicodedata
from itertools import product

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

import omniscv
from omniscv.errors import ArgumentError
from omniscv.geometry.trajectory_files import read_trajectory
from omniscv.importing.folders import import_folder
from omniscv.importing.posed_frames import Options
from omniscv.importing.sequences import find_sequence
from omniscv.job.poses import read_poses

MIRROR = np.diag([1.0, -1, 1])
LEVEL = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
MATRIX = [f"m{i}" for i in range(16)]
QUATERNION = ["qx", "qy", "qz", "qw"]
ANGLES = ["yaw", "pitch", "roll"]


def meaning(row, frame, scale):
    """Position and rotation of a row, by column, in the axes of a frame."""
    t = np.array([row[axis] for axis in "xyz"]) if "x" in row else np.array([row[m] for m in MATRIX[3:12:4]])
    if "qw" in row:
        R = Rotation.from_quat([row[name] for name in QUATERNION]).as_matrix()
    elif "m0" in row:
        R = np.array([row[m] for m in MATRIX[:12]]).reshape(3, 4)[:, :3]
    else:  # turns of a level camera, one after the other
        yaw, pitch, roll = (row[name] for name in ANGLES)
        yaw, pitch = (-yaw, pitch) if frame == "unreal" else (yaw, -pitch if frame == "body" else pitch)
        turned = Rotation.from_euler("z", yaw, degrees=True) * Rotation.from_euler("y", -pitch, degrees=True)
        R = (turned * Rotation.from_euler("x", roll, degrees=True)).as_matrix() @ LEVEL
        return (MIRROR @ t if frame == "unreal" else t) * scale, R
    if frame == "unreal":
        return MIRROR @ t * scale, MIRROR @ R @ MIRROR @ LEVEL
    return t * scale, R @ {"camera": np.eye(3), "body": LEVEL, "opengl": np.diag([1.0, -1, -1])}[frame]


def drawn(draw, spelling, count=3):
    turns = Rotation.random(count, rng=draw)
    places = draw.normal(size=(count, 3)) * 5
    if spelling == "matrix":
        last = np.tile([0.0, 0, 0, 1], (count, 1, 1))
        matrices = np.concatenate([np.dstack([turns.as_matrix(), places]), last], axis=1)
        return [dict(zip(MATRIX, matrix.ravel().tolist(), strict=True)) for matrix in matrices]
    names = QUATERNION if spelling == "quaternion" else ANGLES
    values = turns.as_quat() if spelling == "quaternion" else turns.as_euler("ZYX", degrees=True)
    rows = np.hstack([places, values]).tolist()
    return [dict(zip([*"xyz", *names], row, strict=True)) for row in rows]


def entry(row):
    """A row as JSON: a matrix in four lines."""
    matrix = [[row[m] for m in MATRIX[i : i + 4]] for i in (0, 4, 8, 12)] if "m0" in row else None
    return {"transform_matrix": matrix} if matrix else row


def table(rows, names=()):
    """Rows as CSV: without a header for matrices."""
    cells = ([*names[i : i + 1], *map(str, row.values())] for i, row in enumerate(rows))
    lines = [",".join(line) for line in cells]
    if "m0" in rows[0]:
        return "\n".join(lines).replace(",", " ") + "\n"
    return "\n".join([",".join(["name"] * bool(names) + [*rows[0]]), *lines]) + "\n"


def of_job(folder, rows, frame, unit):
    (folder / "path.csv").write_text(table(rows))
    return read_poses("poses", {"file": str(folder / "path.csv"), "frame": frame, "unit": unit}).poses


def of_option(folder, rows, frame, unit, suffix="csv"):
    names = [f"pano{i}" for i in range(len(rows))]
    for name in names:
        (folder / f"{name}.png").touch()
    file = folder.parent / f"poses.{suffix}"
    if suffix == "csv":
        file.write_text(table(rows, names))
    else:
        file.write_text(json.dumps({name: entry(row) for name, row in zip(names, rows, strict=True)}))
    options = Options(poses=file, frame=frame, unit=unit)
    return [frame.pose for frame in find_sequence(folder, "latlong", options).frames]


def of_option_json(folder, rows, frame, unit):
    return of_option(folder, rows, frame, unit, "json")


def of_transforms(folder, rows, frame, unit):
    frames = [{"file_path": f"{i}.png", **entry(row)} for i, row in enumerate(rows)]
    given = {"fl_x": 90, "w": 128, "h": 96, "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(given))
    return [frame.pose for frame in find_sequence(folder, "nerfstudio", Options()).frames]


def of_captures(folder, rows, frame, unit):
    np.save(folder / "a.npy", np.zeros((4, 4, 3), np.uint8))
    view = {"fov_deg": 90, "width": 4, "height": 4}
    captures = [{"file": "a.npy", "mode": "lit", "view": {**view, **entry(row)}} for row in rows]
    (folder / "captures.json").write_text(json.dumps(captures))
    file = folder.parent / "a.sqlite"
    file.unlink(missing_ok=True)
    import_folder(folder, file)
    with omniscv.open_source(file) as source:
        return [view.pose for view in source.recorded_views()]


def of_layout(folder, rows, frame, unit):
    for i in range(len(rows)):
        (folder / f"{i}.png").touch()
    (folder / "poses.txt").write_text(table(rows))
    poses = f"{{file: poses.txt, row: i, axes: {frame}, unit: {unit}}}"
    layout = folder.parent / "my.yaml"
    layout.write_text(f"pictures: latlong\nplace: '(?P<i>\\d+)\\.png'\nlit: '{{i}}.png'\nposes: {poses}\n")
    return [frame.pose for frame in find_sequence(folder, str(layout), Options()).frames]


EVERY = ("camera", "body", "unreal", "opengl")
DOORS = {
    "job": (of_job, EVERY, ("matrix", "quaternion", "angles")),
    "--poses CSV": (of_option, EVERY, ("matrix", "quaternion", "angles")),
    "--poses JSON": (of_option_json, EVERY, ("matrix", "quaternion", "angles")),
    "transforms.json": (of_transforms, ("opengl",), ("matrix",)),
    "captures.json": (of_captures, ("camera",), ("matrix", "quaternion", "angles")),
    "my.yaml": (of_layout, EVERY, ("matrix", "quaternion", "angles")),
}
UNITS = {"m": 1.0, "cm": 0.01, 2.5: 2.5}


def check_valid(door, seed, count, folder):
    """Random rows are what they mean, and the same to the last digit at a job's door."""
    read, frames, spellings = DOORS[door]
    draw = np.random.default_rng(seed)
    for _ in range(count):
        spelling = draw.choice(spellings)
        frame = str(draw.choice(frames))
        if spelling == "angles" and frame == "opengl":
            frame = "camera"
        unit = "m" if len(frames) == 1 else [*UNITS][draw.integers(3)]
        rows = drawn(draw, spelling)
        got = read(folder, rows, frame, unit)
        of_a_job = of_job(folder, rows, frame, unit)
        for pose, same, row in zip(got, of_a_job, rows, strict=True):
            position, rotation = meaning(row, frame, UNITS[unit])
            np.testing.assert_allclose(pose.position, position, atol=1e-12)
            np.testing.assert_allclose(pose.rotation, rotation, atol=1e-12)
            np.testing.assert_array_equal(pose.position, same.position)
            np.testing.assert_array_equal(pose.rotation, same.rotation)


def scaled(row, names, factor):
    row.update({name: row[name] * factor for name in names if name in row})


def transposed(row):
    row.update(zip(MATRIX, np.reshape([*row.values()], (4, 4)).T.ravel().tolist(), strict=True))


CHANGES = {
    "nan": lambda row, name: row.update({name: float("nan")}),
    "inf": lambda row, name: row.update({name: float("-inf")}),
    "far": lambda row, name: row.update({"x" if "x" in row else "m7": 1e10}),
    "word": lambda row, name: row.update({name: "up"}),
    "empty": lambda row, name: row.update({name: ""}),
    "gone": lambda row, name: row.pop("z" if "z" in row else name),
    "more": lambda row, name: row.update({"roll" if "qw" in row else "qw": 0.5}),
    "long": lambda row, name: scaled(row, [*QUATERNION, *MATRIX], 1.01),
    "mirrored": lambda row, name: scaled(row, MATRIX[:3], -1),
    "transposed": lambda row, name: transposed(row),
    "last row": lambda row, name: row.update({"m12" if "m0" in row else name: float("inf")}),
}
KEPT = {*product(("transposed", "mirrored"), ("angles", "quaternion"))}
KEPT |= {("long", "angles"), ("more", "matrix")}


def check_changed(door, seed, count, folder):
    read, frames, spellings = DOORS[door]
    draw = np.random.default_rng(seed)
    for _ in range(count):
        spelling, frame, change = (str(draw.choice(of)) for of in (spellings, frames, [*CHANGES]))
        if (change, spelling) in KEPT:
            continue
        if change == "gone" and spelling == "matrix" and "json" in door.lower():
            continue  # a list of numbers has no names
        rows = drawn(draw, spelling)
        row = rows[draw.integers(3)]
        for changing in rows if change == "more" else [row]:
            CHANGES[change](changing, draw.choice([*row]))
        got = outcome(read, folder, rows, frame)
        if isinstance(got, str):
            assert "\n" not in got
        else:  # a layout leaves out frames that were not tracked, and says how many
            left_out = door == "my.yaml" and change in ("nan", "inf", "last row") and len(got) == 2
            assert left_out, f"{door}: {change} of {spelling}: {rows}"


def outcome(read, folder, rows, frame):
    try:
        return read(folder, rows, frame, "m")
    except ArgumentError as refusal:
        return str(refusal)


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "f").mkdir()
    return tmp_path / "f"


LONG = pytest.param(1000, 3, marks=[pytest.mark.soak, pytest.mark.timeout(3600)])


@pytest.mark.parametrize(("count", "seed"), [(12, 1), LONG])
@pytest.mark.parametrize("door", DOORS)
def test_valid_poses_are_equal_at_every_door_and_others_are_refused(door, count, seed, folder):
    check_valid(door, seed, count, folder)
    check_changed(door, seed + 1, 2 * count, folder)


HALF = np.radians(15)
UNREAL = "100,200,150,0,30,0\n"
EASYSYNTH = f"id,tx,ty,tz,qw,qx,qy,qz,fx,fy,cx,cy\n0,1,-2,1.5,{np.cos(HALF)},0,0,{-np.sin(HALF)},9,9,4,3\n"


def test_rows_of_unreal_and_easysynth(tmp_path):
    """Of issue 61: centimetres, y to the right, turning right +. Of EasySynth: metres, right-handed, z up."""
    file = tmp_path / "CameraPoses.csv"
    for text, frame in (
        (f"X,Y,Z,Pitch,Yaw,Roll\n{UNREAL}", "unreal"),
        (f"Location.X,Location.Y,Location.Z,Rotation.Pitch,Rotation.Yaw,Rotation.Roll\n{UNREAL}", "unreal"),
        (f"x,y,z,qx,qy,qz,qw\n100,200,150,0,0,{np.sin(HALF)},{np.cos(HALF)}\n", "unreal"),
        (EASYSYNTH, "body"),
    ):
        file.write_text(text)
        (pose,) = read_trajectory(file, frame=frame)
        np.testing.assert_allclose(pose.position, (1, -2, 1.5), atol=1e-15)
        np.testing.assert_allclose(pose.rotation[:, 2], (np.cos(2 * HALF), -0.5, 0), atol=1e-15)
    # A file of EasySynth's name does not say its axes.
    with pytest.raises(ArgumentError, match=r"expected frame: unreal .* or frame: body .*got no frame"):
        read_trajectory(file)


NAVVIS = """# pano poses v1.0: ID; filename; timestamp; pano_pos_x; pano_pos_y; pano_pos_z; pano_ori_w; pano_ori_x; pano_ori_y; pano_ori_z
0; 00000-pano.jpg; 1497.5; 1; -2; 1.5; 1; 0; 0; 0
"""  # noqa: E501


@pytest.mark.parametrize(
    ("text", "name"),
    [
        (NAVVIS, "00000-pano.jpg"),
        ('name,x,y,z,yaw_rad\n"a, b.jpg",1,-2,1.5,0\n', "a, b.jpg"),
        ("image name, x [m], y [m], z [m]\na b.jpg, 1, -2, 1.5\n", "a b.jpg"),
        ("x [cm];y [cm];z [cm];file\n100;-200;150;c.jpg\n", "c.jpg"),
    ],
)
def test_names_stand_where_programs_put_them(text, name, folder):
    (folder / name).touch()
    file = folder.parent / "poses.csv"
    file.write_text(text)
    frame = "body" if "ori" in text else None
    (frame,) = find_sequence(folder, "latlong", Options(poses=file, frame=frame)).frames
    np.testing.assert_allclose(frame.pose.position, (1, -2, 1.5))
    np.testing.assert_allclose(frame.pose.rotation, LEVEL, atol=1e-15)


TILTED = "name,x,y,z,yaw,pitch\na.png,1,2,3,30,0\nb.png,1,2,3,30,10\n"
LYING = "b.png 1 2 3 -0.5 0.5 -0.5 0.5\n"  # seen as a camera, that is level
YAW = f"b.png 1 2 3 0 0 {np.sin(HALF)} {np.cos(HALF)}\n"


@pytest.mark.parametrize(
    ("text", "body", "camera"),
    [
        (TILTED, "yaw 30, pitch -10, roll 0", "yaw 30, pitch 10, roll 0"),
        (LYING, "yaw ", "yaw 0, pitch 0, roll 0"),
    ],
    ids=["angles", "quaternion"],
)
def test_poses_that_lean_need_the_word_of_their_axes(text, body, camera, folder):
    (folder / "b.png").touch()
    file = folder.parent / "poses.csv"
    file.write_text(text)
    with pytest.raises(ArgumentError, match=r"expected --frame, because the pose of 'b\.png'") as refusal:
        find_sequence(folder, "latlong", Options(poses=file))
    assert f"--frame body (x ahead, z up) means {body}" in str(refusal.value)
    assert f"--frame camera (x right, z ahead) means {camera}" in str(refusal.value)
    angles = {}
    for frame in ("body", "camera"):
        (found,) = find_sequence(folder, "latlong", Options(poses=file, frame=frame)).frames
        angles[frame] = found.pose.angles()
    assert angles["camera"][1] == pytest.approx(10 if text == TILTED else 0)
    assert abs(angles["body"][1]) == pytest.approx(10 if text == TILTED else 0, abs=1e-6)


@pytest.mark.parametrize("text", [YAW, "name,x,y,z,yaw\nb.png,1,2,3,30\n"], ids=["quaternion", "angle"])
def test_yaw_alone_needs_no_word(text, folder):
    (folder / "b.png").touch()
    file = folder.parent / "poses.csv"
    file.write_text(text)
    sequence = find_sequence(folder, "latlong", Options(poses=file))
    assert sequence.frames[0].pose.angles() == pytest.approx((30, 0, 0), abs=1e-9)
    assert ("poses turn by yaw alone: taken as --frame body" in sequence.says) == (text == YAW)


@pytest.mark.parametrize("on_disk", ["NFC", "NFD"])
@pytest.mark.parametrize("door", ["--poses", "transforms.json", "captures.json"])
def test_names_are_compared_however_their_letters_are_composed(door, on_disk, folder):
    """macOS writes é as two characters, editors as one."""
    name = "salle \u00e9t\u00e9.png"
    other = {"NFC": "NFD", "NFD": "NFC"}[on_disk]
    listed = unicodedata.normalize(other, name)
    Image.fromarray(np.zeros((4, 4, 3), np.uint8)).save(folder / unicodedata.normalize(on_disk, name))
    if door == "--poses":
        (folder.parent / "poses.csv").write_text(f"name,x,y,z\n{listed},1,2,3\n", encoding="utf-8")
        (frame,) = find_sequence(folder, "latlong", Options(poses=folder.parent / "poses.csv")).frames
        np.testing.assert_array_equal(frame.pose.position, (1, 2, 3))
    elif door == "transforms.json":
        frames = [{"file_path": listed, "transform_matrix": np.eye(4).tolist()}]
        (folder / "transforms.json").write_text(json.dumps({"fl_x": 2, "w": 4, "h": 4, "frames": frames}))
        (frame,) = find_sequence(folder, "nerfstudio", Options()).frames
        assert frame.files["lit"].exists()
    else:
        view = {"position": [0, 0, 1], "fov_deg": 90, "width": 4, "height": 4}
        entry = {"file": listed, "mode": "lit", "view": view}
        (folder / "captures.json").write_text(json.dumps([entry]))
        assert import_folder(folder, folder.parent / "a.sqlite") == 1


def test_pictures_whose_names_have_no_latin_letters_are_several_places(folder):
    for name in ("\u5c45\u9593", "\u53f0\u6240"):
        (folder / f"{name}_rgb.png").touch()
    (folder.parent / "poses.csv").write_text(
        "name,x,y,z\n\u5c45\u9593_rgb.png,1,2,3\n\u53f0\u6240_rgb,4,5,6\n"
    )
    frames = find_sequence(folder, "latlong", Options(poses=folder.parent / "poses.csv")).frames
    assert sorted(frame.pose.position[0] for frame in frames) == [1, 4]


def test_the_words_of_a_job_are_no_files(tmp_path):
    """Paths in a job are relative to it, and words for axes are none."""
    (tmp_path / "path.csv").write_text("X,Y,Z,Yaw\n100,200,150,30\n")
    (tmp_path / "job.yaml").write_text(
        "source: scene://four-wall\ncameras: {a: {model: equirectangular, width: 8, height: 4}}\n"
        "poses: {file: path.csv, frame: unreal, unit: 0.02}\nout: out\n"
    )
    (pose,) = omniscv.job.load(tmp_path / "job.yaml").poses
    np.testing.assert_allclose(pose.position, (2, -4, 3))
