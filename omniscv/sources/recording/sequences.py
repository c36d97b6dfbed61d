"""Import frames with poses: a table of published layouts, and layouts of the user's own.

A layout is data: which files there are, what their numbers mean, where poses are, in which axes
(docs/capture-folders.md). nerfstudio's ``transforms.json`` and the TUM RGB-D benchmark list their frames.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, partial
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from omniscv.arguments import flag, number, numbers, one_of, shown, text, within
from omniscv.errors import ArgumentError
from omniscv.geometry import R_LEVEL, Array, Pose, cube_rotations, pinhole
from omniscv.geometry.instant import turn_about_z
from omniscv.geometry.trajectory_files import read_trajectory
from omniscv.records import checked, mapping, nested, optional, read, record
from omniscv.sources import codecs, pictures
from omniscv.sources.base import Capture, Lens, ObjectTable, Request, View
from omniscv.sources.pictures import DepthForm, Picture, Pixels, read_picture
from omniscv.sources.recording.layouts import LAYOUTS
from omniscv.storage.bounded import MOST_JSON_BYTES, parse_json, parse_yaml, read_bytes

NO_ID = 0xFFFF
MODE_WORDS = {
    "depth": {"depth", "depths", "zdepth"},
    "object_mask": {"mask", "masks", "seg", "segmentation", "semantic", "instance", "instances"},
    "normals": {"normal", "normals"},
    "lit": {"rgb", "color", "colour", "lit", "pano"},
}
PANORAMAS = {"latlong": 0, "openexr-latlong": 1}
"""Layouts of one picture 2:1. Of 1, the first and the last column show one meridian, of OpenEXR's axes."""
_FRONT = cube_rotations()[0][1]
_I, _GL = np.eye(3), np.diag([1.0, -1, -1])
_AXES = {
    "camera": (_I, _I),
    "opengl": (_I, _GL),
    "body": (_I, R_LEVEL),
    "ned": (_GL, np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])),
}
"""W and C of ``R_w_c = W R C``: from the file's world to ours, and from our camera to the file's."""
_SAME, _RIGID = 2e-3, 1e-3  # of a rotation's entries: poses have six digits or fewer
_SAME_PLACE_M, _SAME_SHAPE = 1e-3, 0.01
_LATEST_S = 0.02  # between stamps of colour, depth and pose of the TUM benchmark
_HEX = re.compile("0x[0-9a-fA-F]{1,8}")
_COLUMNS = ("x", "y", "z", "yaw", "pitch", "roll", "qx", "qy", "qz", "qw")

PRESETS = r"""
ob3d:
  found: cameras/*_cam.json
  pictures: latlong
  place: 'cameras/(?P<i>[^/]+)_cam\.json'
  lit: 'images/{i}_rgb.png'
  depth: {file: 'depths/{i}_depth.exr', kind: ray}
  poses: {file: 'cameras/{i}_cam.json', rotation: 0.extrinsics.rotation, position: 0.extrinsics.translation,
          inverse: true}
tartanground:
  found: '*_metadata.json'
  pictures: faces
  place: '(?:image|depth|seg)_(?P<side>[lr]cam)_(?P<face>[a-z]+)/(?P<i>\d+)_[^/]*\.png'
  lit: 'image_{side}_{face}/{i}_{side}_{face}.png'
  depth: {file: 'depth_{side}_{face}/{i}_{side}_{face}_depth.png', unit: tartanair}
  object_mask: {file: 'seg_{side}_{face}/{i}_{side}_{face}_seg.png', ids: grey, names: seg_label_map.json}
  poses: {file: 'pose_{side}_front.txt', row: i, axes: ned, agrees: 'pose_{side}_{face}.txt'}
structured3d:
  found: '**/panorama/camera_xyz.txt'
  pictures: latlong
  place: '(?P<room>.*?)panorama/full/rgb_rawlight\.png'
  lit: '{room}panorama/full/rgb_rawlight.png'
  depth: {file: '{room}panorama/full/depth.png', kind: ray, unit: mm}
  object_mask: {file: '{room}panorama/full/instance.png', ids: grey, missing: 65535}
  poses: {file: '{room}panorama/camera_xyz.txt', unit: mm, yaw_deg: -90}
2d3ds:
  found: '**/pano/rgb/*_domain_rgb.png'
  pictures: latlong
  place: '(?P<area>.*?)pano/rgb/(?P<name>[^/]+)_rgb\.png'
  lit: '{area}pano/rgb/{name}_rgb.png'
  depth: {file: '{area}pano/depth/{name}_depth.png', kind: ray, unit: 1/512, missing: 65535}
  object_mask: {file: '{area}pano/semantic/{name}_semantic.png', ids: rgb24, names: semantic_labels.json,
                missing: 0x0D0D0D}
  poses: {file: '{area}pano/pose/{name}_pose.json', position: camera_location}
  says: the heading of these panoramas is not known, it is taken as 0
"""
"""Layouts as data; sources: docs/capture-folders.md."""
_TUM = {
    "freiburg1": (517.3, 516.5, 318.6, 255.3, 0.2624, -0.9531, -0.0054, 0.0026, 1.1633),
    "freiburg2": (520.9, 521.0, 325.1, 249.7, 0.2312, -0.7849, -0.0033, -0.0001, 0.9172),
    "freiburg3": (535.4, 539.2, 320.1, 247.6),
    "": (525.0, 525.0, 319.5, 239.5),
}
"""By a word in the folder's name: fx, fy, cx, cy of 640 x 480 px, centres at whole numbers; distortion."""


