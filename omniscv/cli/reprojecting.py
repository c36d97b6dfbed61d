"""``omniscv reproject``: pictures of one camera as another one at the same place would have taken them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option, Typer

from omniscv.cli import console, options
from omniscv.cli.console import StyleOption, display
from omniscv.errors import ArgumentError
from omniscv.progress import Progress

if TYPE_CHECKING:
    from omniscv.cameras import Camera
    from omniscv.pictures.photo_sphere import PhotoSphere

app = Typer(add_completion=False)


@app.command(
    no_args_is_help=True,
    epilog="Example: omniscv reproject photos/ fisheyes/ --camera fisheye-equidistant --size 1024x1024 "
    "--set fov_deg=185\n\n"
    "Example: omniscv reproject photo.jpg views/ --camera pinhole --size 1024x768 --set fov_deg=90 "
    "--yaw 0,90,180,270",
)
def reproject(
    source: Annotated[Path, Argument(metavar="IN", help="A picture, or a folder of pictures.")],
    out: Annotated[Path, Argument(metavar="OUT", help="Folder of the new ones, under the same names.")],
    camera: Annotated[str, Option(help="The new camera: a central model, or a calibration file.")],
    size: Annotated[str, Option(help="Width x height of the new pictures, px.")] = "1024x512",
    from_: Annotated[
        str,
        Option("--from", help="The camera that took the pictures: a central model, or a calibration file."),
    ] = "equirectangular",
    set_: Annotated[
        list[str] | None, Option("--set", help="KEY=VALUE: a parameter of the new camera; repeatable.")
    ] = None,
    set_from: Annotated[
        list[str] | None, Option("--set-from", help="KEY=VALUE: one of the old camera; repeatable.")
    ] = None,
    yaw: Annotated[
        str, Option(help="Degrees to the left by which the new camera is turned; several with commas.")
    ] = "0",
    pitch: Annotated[float, Option(help="Degrees, nose up +.")] = 0.0,
    roll: Annotated[float, Option(help="Degrees, right side down +.")] = 0.0,
    overwrite: Annotated[bool, Option("--overwrite", help="Replace files of these names.")] = False,
    progress: StyleOption = None,
) -> None:
    """Show pictures by another camera at the same place, such as 360 photos by a fisheye.

    No depth is needed. Panoramas may be parts of spheres, as their Photo Sphere data say; new panoramas get
    such data. Layers beside colours, NAME.labels.png or NAME.depth.exr, keep their values.
    """
    from omniscv.pictures import foreign

    views = _views(yaw, pitch, roll)
    to = options.central_camera("--camera", camera, options.size(size), set_ or [])
    if not source.exists():
        raise ArgumentError(f"IN: expected a picture or a folder of pictures, got none at {source}")
    files = [source]
    if source.is_dir():
        files = [path for path in sorted(source.iterdir()) if path.suffix.lower() in foreign.SUFFIXES]
    if not files:
        expected = f"IN: expected pictures ({', '.join(foreign.SUFFIXES)}) in {source}"
        raise ArgumentError(f"{expected}, got a folder without any")
    if out.resolve() in (source.resolve(), source.resolve().parent):
        raise ArgumentError(f"OUT: expected another folder than that of the pictures, got {out}")
    targets = []
    for file in files:
        for name in views:
            targets.append(out / _with_view(file.name, name))
    taken = [target for target in targets if target.exists()]
    if taken and not overwrite:
        raise ArgumentError(f"{taken[0]}: expected no file; choose another folder, or --overwrite")
    out.mkdir(parents=True, exist_ok=True)
    with display("pictures", progress) as show:
        for number, file in enumerate(files):
            for name, rotation in views.items():
                target = out / _with_view(file.name, name)
                _write(file, target, from_, set_from or [], to, rotation)
            show(Progress(images=number + 1, of_images=len(files)))
    count = len(files) * len(views)
    console.document(f"{count} {'picture' if count == 1 else 'pictures'} in {out}/")


def _views(yaw: str, pitch: float, roll: float) -> dict[str, Any]:
    """Return R_from_to of each view by what its files are called; empty for a single one."""
    from omniscv.geometry import R_LEVEL, Pose

    angles = options.numbers("--yaw", yaw, ",".join(["0"] * len(yaw.split(","))))
    views = {}
    for angle in angles:
        R_w_c = Pose.from_angles((0, 0, 0), angle, pitch, roll).R_w_c
        name = f"yaw{angle:g}" if len(angles) > 1 else ""
        views[name] = R_LEVEL.T @ R_w_c
    return views


def _with_view(name: str, view: str) -> str:
    """Return a file's name with that of a view after its stem; layers stay last: ``A.labels.png``."""
    stem, dot, ending = name.partition(".")
    return f"{stem}_{view}{dot}{ending}" if view else name


