"""``omniscv cameras``: the camera models, and the nearest one to another camera."""

import inspect
import json
import re
import shlex
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option, Typer
from typer.core import TyperGroup

from omniscv.arguments import one_of
from omniscv.cli import console, options
from omniscv.errors import ArgumentError


class _Models(TyperGroup):
    """``omniscv cameras NAME`` is short for ``omniscv cameras show NAME``."""

    def resolve_command(self, context: Any, args: list[str]) -> Any:
        """Return the command of the words ``args``, in the ``context`` of the group."""
        return super().resolve_command(context, args if args[0] in self.commands else ["show", *args])


app = Typer(cls=_Models, name="cameras", invoke_without_command=True, add_completion=False)


@app.callback(epilog="Example: omniscv cameras fisheye-equisolid")
def cameras(context: typer.Context, as_json: options.AsJson = False) -> None:
    """List the camera models; describe one: its formula, parameters and domain; fit one to another."""
    from omniscv.cameras import model, names

    if context.invoked_subcommand is not None:
        return
    descriptions = []
    cells = []
    for name in names():
        cls = model(name)
        kind = "central" if cls.central else "non-central"
        summary = _summary(cls)
        typical = " ".join(f"{key}={text}" for key, text in _typical(name).items())
        descriptions.append({"model": name, "kind": kind, "summary": summary, "typical": typical})
        in_brackets = f"[{typical}]" if typical else ""
        cells.append((name, kind, f"{summary} {in_brackets}"))
    if as_json:
        console.as_json(descriptions)
        return
    console.table(("model", "kind", "summary"), cells)
    console.line("In brackets typical parameters at 256 px; 'omniscv cameras MODEL' has a command with them.")


@app.command(epilog="Example: omniscv cameras show fisheye-equisolid")
def show(name: Annotated[str, Argument(help="A model.")]) -> None:
    """Describe a model: its formula, parameters and domain; 'omniscv cameras NAME' does the same."""
    from omniscv.cameras import model

    console.document(f"{name}\n\n{inspect.getdoc(model(name))}\n")
    lens = model(name).lens
    if lens and lens.names:
        console.line(f"In lens files: {lens}")
    camera = model(name).example(256)
    words = ["omniscv render --source mock://four-wall"]
    words.append(f"--camera {name} --size {camera.width}x{camera.height}")
    for key, text in _typical(name).items():
        words.append(f"--set {shlex.quote(f'camera.{key}={text}')}")
    if camera.typical_pitch_deg:
        words.append(f"--pitch {camera.typical_pitch_deg:g}")
    words.append("--out out/")
    console.line(f"Example: {' '.join(words)}")


def _summary(cls: type) -> str:
    """Return the start of a model's description, up to its formula."""
    paragraph = " ".join((inspect.getdoc(cls) or "").partition("\n\n")[0].split())
    return re.split(r"[.:;] |[.:]$", paragraph)[0]


def _typical(name: str) -> dict[str, str]:
    """Return the parameters of a model's example that differ from the defaults, as YAML."""
    from omniscv.cameras import model

    cls = model(name)
    parameters = inspect.signature(cls).parameters
    texts = {}
    for key, value in cls.example(256).to_dict().items():
        if key in ("model", "width", "height", "center"):
            continue
        default = parameters[key].default if key in parameters else None
        if isinstance(default, tuple):
            default = list(default)
        if value != default:
            texts[key] = json.dumps(_six_digits(value)).strip('"')
    return texts


def _six_digits(value: Any) -> Any:
    """Return plain values with floats of six digits."""
    return json.loads(json.dumps(value), parse_float=lambda digits: float(f"{float(digits):.6g}"))


@dataclass(frozen=True)
class _Fitted:
    """Options of the camera that another one is fitted to."""

    name: Annotated[str | None, Option(help="The camera of a file that holds several.")] = None
    size: Annotated[str, Option(help="Width x height of the image of a model, px.")] = "1024x1024"
    settings: Annotated[
        list[str] | None, Option("--set", help="KEY=VALUE: a parameter of a model, as alpha=0.6; repeatable.")
    ] = None

    def camera(self, source: str) -> Any:
        """Return the camera of a model or of a calibration file."""
        from omniscv.calibration import load
        from omniscv.cameras import create, names

        if source in names():
            parameters = dict(options.setting(text, "alpha=0.6") for text in self.settings or [])
            if {"width", "height"} & parameters.keys():
                wanted = "expected width and height in --size WIDTHxHEIGHT"
                raise ArgumentError(f"--set: {wanted}, got them as keys")
            return create(source, *options.size(self.size), **parameters)
        cameras = load(source)
        only = next(iter(cameras)) if len(cameras) == 1 and self.name is None else self.name
        return cameras[one_of("--name", only, cameras)]


@app.command(
    epilog="Example: omniscv cameras fit double-sphere kannala-brandt --size 640x480 "
    "--set fx=180 --set fy=180 --set xi=-0.2 --set alpha=0.6 --out cameras.txt --format colmap"
)
@options.with_blocks
def fit(
    source: Annotated[str, Argument(help="A calibration file, or a model, with --size and --set.")],
    model: Annotated[str, Argument(help="The model to fit.")],
    fitted: _Fitted,
    out: Annotated[Path | None, Option(help="A file for the fitted camera.")] = None,
    format: Annotated[str, Option(help="Of --out: opencv, kalibr, ...; see docs/calibration.md.")] = "json",
    as_json: options.AsJson = False,
) -> None:
    """Find the camera of a model that is nearest to another camera, and print the error.

    For programs that lack a model. The errors are the distances, in px, between the two images of a ray.
    """
    from omniscv.calibration import fit, save
    from omniscv.calibration.files import FORMS

    result = fit(fitted.camera(source), model)
    if out is not None:
        form = FORMS[one_of("--format", format, FORMS)]
        save(out, {form.writing.name_of(fitted.name or "cam0"): result.camera}, format)
    if as_json:
        errors = {"max_px": result.max_px, "rms_px": result.rms_px, "coverage": result.coverage}
        console.as_json({"camera": result.camera.to_dict(), **errors})
        return
    console.line(result.camera)
    _report(result)