class Options(NamedTuple):
    """What the user says of pictures, as :func:`omniscv.sources.recording.importing.import_pictures` has it;
    None or False: nothing."""

    depth: DepthForm | None = None
    pose: Pose | None = None
    poses: Path | None = None
    missing: tuple[float, ...] = ()
    mirrored: bool = False
    clip: bool = False
    clipped: dict[str, int] = {}  # noqa: RUF012 - given anew for each import


class Pinhole(NamedTuple):
    """Focal lengths and centre in px of a size, pixel centres at .5, and OpenCV's distortion; 0 x 0: of the
    size of a frame's first picture."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: float = 0
    height: float = 0
    distortion: tuple[float, ...] = ()

    def scaled(self, width: int, height: int) -> Pinhole:
        """Return the lens of pictures of another size; ArgumentError for another shape."""
        across, down = width / (self.width or width), height / (self.height or height)
        if abs(across / down - 1) > _SAME_SHAPE:
            expected = f"expected the shape of {self.width:g} x {self.height:g}, as its lens"
            raise ArgumentError(f"{expected}, got {width} x {height}")
        px = self.fx * across, self.fy * down, self.cx * across, self.cy * down
        return Pinhole(*px, width, height, self.distortion)

    def view(self, pose: Pose) -> View:
        """Return the view of a picture without distortion."""
        lens = Lens(self.fy / self.fx, self.cx / self.width - 0.5, self.cy / self.height - 0.5)
        size = int(self.width), int(self.height)
        return View(pose, pinhole.fov_deg(self.width, self.fx), *size, None if lens == Lens() else lens)

    def straight(self, pixels: Pixels, blend: bool) -> tuple[Pixels, Pinhole]:
        """Return a picture without distortion, of what it shows all over, and its lens."""
        import cv2

        K = np.array([[self.fx, 0, self.cx - 0.5], [0, self.fy, self.cy - 0.5], [0, 0, 1]])
        size, bent = (int(self.width), int(self.height)), np.array(self.distortion)
        K_new, _ = cv2.getOptimalNewCameraMatrix(K, bent, size, 0)
        maps = cv2.initUndistortRectifyMap(K, bent, _I, K_new, size, cv2.CV_32FC1)
        (fx, _, cx), (_, fy, cy) = K_new[:2].tolist()
        straight = cv2.remap(pixels, *maps, cv2.INTER_LINEAR if blend else cv2.INTER_NEAREST)
        return straight, Pinhole(fx, fy, cx + 0.5, cy + 0.5, *size)


def _values(name: str, value: Any) -> tuple[float, ...]:
    """Return a number, or a list of some, as a tuple; texts may be hexadecimal."""
    items = value if isinstance(value, list | tuple) else [value]
    return tuple(int(v, 16) if isinstance(v, str) and _HEX.fullmatch(v) else number(name, v) for v in items)


def _intrinsics(name: str, value: Any) -> Pinhole | None:
    if value is None or isinstance(value, Pinhole):
        return value
    keys = ("fx", "fy", "cx", "cy", "centers")
    given = {"centers": 0.5} | mapping(name, value, (*keys, "distortion"))
    fx, fy, cx, cy, center = (number(f"{name}.{key}", given.get(key)) for key in keys)
    bent = _values(name, given.get("distortion", ()))
    return Pinhole(fx, fy, cx + 0.5 - center, cy + 0.5 - center, distortion=bent)


@record
class Files:
    """The pictures of a mode: a pattern of their names, and what their numbers are."""

    file: str = checked(text, default="")
    kind: str = checked(one_of, words=("planar", "ray"), default="planar")
    unit: str = checked(text, default="")
    missing: tuple[float, ...] = checked(_values, default=())
    ids: str = checked(one_of, words=("grey", "rgb24", "colors"), default="")
    names: str = checked(text, default="")

    @property
    def form(self) -> DepthForm:
        """What the numbers of depth are."""
        if not self.unit:
            return DepthForm(self.kind == "ray", missing=self.missing)
        packed = self.unit in pictures.PACKED
        return DepthForm.parse(self.unit if packed else f"{self.kind}-{self.unit}", self.missing)


def _files(name: str, value: Any, keys: tuple[str, ...] = ()) -> Any:
    given = {"file": value} if isinstance(value, str) else value
    return given if isinstance(given, Files) else read(Files, mapping(name, given, ("file", *keys)), name)


@record
class _Poses:
    """Where poses are: texts of numbers or JSON by frame, or a text with a row of each, by number or name."""

    file: str = checked(text)
    row: str = checked(text, default="")
    position: str = checked(text, default="")
    rotation: str = checked(text, default="")
    axes: str = checked(one_of, words=_AXES, default="camera")
    inverse: bool = checked(flag, default=False)
    unit: str = checked(one_of, words=pictures.PER_M, default="m")
    yaw_deg: float = checked(number, default=0.0)
    agrees: str = checked(text, default="")


@record
class Layout:
    """The keys of ``--layout my.yaml``."""

    pictures: str = checked(one_of, words=("latlong", "faces", "pinhole"))
    place: str = checked(text)
    lit: Files | None = checked(_files, default=None)
    depth: Files | None = checked(_files, keys=("kind", "unit", "missing"), default=None)
    object_mask: Files | None = checked(_files, keys=("ids", "names", "missing"), default=None)
    poses: _Poses | None = checked(nested(_Poses), default=None)
    position: Any = checked(optional(partial(numbers, shape=(3,))), default=None)
    intrinsics: Pinhole | None = checked(_intrinsics, default=None)
    faces: str = checked(one_of, words=LAYOUTS, default="top-bottom")
    found: str = checked(text, default="")
    says: str = checked(text, default="")


@dataclass
class Frame:
    """Pictures from one pose: files, and what they hold, by mode; ``lens`` is None for panoramas."""

    files: dict[str, Path]
    pose: Pose
    lens: Pinhole | None
    holds: Mapping[str, Files]


@dataclass(frozen=True)
class Sequence:
    """Pictures with poses.

    Attributes:
        frames: in order.
        objects: of masks; empty: as the masks show.
        says: lines for people.
        of_openexr: as :func:`omniscv.sources.pictures.to_faces`.
        layout: its name.
        options: of the user.
    """

    frames: list[Frame]
    objects: ObjectTable = field(default_factory=lambda: ObjectTable({}))
    says: tuple[str, ...] = ()
    of_openexr: int = 0
    layout: str = ""
    options: Options = field(default_factory=Options)

    @property
    def modes(self) -> Counter[str]:
        """Number of pictures by mode."""
        return Counter(mode for frame in self.frames for mode in frame.files)

    def lines(self) -> tuple[str, ...]:
        """Return what was found, for people."""
        places = len({tuple(frame.pose.position) for frame in self.frames})
        counts = ", ".join(f"{count} of {mode}" for mode, count in self.modes.items())
        bent = sum(frame.lens is not None and any(frame.lens.distortion) for frame in self.frames)
        says = [f"{bent} frames resampled, so that they have no distortion"] if bent else []
        return (f"layout {self.layout}: {places} place{'s' * (places != 1)}, {counts}", *self.says, *says)

    def captures(self) -> Iterator[Capture]:
        """Yield the captures; ArgumentError names the picture that cannot be read."""
        for frame in self.frames:
            lens = frame.lens
            for mode, file in frame.files.items():
                if not file.exists():
                    raise ArgumentError(f"{file.name}: expected a picture, got no file")
                holds = frame.holds.get(mode, Files())
                form = self.options.depth or holds.form
                picture = read_as(file, mode, self.options, form)
                with within(file.name):
                    picture = _of_ids(picture, holds) if mode == "object_mask" else picture
                    lens = lens and (lens if lens.width else lens.scaled(*picture.pixels.shape[1::-1]))
                    provenance = {"server": "imported", "file": file.name, "layout": self.layout}
                    for view, part in self._views(picture, mode, frame.pose, lens):
                        yield capture_of(part, mode, view, provenance, form.ray)

    def _views(
        self, picture: Picture, mode: str, pose: Pose, lens: Pinhole | None
    ) -> Iterator[tuple[View, Picture]]:
        height, width = picture.pixels.shape[:2]
        if lens is None:
            if width != 2 * height:
                raise ArgumentError(f"expected a panorama twice as wide as high, got {width} x {height}")
            step_m = picture.step_m
            for pixels, R, fov_deg in pictures.to_faces(picture.pixels, mode, self.of_openexr, step_m):
                face = Pose(pose.position, pose.R_w_c @ _FRONT.T @ R)
                yield View(face, fov_deg, *pixels.shape[1::-1]), picture.converted(pixels)
            return
        lens = lens.scaled(width, height)
        if any(lens.distortion):
            if mode == "depth":
                error = pictures.panorama_error(picture.pixels, picture.step_m)
                picture = picture._replace(error=lens.straight(error, False)[0])
            pixels, lens = lens.straight(picture.pixels, mode == "lit")
            picture = picture.converted(pixels)
        yield lens.view(pose), picture


def read_as(file: Path, mode: str, options: Options, form: DepthForm) -> Picture:
    """Return a picture as the user says that it is; what is clipped is counted."""
    missing = form.missing + options.missing
    picture = read_picture(file, mode, form._replace(missing=missing), options.clip)
    options.clipped[str(file)] = picture.clipped
    return picture.converted(picture.pixels[:, ::-1]) if options.mirrored else picture


def _of_ids(picture: Picture, holds: Files) -> Picture:
    """Return a mask whose ids are as a layout says."""
    pixels = picture.pixels
    if holds.ids == "grey" and pixels.ndim == 3:
        if (pixels != pixels[..., :1]).any():
            raise ArgumentError("expected grey ids, got colours")
        pixels = pixels[..., 0].astype(np.uint16)
        picture = picture._replace(pixels=pixels, encoding="png ids" if picture.encoding else "")
    if holds.ids == "rgb24":  # of a grey pixel, three equal digits
        digits = np.repeat(pixels[..., None], 3, axis=-1) if pixels.ndim == 2 else pixels
        pixels = digits @ np.array([65536, 256, 1], np.uint32)
    if pixels.ndim == 3 or (pixels is picture.pixels and not holds.missing):
        return picture
    pixels = np.where(np.isin(pixels, holds.missing), NO_ID, pixels)
    if pixels.max() > NO_ID:
        raise ArgumentError(f"expected ids of at most {NO_ID}, got {pixels.max()}")
    same = np.array_equal(pixels, picture.pixels)
    return picture if same else picture.converted(pixels.astype(np.uint16))


def capture_of(
    picture: Picture, mode: str, view: View, provenance: Mapping[str, Any], ray: bool = False
) -> Capture:
    """Return the capture of a picture: as its file has it where a codec decodes that, else lossless.

    ``ray`` is whether depth (h, w) is along the ray; depth (h, w, 2) is planar, and has its error.
    """
    pixels, request = picture.pixels, Request(view, mode)
    if picture.encoding:
        return Capture(request, view, pixels, provenance, picture.payload, picture.encoding)
    if mode == "depth" and pixels.ndim == 2:
        lengths, error = view.ray_lengths(), picture.error
        if error is None and picture.step_m:
            error = np.where(pixels < np.inf, picture.step_m / 2, np.inf)
        pixels = np.asarray(pixels / lengths if ray else pixels, np.float32)
        if error is not None:
            pixels = np.stack([pixels, np.asarray(error if ray else error * lengths, np.float32)], axis=-1)
    if mode == "lit" and pixels.dtype == np.uint16:
        pixels = np.round(pixels / 257).astype(np.uint8)
    payload, encoding = codecs.encode(np.ascontiguousarray(pixels))
    if mode == "depth" and pixels.ndim == 3:
        return Capture(request, view, pixels[..., 0], provenance, payload, codecs.BOUNDED)
    return Capture(request, view, pixels, provenance, payload, encoding)


# -- Finding frames --------------------------------------------------------------------------------------


@cache
def _finders() -> dict[str, tuple[str, Callable[[Path, Options], Sequence]]]:
    """Return, by layout, the pattern of a file by which it is found, and its reader."""
    rows = {name: read(Layout, data, name) for name, data in parse_yaml(PRESETS).items()}
    rows["tartanair"] = replace(rows["tartanground"], found="image_?cam_front")
    finders: dict[str, Any] = {
        name: (row.found, partial(_of_layout, layout=row)) for name, row in rows.items()
    }
    finders |= {"nerfstudio": ("transforms*.json", _nerfstudio), "tum": ("rgb.txt", _tum)}
    return finders | {"latlong": ("", _panoramas), "openexr-latlong": ("", partial(_panoramas, of_openexr=1))}


def sequences() -> tuple[str, ...]:
    """Return the names of layouts of frames with poses, and of panoramas."""
    return tuple(_finders())


def find_sequence(path: Path, layout: str, options: Options) -> Sequence | None:
    """Return the frames of a folder, or of one panorama; None where it is none of these layouts.

    Args:
        path: of the folder or picture.
        layout: one of :func:`sequences`, ``auto`` for what lies there, or a file ``.yaml`` of a layout.
        options: of the user.

    Raises:
        ArgumentError: files of a layout without poses, or poses that contradict each other.
    """
    find: Any = None
    if layout.endswith((".yaml", ".yml")):
        with within(layout):
            data = read_bytes(Path(layout), MOST_JSON_BYTES).decode("utf-8", "replace")
            find = partial(_of_layout, layout=read(Layout, parse_yaml(data)), strict=True)
        layout = Path(layout).stem
    elif layout == "auto":
        named = (name for name, (found, _) in _finders().items() if found and any(path.glob(found)))
        layout = next(named, "latlong" if _is_panoramas(path) else "")
    if find is None and layout not in _finders():
        return None
    try:
        sequence = (find or _finders()[layout][1])(path, options)
    except ArgumentError:
        raise
    except (ValueError, LookupError, TypeError, AttributeError, OSError) as cause:
        got = f"{type(cause).__name__} {shown(str(cause))}"
        raise ArgumentError(f"expected a folder of layout {layout}, got {got}") from cause
    if not sequence.modes:
        raise ArgumentError(f"expected pictures of layout {layout}, got none")
    said = {"position or yaw": options.pose, "poses": options.poses, "mirrored": options.mirrored}
    if given := [name for name, value in said.items() if value and layout not in PANORAMAS]:
        raise ArgumentError(f"{given[0]}: expected none, because layout {layout} says it")
    _share_places(sequence.frames)
    return replace(sequence, layout=layout, options=options)


def _share_places(frames: list[Frame]) -> None:
    """Move frames within a millimetre of an earlier one to its position."""
    positions = np.array([frame.pose.position for frame in frames])
    owner = list(range(len(frames)))
    for i, near in enumerate(KDTree(positions).query_ball_point(positions, _SAME_PLACE_M)):
        owner[i] = min((j for j in near if j < i and owner[j] == j), default=i)
    for frame, j in zip(frames, owner, strict=True):
        frame.pose = Pose(positions[j], frame.pose.R_w_c)


def _of_layout(folder: Path, options: Options, layout: Layout, strict: bool = False) -> Sequence:
    """Return the frames of a layout that is data; ``strict``: each mode must have files."""
    lens = Pinhole(1, 1, 1, 1, 2, 2) if layout.pictures == "faces" else layout.intrinsics
    is_posed = bool(layout.poses) != (layout.position is not None)
    if not is_posed or (lens is None) != (layout.pictures == "latlong"):
        expected = "expected poses or a position, and intrinsics of pinhole pictures only"
        raise ArgumentError(f"{expected}; got none, or too many")
    files = {"lit": layout.lit, "depth": layout.depth, "object_mask": layout.object_mask}
    holds = {mode: form for mode, form in files.items() if form}
    place, frames = re.compile(f"(?:.*/)??(?:{layout.place})"), dict[tuple[str, ...], Frame]()
    poses_in, unposed = cache(_poses_in), 0
    for file in sorted(folder.rglob("[!.]*")):
        match = place.fullmatch(file.relative_to(folder).as_posix())
        if match is None or match.groups() in frames:
            continue
        paths = {mode: _filled(folder, form.file, match) for mode, form in holds.items()}
        paths = {mode: path for mode, path in paths.items() if path.exists()}
        pose = _pose(folder, layout, match, poses_in) if paths else None
        unposed += bool(paths) and pose is None
        if pose is not None:
            frames[match.groups()] = Frame(paths, pose, lens, holds)
    says = [layout.says] if layout.says else []
    says += [f"{unposed} frames left out: their poses are not finite"] if unposed else []
    for mode, form in holds.items() if strict and frames else ():
        if lacking := sum(mode not in frame.files for frame in frames.values()):
            says.append(f"{mode}: {lacking} of {len(frames)} frames have none")
        if lacking == len(frames):
            raise ArgumentError(f"{mode}: expected files {form.file}, got none")
    names = layout.object_mask.names if layout.object_mask else ""
    near = [at / names for at in (folder, *folder.absolute().parents[:2])] if names else []
    table = next((objects_of(file) for file in near if file.exists()), ObjectTable({}))
    return Sequence([*frames.values()], table, tuple(says))


def _filled(folder: Path, pattern: str, match: re.Match[str]) -> Path:
    """Return the path of a pattern with the groups of a place in its braces."""
    return _inside(folder, re.sub(r"\{(\w+)\}", lambda braces: match[braces[1]] or "", pattern))


def _inside(folder: Path, name: str) -> Path:
    if Path(name).is_absolute() or ".." in Path(name).parts:
        raise ArgumentError(f"expected a file in the folder, got {shown(name)}")
    return folder / name


def _pose(
    folder: Path, layout: Layout, match: re.Match[str], poses_in: Any, agrees: bool = False
) -> Pose | None:
    """Return the pose of a frame; None where it is not finite."""
    poses = layout.poses
    if poses is None:
        return Pose.from_angles(layout.position)
    file = _filled(folder, poses.agrees if agrees else poses.file, match)
    pose: Pose | None
    with within(file.name):
        if poses.position:
            data = parse_json(read_bytes(file, MOST_JSON_BYTES))
            t = numbers("position", _at(data, poses.position), (3,))
            pose = Pose(t, _rigid(_at(data, poses.rotation)) if poses.rotation else R_LEVEL)
        elif "{" in poses.file or poses.row:
            rows = poses_in(file, False, not poses.row)
            row = int(match[poses.row]) if poses.row else 0
            if str(row) not in rows:
                raise ArgumentError(f"expected a pose in row {row + 1}, got {len(rows)} rows")
            pose = rows[str(row)]
        else:
            names = [name for name in (*match.groups(), match[0], Path(match[0]).name) if name]
            pose = _named(file, names, poses_in)
    if pose is None:
        return None
    R, t = (pose.R_w_c.T, -pose.R_w_c.T @ pose.position) if poses.inverse else (pose.R_w_c, pose.position)
    W, C = _AXES[poses.axes]
    R = W @ R @ C if poses.yaw_deg == 0 else turn_about_z(poses.yaw_deg) @ R
    pose = Pose(W @ t / pictures.PER_M[poses.unit], R)
    if layout.pictures != "faces" or agrees:
        return pose
    known = LAYOUTS[layout.faces]
    words = next(words for words in known.words if match["face"] in words.split()).split()
    face = known.arrangement[words.index(match["face"])]
    pose = Pose(pose.position, pose.R_w_c @ (_FRONT.T @ face.R_w_c))
    other = _pose(folder, layout, match, poses_in, True) if poses.agrees else pose
    if other is not None and np.abs(other.R_w_c - pose.R_w_c).max() > _SAME:
        angle = np.degrees(Rotation.from_matrix(other.R_w_c.T @ pose.R_w_c).magnitude())
        line = f"{_filled(folder, poses.agrees, match).name} line {int(match[poses.row]) + 1}"
        raise ArgumentError(f"{line}: expected the front's turned {face}, off by {angle:.3g} degrees")
    return pose


def _at(data: Any, path: str) -> Any:
    """Return the value at keys and indices with dots between them."""
    for key in path.split("."):
        data = data[int(key) if isinstance(data, list) else key]
    return data


def _rigid(value: Any) -> Array:
    """Return the rotation nearest to a matrix, which has six digits or fewer."""
    R = numbers("rotation", value, (3, 3))
    if (off := np.abs(R @ R.T - _I).max()) > _RIGID or np.linalg.det(R) < 0:
        got = f"determinant {np.linalg.det(R):.6g}, |R R^T - I| {off:.3g}"
        raise ArgumentError(f"expected a rotation, neither scaled nor mirrored, got {got}")
    return np.asarray(Rotation.from_matrix(R).as_matrix())


def _poses_in(file: Path, named: bool, whole: bool = False) -> dict[str, Pose | None]:
    """Return the poses of a text, None where they are not finite: of each line, or of all numbers.

    A pose is ``x y z``, ``x y z qx qy qz qw``, or a matrix; or as the names in the first line say. Keys are
    the names in the first column, or the lines' numbers.
    """
    if not file.exists():
        raise ArgumentError("expected a file of poses, got none")
    lines = read_bytes(file, MOST_JSON_BYTES).decode("utf-8-sig", "replace").splitlines()
    rows = [line.partition("#")[0].replace(",", " ").replace(";", " ").split() for line in lines]
    rows = [row for row in rows if row]
    columns = [word.lower() for word in rows.pop(0)][named:] if rows and {"x", "X"} & {*rows[0]} else []
    if columns and not ({*"xyz"} <= {*columns} <= {*_COLUMNS} and len({*columns}) == len(columns)):
        raise ArgumentError(f"expected columns {', '.join(_COLUMNS)}, each once, got {shown(columns)}")
    poses: dict[str, Pose | None] = {}
    for i, row in enumerate([[*chain(*rows)]] if whole else rows):
        name, words = (row[0], row[1:]) if named else (str(i), row)
        if name in poses or len(words) not in ([len(columns)] if columns else (3, 7, 12, 16)):
            expected = f"{'a name once, and ' * named}x y z qx qy qz qw, x y z, or a matrix"
            raise ArgumentError(f"expected lines {expected}; got {shown(' '.join(row))}")
        if any(word.lstrip("+-").lower() in ("inf", "nan") for word in words):
            poses[name] = None
            continue
        values = _values(f"line {i + 1}", words)
        known = defaultdict(float, zip(columns or (*"xyz", *_COLUMNS[6:]), values, strict=False))
        xyz = [known[axis] for axis in "xyz"]
        if len(values) >= 12 and not columns:
            poses[name] = Pose(np.array(values[3:12:4]), _rigid(np.reshape(values[:12], (3, 4))[:, :3]))
        elif "qw" in known:
            poses[name] = Pose.from_quaternion(xyz, [known[column] for column in _COLUMNS[6:]])
        else:
            poses[name] = Pose.from_angles(xyz, *(known[column] for column in _COLUMNS[3:6]))
    return poses


def _named(file: Path, names: list[str], poses_in: Any) -> Pose | None:
    """Return the pose of the first of some names that a file has."""
    with within(file.name):
        poses: dict[str, Pose | None] = poses_in(file, True)
        if (name := next((name for name in names if name in poses), None)) is None:
            raise ArgumentError(f"expected a pose of {shown(names[0])}, got those of {shown([*poses][:4])}")
        return poses[name]


def objects_of(file: Path) -> ObjectTable:
    """Return the objects of JSON: names by id, ids or colours by name, or a list of names."""
    with within(file.name):
        data = parse_json(read_bytes(file, MOST_JSON_BYTES))
        try:
            if isinstance(data, list):
                data = {name: i for i, name in enumerate(data)}
            data = data.get("name_map", data)
            if all(isinstance(name, str) for name in data.values()):
                data = {name: int(i) for i, name in data.items()}
            if all(isinstance(value, list) for value in data.values()):
                return ObjectTable(
                    {text("name", key): (int(r), int(g), int(b)) for key, (r, g, b) in data.items()}
                )
            return ObjectTable({}, 0, {text("name", name): int(i) for name, i in data.items()})
        except (TypeError, ValueError) as cause:
            raise ArgumentError(f"expected names of ids, got: {shown(str(cause))}") from cause


# -- Layouts that list their frames ----------------------------------------------------------------------


def _nerfstudio(folder: Path, options: Options) -> Sequence:
    """Return the frames of nerfstudio's transforms.json."""
    files = sorted(folder.glob("transforms.json")) or sorted(folder.glob("transforms*.json"))
    of_file = [parse_json(read_bytes(file, MOST_JSON_BYTES)) for file in files]
    frames, ignored = list[Frame](), 0
    for i, (data, entry) in enumerate((data, entry) for data in of_file for entry in data["frames"]):  # noqa: B020
        with within(f"frames[{i}]"):
            values = {**data, **entry}
            matrix = numbers("transform_matrix", values["transform_matrix"][:3], (3, 4))
            lit = _inside(folder, values["file_path"])
            depth = values.get("depth_file_path") or values.get("depth_path")
            paths = {
                "lit": lit if lit.suffix.lower() in pictures.SUFFIXES else lit.with_name(lit.name + ".png")
            }
            paths |= {"depth": _inside(folder, depth)} if depth else {}
            lens = _nerfstudio_lens(values, paths["lit"])
            unit = "m" if str(depth).lower().endswith((".npy", ".exr")) else "mm"
            holds = {"depth": Files(kind="planar" if lens else "ray", unit=unit)}
            frames.append(Frame(paths, Pose(matrix[:, 3], _rigid(matrix[:, :3]) @ _GL), lens, holds))
            ignored += "mask_path" in values
    says = [f"masks of {ignored} frames are not taken: all pixels of captures count"] if ignored else []
    says += [f"{key} stays" for key in ("applied_transform", "applied_scale") if key in of_file[0]]
    return Sequence(frames, says=tuple(says))


