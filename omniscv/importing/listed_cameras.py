"""Frames whose cameras other programs list: those of Gaussian Splatting, LLFF, data sets, and Isaac."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from omniscv.arguments import number, numbers, shown, text, whole_number, within
from omniscv.errors import ArgumentError, BadReplyError
from omniscv.geometry import R_LEVEL, Array, Pose
from omniscv.geometry.trajectory_columns import Rows
from omniscv.importing.conventions import Words
from omniscv.importing.lenses import Pinhole, Wide, of_file
from omniscv.importing.listed_frames import inside
from omniscv.importing.posed_frames import (
    Files,
    Frame,
    Options,
    Sequence,
    files_in,
    numbered,
    objects_of,
    only_pictures,
)
from omniscv.pictures import foreign, hdf5, npy
from omniscv.storage.bounded import MOST_JSON_BYTES, decode_text, parse_json, read_bytes

_UNKNOWN_WORLD = "the world is that of the poses: its unit, and where up is, are not known"
_LLFF = "+y +x -z"  # where right, down and ahead point: its axes are down, right, back
_LATEST_S = 0.01  # between a picture and its pose, of ARKitScenes
_HYPERSIM_FOV_DEG = 60.0  # across, of most of its cameras
_STAMP = re.compile(r"(?:.*_)?(\d+\.\d+)")
_ISAAC_DEPTH = (("distance_to_camera", "ray"), ("distance_to_image_plane", "planar"))
_ISAAC_MASKS = (
    ("instance_segmentation", "instance_segmentation_mapping"),
    ("semantic_segmentation", "semantic_segmentation_labels"),
)
"""Words of the names of masks, and of their lists of objects; the first that is there counts."""


def gaussian_splatting(folder: Path, options: Options) -> Sequence:
    """Return the frames of ``cameras.json`` as 3D Gaussian Splatting writes it.

    Poses have COLMAP's axes, and the middle of a picture is its centre.

    Args:
        folder: of the file.
        options: of the user.
    """
    with within("cameras.json"):
        entries = parse_json(read_bytes(folder / "cameras.json", MOST_JSON_BYTES))
        if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
            raise ArgumentError("expected a list of cameras, got another value")
    if not entries:
        raise ArgumentError("cameras.json: expected cameras, got an empty list")
    rows: list[tuple[str, dict[str, Any]]] = []
    for i, entry in enumerate(entries):
        pose = {"position": entry.get("position"), "rotation": entry.get("rotation")}
        rows.append((f"cameras.json[{i}]", pose))
    positions, rotations = Rows.of_entries(rows).poses("camera")
    frames: list[Frame] = []
    for i, entry in enumerate(entries):
        with within(f"cameras.json[{i}]"):
            name = text("img_name", entry.get("img_name"))
            width = whole_number("width", entry.get("width"))
            height = whole_number("height", entry.get("height"))
            fx = number("fx", entry.get("fx"), above=0)
            fy = number("fy", entry.get("fy"), above=0)
            lens: Pinhole | Wide | None = Pinhole(fx, fy, width / 2, height / 2, width, height)
            if options.intrinsics:
                lens = of_file(options.intrinsics, (width, height))
            frames.append(Frame({"lit": _picture(folder, name)}, Pose(positions[i], rotations[i]), lens, {}))
    return Sequence(frames, says=(_UNKNOWN_WORLD,))


def _picture(folder: Path, name: str) -> Path:
    """Return the picture of a name, whose suffix may be missing, in the folder or in its ``images``."""
    names = [name]
    if Path(name).suffix.lower() not in foreign.SUFFIXES:
        names = [name + suffix for suffix in foreign.SUFFIXES]
    for place in ("images", "input", ""):
        for file_name in names:
            path = inside(folder, str(Path(place) / file_name))
            if path.exists():
                return path
    raise ArgumentError(f"expected a picture {shown(name)} in images/ or beside it, got none; copy it there")


def llff(folder: Path, options: Options) -> Sequence:
    """Return the frames of LLFF's ``poses_bounds.npy``: 17 numbers for each picture, by name.

    ``folder`` is that of the file; ``options`` are of the user.
    """
    with within("poses_bounds.npy"):
        try:
            table = npy.decode(read_bytes(folder / "poses_bounds.npy", MOST_JSON_BYTES)).astype(np.float64)
        except BadReplyError as cause:
            raise ArgumentError(str(cause)) from cause
        if table.ndim != 2 or table.shape[1] != 17:
            raise ArgumentError(f"expected 17 numbers for each picture, got shape {table.shape}")
    place = folder / "images"
    if not place.is_dir():
        place = folder
    pictures = only_pictures(files_in(place, options))
    if len(pictures) != len(table):
        actual = f"{len(pictures)} pictures in {place.name}/ and {len(table)} rows"
        raise ArgumentError(f"poses_bounds.npy: expected a row for each picture, by name, got {actual}")
    matrices = table[:, :15].reshape(-1, 3, 5)
    rows: list[tuple[str, dict[str, Any]]] = []
    for i, matrix in enumerate(matrices):
        rows.append((f"row {i + 1}", {"transform_matrix": matrix[:, :4]}))
    R, positions = _by_words(rows, Words(_LLFF))
    frames: list[Frame] = []
    for i, (height, width, focal) in enumerate(matrices[:, :, 4].tolist()):
        with within(f"row {i + 1}"):
            size = (whole_number("width", int(width)), whole_number("height", int(height)))
            focal = number("focal length", focal, above=0)
        lens: Pinhole | Wide | None = Pinhole(focal, focal, width / 2, height / 2, width, height)
        if options.intrinsics:
            lens = of_file(options.intrinsics, size)
        frames.append(Frame({"lit": pictures[i]}, Pose(positions[i], R[i]), lens, {}))
    return Sequence(frames, says=(_UNKNOWN_WORLD,), words=Words(_LLFF))


def _by_words(rows: list[tuple[str, dict[str, Any]]], words: Words) -> tuple[Array, Array]:
    """Return rotations and positions of matrices whose axes have no name."""
    positions, rotations = Rows.of_entries(rows).poses("camera")
    return rotations @ words.convention.C, positions


def arkit_scenes(folder: Path, options: Options) -> Sequence:
    """Return the frames of ARKitScenes: ``lowres_wide`` and ``lowres_depth``, and a text of poses.

    Poses are from the world to the camera, each a time, an axis times its angle, and a translation.

    Args:
        folder: of a scene.
        options: of the user.
    """
    from scipy.spatial.transform import Rotation  # slow to load

    file = min(folder.glob("*.traj"))
    with within(file.name):
        lines = decode_text(read_bytes(file, MOST_JSON_BYTES)).splitlines()
        table = numbers("poses", [line.split() for line in lines if line.strip()], (None, 7))
    R_c_w = Rotation.from_rotvec(table[:, 1:4].copy()).as_matrix()
    R_w_c = R_c_w.swapaxes(1, 2)
    positions = -np.einsum("nij,nj->ni", R_w_c, table[:, 4:])
    frames: list[Frame] = []
    late = 0
    for picture in files_in(folder, options):
        match = _STAMP.fullmatch(picture.stem)
        if match is None or picture.parent.name != "lowres_wide":
            continue
        time = float(match[1])
        i = int(np.abs(table[:, 0] - time).argmin())
        if abs(table[i, 0] - time) > _LATEST_S:
            late += 1
            continue
        paths = {"lit": picture}
        if (depth := folder / "lowres_depth" / picture.name).exists():
            paths["depth"] = depth
        lens = _pincam(folder, picture, options)
        frames.append(Frame(paths, Pose(positions[i], R_w_c[i]), lens, {"depth": Files(unit="mm")}))
    says = (f"{late} pictures left out: no pose within {_LATEST_S} s",) if late else ()
    return Sequence(frames, says=says)


def _pincam(folder: Path, picture: Path, options: Options) -> Pinhole | Wide | None:
    """Return the lens of a picture: width, height, fx, fy, cx, cy in a line."""
    file = folder / "lowres_wide_intrinsics" / f"{picture.stem}.pincam"
    if options.intrinsics:
        return of_file(options.intrinsics, (0, 0))
    if not file.exists():
        expected = f"expected its lens in lowres_wide_intrinsics/{file.name}"
        raise ArgumentError(f"{expected}, or --intrinsics FILE; got none")
    with within(file.name):
        words = decode_text(read_bytes(file, MOST_JSON_BYTES)).split()
        width, height, fx, fy, cx, cy = numbers("lens", words, (6,)).tolist()
        return Pinhole(number("fx", fx, above=0), number("fy", fy, above=0), cx, cy, width, height)


def sun_rgbd(folder: Path, options: Options) -> Sequence:
    """Return the frame of a scene of SUN RGB-D, which is a world of its own.

    Its camera is at the origin, and ``extrinsics`` turns its axes (x right, y down, z ahead) to level ones.

    Args:
        folder: of a scene.
        options: of the user.
    """
    scenes = sorted({file.parent.parent for file in folder.glob("*/**/extrinsics/*.txt")})
    if not (folder / "extrinsics").is_dir() and scenes:
        example = shown(scenes[0].relative_to(folder).as_posix())
        expected = "expected the folder of one scene, because each is a world of its own"
        raise ArgumentError(f"{expected}, got {len(scenes)} of them; import one, such as {example}")
    lit = _only_picture(folder / "image")
    if lit is None:
        raise ArgumentError("expected one picture in image/, got none")
    paths = {"lit": lit}
    says = ["the camera is at the origin; objects of seg.mat and annotation2Dfinal are not taken"]
    depth = _only_picture(folder / "depth")
    filled = _only_picture(folder / "depth_bfx")
    if depth is not None:
        paths["depth"] = depth
    elif filled is not None:
        paths["depth"] = filled
        says.append("depth_bfx is a guess where the sensor saw nothing; depth/ is what it saw")
    pose = Pose(np.zeros(3), R_LEVEL @ _tilt(folder))
    lens = _sun_rgbd_lens(folder, lit, options)
    return Sequence([Frame(paths, pose, lens, {"depth": Files(unit="sunrgbd")})], says=tuple(says))


def _only_picture(folder: Path) -> Path | None:
    """Return the picture in a folder; None if there is no folder, or none in it."""
    if not folder.is_dir():
        return None
    pictures = only_pictures(sorted(folder.iterdir()))
    if len(pictures) > 1:
        raise ArgumentError(f"{folder.name}: expected the picture of one scene, got {len(pictures)}")
    return pictures[0] if pictures else None


def _tilt(folder: Path) -> Array:
    """Return the rotation (3, 3) from a camera of SUN RGB-D to level axes: of several files the last one."""
    files = sorted((folder / "extrinsics").glob("*.txt"))
    if not files:
        raise ArgumentError("expected a rotation in extrinsics/, got no text")
    with within(f"extrinsics/{files[-1].name}"):
        words = decode_text(read_bytes(files[-1], MOST_JSON_BYTES)).split()
        matrix = numbers("rotation", words, (12,)).reshape(3, 4)
        row = Rows.of_entries([("rotation", {"transform_matrix": np.vstack([matrix, [0, 0, 0, 1]])})])
        _, (rotation,) = row.poses("camera")
        return np.asarray(rotation)


def _sun_rgbd_lens(folder: Path, lit: Path, options: Options) -> Pinhole | Wide | None:
    """Return the lens of ``intrinsics.txt``: a matrix whose first pixel has its centre at 0."""
    height, width = foreign.read(lit, "lit").pixels.shape[:2]
    if options.intrinsics:
        return of_file(options.intrinsics, (width, height))
    with within("intrinsics.txt"):
        words = decode_text(read_bytes(folder / "intrinsics.txt", MOST_JSON_BYTES)).split()
        fx, _, cx, _, fy, cy, *_ = numbers("matrix", words, (9,)).tolist()
        fx = number("fx", fx, above=0)
        fy = number("fy", fy, above=0)
        return Pinhole(fx, fy, cx + 0.5, cy + 0.5, width, height)


def hypersim(folder: Path, options: Options) -> Sequence:
    """Return the frames of a scene of Hypersim: positions are in units of the scene, colours are light.

    ``folder`` is that of the scene; ``options`` are of the user.
    """
    unit_m = _asset_unit(folder / "_detail" / "metadata_scene.csv")
    frames: list[Frame] = []
    for camera in sorted((folder / "_detail").glob("cam_*")):
        indices = _keyframes(camera, "frame_indices", (None,))
        positions = _keyframes(camera, "positions", (None, 3))
        rotations = _keyframes(camera, "orientations", (None, 3, 3))
        if not len(indices) == len(positions) == len(rotations):
            raise ArgumentError(f"{camera.name}: expected a position and an orientation of each keyframe")
        for index, position, rotation in zip(indices, positions, rotations, strict=True):
            stem = f"frame.{int(index):04d}"
            paths = _hypersim_files(folder / "images", f"scene_{camera.name}", stem)
            if not paths:
                continue  # it was left out of the data set
            matrix = np.vstack([np.column_stack([rotation, position]), [0, 0, 0, 1]])
            row = Rows.of_entries([(f"{camera.name} {stem}", {"transform_matrix": matrix})])
            (t_w_c,), (R_w_c,) = row.poses("opengl", unit_m)
            holds = {"depth": Files(kind="ray", unit="m")}
            frames.append(Frame(paths, Pose(t_w_c, R_w_c), _hypersim_lens(paths, options), holds))
    said = f"lens of {_HYPERSIM_FOV_DEG:g} degrees; --intrinsics says another"
    return Sequence(frames, says=() if options.intrinsics else (said,), words=Words("opengl"))


def _hypersim_lens(paths: Mapping[str, Path], options: Options) -> Pinhole | Wide | None:
    mode = next(iter(paths))
    height, width = foreign.read(paths[mode], mode).pixels.shape[:2]
    if options.intrinsics:
        return of_file(options.intrinsics, (width, height))
    focal = width / 2 / np.tan(np.radians(_HYPERSIM_FOV_DEG / 2))
    return Pinhole(focal, focal, width / 2, height / 2, width, height)


def _asset_unit(file: Path) -> float:
    """Return the metres of a unit of a scene, by the table of its parameters."""
    with within(file.name):
        values = {}
        for line in decode_text(read_bytes(file, MOST_JSON_BYTES)).splitlines():
            cells = line.split(",")
            if len(cells) == 2:
                values[cells[0].strip()] = cells[1].strip()
        return number("meters_per_asset_unit", values.get("meters_per_asset_unit"), above=0)


def _keyframes(camera: Path, name: str, shape: tuple[int | None, ...]) -> Array:
    file = camera / f"camera_keyframe_{name}.hdf5"
    with within(f"{camera.name}/{file.name}"):
        if not file.exists():
            raise ArgumentError("expected the keyframes of a camera, got no file")
        return numbers(name, hdf5.read(file).astype(np.float64), shape)


def _hypersim_files(images: Path, camera: str, stem: str) -> dict[str, Path]:
    """Return the pictures of a frame by mode; colours are light where that is there, else the preview's."""
    final = images / f"{camera}_final_hdf5" / f"{stem}.color.hdf5"
    preview = images / f"{camera}_final_preview" / f"{stem}.tonemap.jpg"
    geometry = images / f"{camera}_geometry_hdf5"
    paths = {
        "lit": final if final.exists() else preview,
        "depth": geometry / f"{stem}.depth_meters.hdf5",
        "object_mask": geometry / f"{stem}.semantic_instance.hdf5",
    }
    return {mode: paths[mode] for mode in paths if paths[mode].exists()}


