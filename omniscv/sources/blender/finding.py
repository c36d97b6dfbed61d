"""Where Blender is: a Python that has the module ``bpy``, or the executable."""

import importlib.util
import os
import shutil
import sys
from pathlib import Path

from omniscv.errors import ArgumentError, SourceError

VARIABLE = "OMNISCV_BLENDER"
INSIDE = Path(__file__).parent / "inside" / "main.py"
_NONE = (
    "Blender: expected the module bpy or the program blender, found neither; install Blender 5.0 or later "
    f"(pip install bpy), or name it: {VARIABLE}=PATH, or ?blender=PATH in the address"
)


def blender_command(named: str | None = None) -> list[str]:
    """Return the command that runs ``inside/main.py`` inside Blender.

    Args:
        named: a Blender executable, or a Python that has ``bpy``, whose name begins with ``python``. If not
            given, the environment's ``OMNISCV_BLENDER``, else ``bpy`` of this Python, which is looked for and
            not imported, else ``blender`` on the path.

    Raises:
        ArgumentError: there is no program of that name.
        SourceError: nothing is named, and nothing found.
    """
    named = named or os.environ.get(VARIABLE)
    if named is not None:
        program = shutil.which(named)
        if program is None:
            raise ArgumentError(f"blender: expected a program that can be run, got {named!r}")
    elif importlib.util.find_spec("bpy") is not None:
        program = sys.executable
    else:
        program = shutil.which("blender")
    if program is None:
        raise SourceError(_NONE)
    if Path(program).name.startswith("python"):
        return [program, "-P", str(INSIDE)]
    quiet = ["--background", "--factory-startup", "--disable-autoexec", "--python-exit-code", "1"]
    return [program, *quiet, "--python", str(INSIDE)]