def _nerfstudio_lens(values: dict[str, Any], lit: Path) -> Pinhole | None:
    """Return the lens of a frame; None for a panorama."""
    known = ("PINHOLE", "SIMPLE_PINHOLE", "OPENCV", "EQUIRECTANGULAR")
    if one_of("camera_model", values.get("camera_model", "OPENCV"), known) == "EQUIRECTANGULAR":
        return None
    bent = tuple(number(key, values.get(key, 0)) for key in ("k1", "k2", "p1", "p2", "k3"))
    if values.get("k4") or values.get("is_fisheye"):
        raise ArgumentError("expected a pinhole with k1, k2, p1, p2, k3, got k4 or is_fisheye")
    height, width = (values["h"], values["w"]) if "w" in values else read_picture(lit).pixels.shape[:2]
    if "fl_x" not in values:
        half = number("camera_angle_x", values["camera_angle_x"], above=0, below=3.1) / 2
        values["fl_x"] = width / 2 / np.tan(half)
    given = {"fl_y": values["fl_x"], "cx": width / 2, "cy": height / 2, **values, "w": width, "h": height}
    fx, fy, cx, cy, w, h = (
        number(key, given[key], above=0) for key in ("fl_x", "fl_y", "cx", "cy", "w", "h")
    )
    return Pinhole(fx, fy, cx, cy, w, h, bent if any(bent) else ())


