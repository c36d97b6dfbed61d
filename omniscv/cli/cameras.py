"""``omniscv cameras``: the camera models."""

import inspect
from typing import Annotated

from typer import Argument, Typer

from omniscv.cli import console

app = Typer(add_completion=False)


@app.command(epilog="Example: omniscv cameras fisheye-equisolid")
def cameras(name: Annotated[str | None, Argument(help="A model; all if not given.")] = None) -> None:
    """List the camera models, or describe one: its formula, parameters and domain."""
    from omniscv.cameras import model, names

    if name is not None:
        console.document(f"{name}\n\n{inspect.getdoc(model(name))}")
        return
    models = {each: model(each) for each in names()}
    summaries = [(inspect.getdoc(each) or "").partition("\n")[0] for each in models.values()]
    kinds = ["central" if each.central else "non-central" for each in models.values()]
    console.table(("model", "kind", "summary"), list(zip(models, kinds, summaries, strict=True)))