def isaac(folder: Path, options: Options) -> Sequence:
    """Return the frames of Isaac Replicator's BasicWriter, whose option ``camera_params`` is on.

    ``folder`` is where it wrote them; ``options`` are of the user.
    """
    frames: list[Frame] = []
    names: set[str] = set()
    for file in files_in(folder, options):
        match = re.fullmatch(r"camera_params_(\d+)\.json", file.name)
        if match is None:
            continue
        with within(file.name):
            pose, pinhole = _isaac_camera(parse_json(read_bytes(file, MOST_JSON_BYTES)))
            lens: Pinhole | Wide | None = pinhole
            if options.intrinsics:
                lens = of_file(options.intrinsics, (int(pinhole.width), int(pinhole.height)))
        paths, kind, listed = _isaac_files(file.parent, match[1])
        frames.append(Frame(paths, pose, lens, {"depth": Files(kind=kind, unit="m")}, names=listed))
        if listed is not None:
            names.update(objects_of(listed).names())
    return Sequence(frames, numbered(names), words=Words("opengl"))


def _isaac_files(folder: Path, number: str) -> tuple[dict[str, Path], str, Path | None]:
    """Return the pictures of a frame by mode, the kind of its depth, and the list of its objects."""
    paths: dict[str, Path] = {}
    for suffix in ("png", "jpg", "jpeg"):
        if (lit := folder / f"rgb_{number}.{suffix}").exists():
            paths["lit"] = lit
    kind = "planar"
    for word, own_kind in _ISAAC_DEPTH:
        if (depth := folder / f"{word}_{number}.npy").exists():
            paths["depth"] = depth
            kind = own_kind
            break
    for word, list_word in _ISAAC_MASKS:
        mask = folder / f"{word}_{number}.png"
        if not mask.exists():
            continue
        table = folder / f"{list_word}_{number}.json"
        if not table.exists():
            raise ArgumentError(f"{mask.name}: expected the list of its objects, {table.name}, got none")
        return {**paths, "object_mask": mask}, kind, table
    return paths, kind, None