def _tum(folder: Path, options: Options) -> Sequence:
    """Return the frames of a sequence of the TUM RGB-D benchmark: those with a pose, by their stamps."""
    truth = read_trajectory(folder / "groundtruth.txt")
    poses, (depth_times, depths) = np.array(truth.times), _stamped(folder / "depth.txt")
    times, colors = _stamped(folder / "rgb.txt")
    word = next((word for word in _TUM if word and word in str(folder.absolute())), "")
    fx, fy, cx, cy, *bent = _TUM[word]
    lens, frames = Pinhole(fx, fy, cx + 0.5, cy + 0.5, 640, 480, tuple(bent)), []
    for time, name in zip(times, colors, strict=True):
        i, j = np.abs(poses - time).argmin(), np.abs(depth_times - time).argmin()
        if abs(poses[i] - time) <= _LATEST_S:
            paths = {"lit": _inside(folder, name)}
            if abs(depth_times[j] - time) <= _LATEST_S:
                paths["depth"] = _inside(folder, depths[j])
            frames.append(Frame(paths, truth[int(i)], lens, {"depth": Files(unit="1/5000")}))
    says = [f"lens of {word or 'ROS, as the folder is not named after freiburg1, 2 or 3'}"]
    if late := len(colors) - len(frames):
        says.append(f"{late} pictures left out: no pose within {_LATEST_S} s")
    return Sequence(frames, says=tuple(says))


