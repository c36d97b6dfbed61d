"""``omniscv send``: send commands to a server, and print its replies."""

from typing import Annotated

from typer import Argument, Typer

from omniscv.cli import console, options
from omniscv.errors import ArgumentError

app = Typer(add_completion=False)

_VERBS = ("vget", "vset", "vbp", "vrun", "vexec")


@app.command(
    epilog="Example: omniscv send mock://four-wall 'vget /unrealcv/status' 'vget /object/Table/location'"
)
def send(
    uri: Annotated[str, Argument(help="unreal://host:port or mock://scene.")],
    commands: Annotated[list[str], Argument(metavar="COMMAND...", help="Of UnrealCV: 'vget /objects'.")],
    timeout: options.Timeout = None,
    patience: options.Patience = None,
) -> None:
    """Send commands to a server, and print its replies; of a binary one, what it is and its size.

    The first command that is refused ends it, with exit code 1. What a command changes stays changed.
    """
    from omniscv.diagnostics.server import replies_to

    if commands[0] in _VERBS:
        raise ArgumentError(f"COMMAND: expected it in quotes, such as '{' '.join(commands)}', got words")
    for reply in replies_to(uri, commands, **options.deadlines(timeout, patience)):
        console.document(reply)
