"""The address ``blender://SCENE.blend?samples=64``: how a scene is rendered, and by which Blender."""

import importlib.util
import os
import shutil
import sys
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, Literal, get_args

from omniscv.arguments import number, numbers, one_of, shown, text, whole_number, within
from omniscv.errors import ArgumentError, SourceError
from omniscv.records import checked, optional, record
from omniscv.sources.registry import split_address

Lit = Literal["uint8", "float32"]
Denoiser = Literal["none", "openimagedenoise", "optix"]
Device = Literal["cpu", "cuda", "optix", "hip", "oneapi", "metal"]

VARIABLE = "OMNISCV_BLENDER"
INSIDE = Path(__file__).parent / "inside.py"
_NOT_FOUND = (
    "Blender: expected the module bpy or the program blender, found neither; install Blender 5.0 or later "
    f"(pip install bpy), or name it: {VARIABLE}=PATH, or ?blender=PATH in the address"
)
_MOST_FRAMES = 1_048_574  # as Blender has it


def _clip(name: str, value: object) -> tuple[float, float]:
    near, far = numbers(name, value, (2,)).tolist()
    return number(name, near, least=1e-6), number(name, far, above=near, most=1e9)


_FRAME = optional(partial(whole_number, least=-_MOST_FRAMES, most=_MOST_FRAMES))


@record
class Settings:
    """How a scene is rendered.

    Attributes:
        path: of the .blend file, absolute.
        samples: of a pixel of colour.
        denoiser: of colours; it sees one view at a time, so that faces may differ at their edges.
        device: what renders: the CPU, or all devices of a kind.
        lit: dtype of colours: uint8, through the scene's view transform, or float32, linear.
        clip: least and greatest planar depth that is seen, metres.
        seed: of the noise.
        scene: name of the scene in the file; None: the one that was shown last.
        frame: of its animation; None: the one that was shown last.
        threads: of the CPU; 0: all.
    """

    path: str
    samples: int = checked(whole_number, most=1 << 24, default=64)
    denoiser: Denoiser = checked(one_of, words=get_args(Denoiser), default="none")
    device: Device = checked(one_of, words=get_args(Device), default="cpu")
    lit: Lit = checked(one_of, words=get_args(Lit), default="uint8")
    clip: tuple[float, float] = checked(_clip, default=(1e-3, 1e5))
    seed: int = checked(whole_number, least=0, most=(1 << 31) - 1, default=0)
    scene: str | None = checked(optional(text), default=None)
    frame: int | None = checked(_FRAME, default=None)
    threads: int = checked(whole_number, least=0, most=1024, default=0)

    def __post_init__(self) -> None:
        if self.denoiser == "optix" and self.device not in ("cuda", "optix"):
            expected = "optix only with device=cuda or device=optix"
            raise ArgumentError(f"denoiser: expected {expected}, got device={self.device}")

    def message(self) -> dict[str, Any]:
        """Return the request that opens the scene."""
        return {"do": "open", **asdict(self)}


def read_address(address: str) -> tuple[Settings, str | None, int]:
    """Return an address's settings, Blender and number of processes; ArgumentError for a wrong one."""
    name, options = split_address(address, _READERS)
    blender = options.pop("blender", None)
    processes = options.pop("processes", 1)
    with within(f"source: {shown(address)}"):
        whole_number("processes", processes, most=256)
        path = Path(name).absolute()
        if not path.is_file():
            raise ArgumentError(f"expected a .blend file, but there is none at {shown(str(path))}")
        return Settings(str(path), **options), blender, processes


def _two_numbers(pair: str) -> tuple[float, float]:
    near, far = pair.split("..")
    return float(near), float(far)


_READERS: dict[str, Any] = {
    **dict.fromkeys(("samples", "seed", "frame", "threads", "processes"), int),
    **dict.fromkeys(("denoiser", "device", "lit", "scene", "blender"), str),
    "clip": _two_numbers,
}


def blender_command(program: str | None = None) -> list[str]:
    """Return the command that runs ``inside.py`` inside Blender.

    ``program`` is a Blender, or a Python that has ``bpy``, whose name begins with ``python``; by default the
    environment's ``OMNISCV_BLENDER``, else ``bpy`` of this Python, else ``blender`` on the path. Raises
    ArgumentError if there is no such program, SourceError if none is found.
    """
    program = program or os.environ.get(VARIABLE)
    if program is not None:
        path = shutil.which(program)
        if path is None:
            raise ArgumentError(f"blender: expected a program that can be run, got {program!r}")
    elif importlib.util.find_spec("bpy") is not None:
        path = sys.executable
    else:
        path = shutil.which("blender")
    if path is None:
        raise SourceError(_NOT_FOUND)
    if Path(path).name.startswith("python"):
        return [path, "-P", str(INSIDE)]
    quiet = ["--background", "--factory-startup", "--disable-autoexec", "--python-exit-code", "1"]
    return [path, *quiet, "--python", str(INSIDE)]