def _stamped(file: Path) -> tuple[Array, list[str]]:
    """Return the times, seconds, and the names of files of a list of the TUM benchmark."""
    with within(file.name):
        lines = read_bytes(file, MOST_JSON_BYTES).decode("utf-8", "replace").splitlines()
        rows = [line.split() for line in lines if line.strip() and not line.startswith("#")]
        if not rows or {*map(len, rows)} != {2}:
            raise ArgumentError("expected lines of a time and a name, got others or none")
        return np.array([number("time", time) for time, _ in rows]), [name for _, name in rows]


def pictures_in(path: Path) -> list[Path]:
    """Return the pictures in a folder, sorted, or the one that the path is."""
    files = sorted(path.rglob("[!.]*")) if path.is_dir() else [path]  # macOS writes ._NAME beside NAME
    found = [file for file in files if file.suffix.lower() in pictures.SUFFIXES]
    if not found:
        others = ", ".join(shown(file.name) for file in files[:8])
        got = f"none; cannot read {others}" if others else "none"
        raise ArgumentError(f"expected six pictures of faces, in colour, depth or masks, got {got}")
    return found


def mode_of(file: Path, folder: Path) -> tuple[str, tuple[str, ...]]:
    """Return what a picture shows, by the words of its name and folders, and the other words."""
    name = file.relative_to(folder) if file != folder else Path(file.name)
    words = [word for word in re.split(r"[^a-z0-9+-]+", str(name.with_suffix("")).lower()) if word]
    mode = next((mode for mode, known in MODE_WORDS.items() if known & {*words}), "lit")
    return mode, tuple(word for word in words if not any(word in known for known in MODE_WORDS.values()))


