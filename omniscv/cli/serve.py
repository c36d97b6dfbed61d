"""``omniscv serve``: the mock server, which reads the options itself, as ``python -m mock_server`` does."""

import typer
from typer import Exit, Typer

from omniscv.cli import signals

app = Typer(add_completion=False)


@app.command(
    context_settings={"ignore_unknown_options": True, "allow_extra_args": True, "help_option_names": []},
    epilog="Example: omniscv serve four-wall --port 9000 --dialect 0.3.10 --size 512x512",
)
def serve(context: typer.Context) -> None:
    """Serve a scene over the UnrealCV protocol, for any client, until Ctrl-C."""
    from mock_server.__main__ import main

    signals.check()
    raise Exit(main(context.args, "omniscv serve"))