def _isaac_camera(data: Mapping[str, Any]) -> tuple[Pose, Pinhole]:
    """Return pose and lens of ``camera_params``: matrices of row vectors, OpenGL's axes."""
    if data.get("cameraModel", "pinhole") not in ("pinhole", "pinholeOpenCV"):
        model = shown(data["cameraModel"])
        raise ArgumentError(f"cameraModel: expected pinhole, got {model}; give its lens by --intrinsics")
    view = numbers("cameraViewTransform", data.get("cameraViewTransform"), (16,)).reshape(4, 4)
    projection = numbers("cameraProjection", data.get("cameraProjection"), (16,)).reshape(4, 4)
    width, height = numbers("renderProductResolution", data.get("renderProductResolution"), (2,)).tolist()
    unit_m = number("metersPerSceneUnit", data.get("metersPerSceneUnit", 1.0), above=0)
    to_world = np.linalg.inv(view).T
    to_world[3] = 0, 0, 0, 1  # but for rounding
    row = Rows.of_entries([("cameraViewTransform", {"transform_matrix": to_world})])
    (position,), (rotation,) = row.poses("opengl", unit_m)
    lens = Pinhole(
        fx=projection[0, 0] * width / 2,
        fy=projection[1, 1] * height / 2,
        cx=(1 - projection[2, 0]) * width / 2,
        cy=(1 + projection[2, 1]) * height / 2,
        width=width,
        height=height,
    )
    return Pose(position, rotation), lens
