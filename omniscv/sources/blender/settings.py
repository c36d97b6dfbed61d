"""What an address ``blender://SCENE.blend?samples=64`` says."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal, get_args

from omniscv.arguments import number, one_of, shown, whole_number, within
from omniscv.errors import ArgumentError
from omniscv.sources.registry import split_address

Lit = Literal["uint8", "float32"]
Denoiser = Literal["none", "openimagedenoise", "optix"]
Device = Literal["cpu", "cuda", "optix", "hip", "oneapi", "metal"]
_MOST = (1 << 31) - 1


@dataclass(frozen=True)
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
    samples: int = 64
    denoiser: Denoiser = "none"
    device: Device = "cpu"
    lit: Lit = "uint8"
    clip: tuple[float, float] = (1e-3, 1e5)
    seed: int = 0
    scene: str | None = None
    frame: int | None = None
    threads: int = 0

    def __post_init__(self) -> None:
        for name, least, most in (("samples", 1, 1 << 24), ("seed", 0, _MOST), ("threads", 0, 1024)):
            whole_number(name, getattr(self, name), least=least, most=most)
        for name, kind in (("denoiser", Denoiser), ("device", Device), ("lit", Lit)):
            one_of(name, getattr(self, name), get_args(kind))
        if self.denoiser == "optix" and self.device not in ("cuda", "optix"):
            wanted = "optix only with device=cuda or device=optix"
            raise ArgumentError(f"denoiser: expected {wanted}, got device={self.device}")
        if self.frame is not None:
            whole_number("frame", self.frame, least=-1_048_574, most=1_048_574)  # as Blender has it
        near, far = self.clip
        number("clip", near, least=1e-6)
        number("clip", far, above=near, most=1e9)

    def message(self) -> dict[str, Any]:
        """Return the request that opens the scene."""
        return {"do": "open", **asdict(self)}


def read_address(address: str) -> tuple[Settings, str | None, int]:
    """Return the settings of an address, the Blender that it names, and the number of processes.

    Raises:
        ArgumentError: an unknown option, a value of another form, or no file at the path.
    """
    place, options = split_address(address, _READERS)
    blender, processes = options.pop("blender", None), options.pop("processes", 1)
    with within(f"source: {shown(address)}"):
        whole_number("processes", processes, most=256)
        path = Path(place).absolute()
        if not path.is_file():
            raise ArgumentError(f"expected a .blend file, but there is none at {shown(str(path))}")
        return Settings(str(path), **options), blender, processes


def _clip(text: str) -> tuple[float, float]:
    near, far = text.split("..")
    return number("clip", near), number("clip", far)


_READERS: dict[str, Any] = {
    **dict.fromkeys(("samples", "seed", "frame", "threads", "processes"), int),
    **dict.fromkeys(("denoiser", "device", "lit", "scene", "blender"), partial(str)),
    "clip": _clip,
}