def _is_panoramas(path: Path) -> bool:
    """Return whether the first picture of colours or masks is twice as wide as high."""
    for file in pictures_in(path):
        if (mode := mode_of(file, path)[0]) in ("lit", "object_mask"):
            height, width = read_picture(file, mode, clip=True).pixels.shape[:2]
            return bool(width == 2 * height)
    return False


def _panoramas(path: Path, options: Options, of_openexr: int = 0) -> Sequence:
    """Return panoramas by the words in their names, at one place or at those of a file."""
    places: dict[tuple[str, ...], dict[str, Path]] = {}
    for file in pictures_in(path):
        mode, words = mode_of(file, path)
        if (other := places.setdefault(words, {}).setdefault(mode, file)) != file:
            raise ArgumentError(f"expected one of {mode} at a place, got {other.name} and {file.name}")
    if options.depth and not options.depth.ray:
        raise ArgumentError("depth: expected ray-UNIT of panoramas, which have no optical axis, got planar")
    if len(places) > 1 and not options.poses:
        raise ArgumentError(f"expected --poses FILE, or panoramas of one place, got {len(places)} places")
    if options.poses and options.pose:
        raise ArgumentError("expected --poses, or --position and --yaw; got both")
    frames, poses_in = list[Frame](), cache(_poses_in)
    for words, files in places.items():
        names = [name for file in files.values() for name in (file.name, file.stem)]
        pose = options.pose or Pose.from_angles((0, 0, 0))
        if options.poses:
            pose = _named(options.poses, [*names, "_".join(words)], poses_in) or pose
        files = {mode: files[mode] for mode in ("lit", "depth", "object_mask", "normals") if mode in files}
        frames.append(Frame(files, pose, None, {"depth": Files(kind="ray")}))
    return Sequence(frames, says=("resampled to six faces",), of_openexr=of_openexr)
