"""``omniscv cameras``: the camera models, and the nearest camera of one of them to another."""

import inspect
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option, Typer
from typer.core import TyperGroup

from omniscv.cli import console, options

if TYPE_CHECKING:
    from omniscv.calibration import Fit
    from omniscv.cameras import Camera


class _Models(TyperGroup):
    """``omniscv cameras NAME`` is short for ``omniscv cameras show NAME``."""

    def resolve_command(self, context: Any, args: list[str]) -> Any:
        return super().resolve_command(context, args if args[0] in self.commands else ["show", *args])


app = Typer(cls=_Models, name="cameras", invoke_without_command=True, add_completion=False)


@app.callback(epilog="Example: omniscv cameras fisheye-equisolid")
def cameras(context: typer.Context, as_json: options.AsJson = False) -> None:
    """List the camera models; describe one: its formula, parameters and domain; fit one to another."""
    from omniscv.cameras import model, names

    if context.invoked_subcommand is not None:
        return
    models = {each: model(each) for each in names()}
    summaries = [(inspect.getdoc(each) or "").partition("\n")[0] for each in models.values()]
    kinds = ["central" if each.central else "non-central" for each in models.values()]
    columns, rows = ("model", "kind", "summary"), list(zip(models, kinds, summaries, strict=True))
    if as_json:
        console.as_json([dict(zip(columns, row, strict=True)) for row in rows])
        return
    console.table(columns, rows)


@app.command(epilog="Example: omniscv cameras show fisheye-equisolid")
def show(name: Annotated[str, Argument(help="A model.")]) -> None:
    """Describe a model: its formula, parameters and domain; 'omniscv cameras NAME' does the same."""
    from omniscv.cameras import model

    console.document(f"{name}\n\n{inspect.getdoc(model(name))}")


class FitOptions(options.Options):
    """What to fit, and where to write it."""

    source: str = Argument(help="A calibration file, or a model, with --size and --param.")
    model: str = Argument(help="The model that is wanted.")
    name: str | None = Option(None, help="The camera of a file that holds several.")
    size: str = Option("1024x1024", help="Width x height of the image of a model, px.")
    fov: float | None = Option(None, help="Full field of view of a model, degrees.")
    param: list[str] = Option([], help="A parameter of a model such as alpha=0.6; repeatable.")
    out: Path | None = Option(None, help="A file for the camera that is found.")
    format: Any = Option("json", help="Of --out: opencv, kalibr, colmap, ...; see docs/calibration.md.")
    as_json: options.AsJson = False


@app.command(
    epilog="Example: omniscv cameras fit double-sphere kannala-brandt --size 640x480 "
    "--param fx=180 --param fy=180 --param xi=-0.2 --param alpha=0.6 --out cameras.txt --format colmap"
)
@FitOptions.command
def fit(given: FitOptions) -> None:
    """Find the camera of a model that is nearest to another camera, and print how far off it is.

    For programs that lack a model. The errors are the distances, in px, between where both see the same ray.
    """
    from omniscv.calibration import fit, save

    found = fit(_source(given), given.model)
    if given.out is not None:
        name = "1" if given.format == "colmap" else given.name or "cam0"
        save(given.out, {name: found.camera}, given.format)
    if given.as_json:
        console.as_json(_as_json(found))
        return
    console.line(found.camera)
    console.line(
        f"largest error {found.max_px:.3g} px, rms {found.rms_px:.3g} px, over {100 * found.coverage:.4g} % "
        "of the pixels"
    )


def _as_json(found: "Fit") -> dict[str, Any]:
    errors = {"max_px": found.max_px, "rms_px": found.rms_px, "coverage": found.coverage}
    return {"camera": found.camera.to_dict(), **errors}


def _source(given: FitOptions) -> "Camera":
    """The camera that ``SOURCE`` and the options beside it describe."""
    from omniscv.arguments import one_of
    from omniscv.calibration import load
    from omniscv.cameras import create, names

    if given.source in names():
        width, height = options.size(given.size)
        fov = {} if given.fov is None else {"fov_deg": given.fov}
        return create(given.source, width, height, **fov, **dict(map(options.parameter, given.param)))
    found = load(given.source)
    only = next(iter(found)) if len(found) == 1 and given.name is None else given.name
    return found[one_of("--name", only, found)]