def _report(result: Any) -> None:
    """Print the errors of a fitted camera."""
    console.line(
        f"largest error {result.max_px:.3g} px, rms {result.rms_px:.3g} px, "
        f"over {100 * result.coverage:.4g} % of the pixels"
    )


_From = Annotated[str | None, Option("--from", help="Format of the file, if its content does not show it.")]


@app.command(epilog="Example: omniscv cameras convert camchain.yaml vins.yaml --format camodocal --name cam0")
def convert(
    source: Annotated[Path, Argument(help="A lens file of any format, or a rig.")],
    out: Annotated[Path, Argument(help="The file to write; replaced if it exists.")],
    format: Annotated[str, Option(help="Of OUT; docs/lens-files.md lists them.")],
    name: Annotated[str | None, Option(help="One camera of a file that holds several.")] = None,
    size: Annotated[str | None, Option(help="Width x height, px, of a file that does not hold it.")] = None,
    read_as: _From = None,
    fit: Annotated[
        bool, Option("--fit", help="Fit cameras that the format cannot carry by the nearest of its models.")
    ] = False,
) -> None:
    """Turn a lens file of any format into any other; poses are kept where both formats have them.

    What the format cannot carry is refused, or with --fit approximated, and the error printed.
    """
    from omniscv import calibration
    from omniscv.calibration.files import FORMS, load_file
    from omniscv.cameras.rig import Rig

    loaded = load_file(source, read_as, options.size(size) if size else None)
    entries = loaded.entries
    if name is not None:
        entries = {name: entries[one_of("--name", name, entries)]}
    form = FORMS[one_of("--format", format, FORMS)]
    mounts = {}
    for i, (key, entry) in enumerate(entries.items()):
        mounted = _fitted(key, entry.mounted, format) if fit else entry.mounted
        mounts[form.writing.name_of(key, i)] = mounted
    is_rig = len(entries) > 1 and all(entry.pose is not None for entry in entries.values())
    if is_rig and form.layout.poses:
        rig = Rig(mounts)
        if form.writing.from_first:
            rig = rig.seen_from(next(iter(mounts)))
        calibration.save_rig(out, rig, format)
    else:
        calibration.save(out, {key: mounted.camera for key, mounted in mounts.items()}, format)
    lost = "; the poses are lost: the format has none" if is_rig and not form.layout.poses else ""
    console.line(f"{source} ({loaded.format}) -> {out} ({format}): {len(mounts)} camera(s){lost}")


def _fitted(name: str, mounted: Any, format: str) -> Any:
    """Return a rig's camera as a format carries it, and print the error where it is fitted for that."""
    from omniscv.calibration import nearest

    fitted = nearest(mounted.camera, format)
    if fitted is None:
        return mounted
    console.line(f"{name}: {mounted.camera.name} as {fitted.camera.name}:")
    _report(fitted)
    return replace(mounted, camera=fitted.camera)


@app.command(epilog="Example: omniscv cameras describe camchain.yaml")
def describe(
    file: Annotated[Path, Argument(help="A lens file of any format.")],
    size: Annotated[str | None, Option(help="Width x height, px, of a file that does not hold it.")] = None,
    read_as: _From = None,
    as_json: options.AsJson = False,
) -> None:
    """Print what a lens file holds: format, model, size, field of view, and the keys that are ignored."""
    from omniscv.calibration.files import FORMS, doubts, load_file

    loaded = load_file(file, read_as, options.size(size) if size else None)
    rows: list[dict[str, Any]] = []
    for name, entry in loaded.entries.items():
        camera = entry.camera
        rows.append(
            {
                "name": name,
                "model": camera.name,
                "size": f"{camera.width}x{camera.height}",
                "fov_deg": _field_of_view(camera),
                "pose": entry.pose is not None,
                "ignored": list(entry.ignored),
                "doubts": doubts(camera),
                "camera": camera.to_dict(),
            }
        )
    if as_json:
        console.as_json({"format": loaded.format, "cameras": rows})
        return
    centres = ".5" if FORMS[loaded.format].layout.shift_px == 0 else "whole numbers"
    console.line(f"{file}: {loaded.format}, pixel centres at {centres}")
    for row in rows:
        angles = " x ".join(f"{angle:.4g}" for angle in row["fov_deg"])
        pose = ", with a pose" if row["pose"] else ""
        console.line(f"{row['name']}: {row['model']}, {row['size']} px, {angles} degrees{pose}")
        console.line(f"  {row['camera']}")
        if row["ignored"]:
            console.line(f"  ignored: {', '.join(row['ignored'])}")
        for doubt in row["doubts"]:
            console.line(f"  {doubt}")


def _field_of_view(camera: Any) -> list[float]:
    """Return the angles that the middle row and the middle column of an image see, degrees."""
    import numpy as np

    angles = []
    for axis, size in enumerate((camera.width, camera.height)):
        pixels = np.tile(camera.center.clip(0, [camera.width, camera.height]), (513, 1))
        pixels[:, axis] = np.linspace(0, size, 513)
        rays = camera.unproject(pixels)
        seen = rays.directions[rays.valid]
        turns = np.arccos(np.clip((seen[1:] * seen[:-1]).sum(axis=-1), -1, 1))
        angles.append(float(np.degrees(turns.sum())))
    return angles