def _layer_of(file: Path) -> str:
    """Return the layer that a file's name says, as ``STEM.LAYER.SUFFIX`` does; else colours."""
    from omniscv import modalities

    names = {row.name for row in modalities.layers()}
    layer = file.stem.rpartition(".")[2]
    return layer if layer in names and layer != file.stem else "lit"


def _write(file: Path, target: Path, from_: str, set_from: list[str], to: Camera, rotation: Any) -> None:
    """Write what another camera shows of a picture."""
    from omniscv import modalities
    from omniscv import reproject as reprojected
    from omniscv.compose import files
    from omniscv.pictures import foreign, forms

    layer = _layer_of(file)
    row = modalities.get(layer)
    sphere = None
    if from_ == "equirectangular" and not set_from:
        sphere = _sphere_of(file, layer)
    if forms.form_of(target).write is None:
        raise ArgumentError(
            f"{target.name}: expected a form that can be written, such as png, jpg, exr, tiff"
        )
    pixels = files.read(file, layer) if layer != "lit" else foreign.read(file).pixels
    is_shown = None
    if sphere is not None and sphere.is_cropped:
        pixels, is_shown = sphere.whole(pixels)
        pixels = _filled(pixels, is_shown)
    camera = options.central_camera("--from", from_, (pixels.shape[1], pixels.shape[0]), set_from)
    if from_ == "equirectangular" and not set_from and pixels.shape[1] != 2 * pixels.shape[0]:
        size = f"{pixels.shape[1]}x{pixels.shape[0]}"
        raise ArgumentError(f"{file}: expected a panorama of 2:1, got {size}; name its camera by --from")
    blended = row.interpolation == "blended"
    made = reprojected(
        pixels,
        from_=camera,
        to=to,
        rotation=rotation,
        filter="area" if blended else "nearest",
        transfer="srgb",
    )
    if is_shown is not None:
        made[~reprojected(is_shown, from_=camera, to=to, rotation=rotation, filter="nearest")] = 0
    if row.interpolation in ("plane", "direction"):
        made = (made @ rotation).astype(made.dtype)
    files.write_picture(target, made[..., 0] if made.shape[2:] == (1,) else made, row)
    if layer == "lit":
        _tag(target, to, rotation, sphere)


def _sphere_of(file: Path, layer: str) -> PhotoSphere | None:
    """Return the Photo Sphere data of a picture, or of the colours beside a layer; None without any."""
    from omniscv.arguments import within
    from omniscv.pictures import foreign
    from omniscv.pictures.photo_sphere import read_photo_sphere

    pictures = [file]
    if layer != "lit":
        stem = file.name.partition(".")[0]
        beside = [path for path in sorted(file.parent.glob(f"{stem}.*")) if _layer_of(path) == "lit"]
        pictures = [path for path in beside if path.suffix.lower() in foreign.SUFFIXES]
    for picture in pictures:
        with within(str(picture)):
            sphere = read_photo_sphere(picture)
        if sphere is not None:
            return sphere
    return None


def _filled(pixels: Any, is_shown: Any) -> Any:
    """Return a panorama in which what a crop leaves out has the values at the crop's edge.

    Only so do its outermost pixels stay as they are where pixels are blended.

    Args:
        pixels: (H, W, ...) of the whole panorama.
        is_shown: (H, W) bool, which of them are of the crop: some columns of some rows.
    """
    import numpy as np

    height, width = is_shown.shape
    rows = np.flatnonzero(is_shown.any(axis=1))
    row = np.clip(np.arange(height), rows[0], rows[-1])
    is_column = is_shown.any(axis=0)
    starts = np.flatnonzero(is_column & ~np.roll(is_column, 1))  # a crop may lie across the seam
    first = starts[0] if len(starts) else 0
    last = np.count_nonzero(is_column) - 1
    behind = (np.arange(width) - first) % width
    nearer = np.where(behind - last <= width - behind, last, 0)
    column = (first + np.where(behind <= last, behind, nearer)) % width
    return pixels[row[:, None], column]


def _tag(target: Path, camera: Camera, rotation: Any, sphere: PhotoSphere | None) -> None:
    """Write Photo Sphere data into a panorama, if its form holds them: how its camera was held."""
    from omniscv.dataset.media import photo_sphere_fields, refuses, with_photo_sphere
    from omniscv.geometry import Pose

    if refuses(camera) is not None or target.suffix.lower() not in (".png", ".jpg", ".jpeg"):
        return
    held = Pose.from_angles((0, 0, 0), *(sphere.angles_deg if sphere is not None else (0.0, 0.0, 0.0)))
    fields = photo_sphere_fields(camera, Pose(held.position, held.R_w_c @ rotation))
    if sphere is None or sphere.heading_deg is None:
        del fields["PoseHeadingDegrees"]  # nobody knows where north is
    target.write_bytes(with_photo_sphere(target.read_bytes(), fields))
