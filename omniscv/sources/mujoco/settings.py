"""What an address or a job says of a MuJoCo model."""

import io
from functools import partial
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from omniscv.arguments import flag, number, numbers, one_of, shown, text, whole_number
from omniscv.errors import ArgumentError
from omniscv.geometry import Array
from omniscv.records import checked, optional, record
from omniscv.storage.bounded import read_bytes, read_text

By = Literal["body", "geom"]
Data = Literal["rays", "raster"]
Headlight = Literal["center", "ambient", "camera", "off"]
_MOST_BYTES = 1 << 28  # of a file of ``qpos``


def _groups(name: str, value: object) -> str:
    if not str(value) or not set(str(value)) <= set("012345"):
        expected = "expected groups of geoms, digits of 0 to 5 such as 12"
        raise ArgumentError(f"{name}: {expected}, got {shown(value)}")
    return str(value)


def _keyframe(name: str, value: object) -> str | None:
    if value is None:
        return None
    if isinstance(value, int):
        return str(value)
    return text(name, value)


def _flag(name: str, value: object) -> bool:
    if value == "1":
        return True
    if value == "0":
        return False
    return flag(name, value)


@record
class Settings:
    """What is shown of a model, and how.

    Attributes:
        keyframe: name or number of the state in which the world starts; its initial one if not given.
        qpos: instead of the keyframe's: numbers, or a file of them (``.npy``, or text). Rows of a time and
            ``qpos`` are a trajectory, and no physics is simulated.
        time: seconds from there: steps of physics, or a place on the trajectory.
        groups: of geoms that are shown; a viewer's are 0, 1 and 2.
        by: whether objects are bodies, with each geom of the world itself, or geoms.
        data: where masks, depth and normals come from: exact ``rays``; or the renderer's ``raster``, without
            normals, which has skins and flexes, and facets on what is round: depth then comes with a bound.
        numslices: facets around what is round, of the renderer; its stacks are half as many.
        headlight: the lamp on the camera. ``center``: it shines from the optical centre all around, so that
            all views of one centre agree; ``camera``: as the viewer's, which turns with each view;
            ``ambient``: without a direction; ``off``.
        fog: whether the model's fog is drawn; it differs between views of one centre.
        traces: whether images may take masks, depth and normals by one ray a pixel, without captures; not
            with ``data=raster``.
    """

    keyframe: str | None = checked(_keyframe, default=None)
    qpos: Any = None
    time: float | None = checked(optional(partial(number, least=0)), default=None)
    groups: str = checked(_groups, default="012")
    by: By = checked(one_of, words=get_args(By), default="body")
    data: Data = checked(one_of, words=get_args(Data), default="rays")
    numslices: int = checked(partial(whole_number, least=4, most=1024), default=128)
    headlight: Headlight = checked(one_of, words=get_args(Headlight), default="center")
    fog: bool = checked(_flag, default=False)
    traces: bool = checked(_flag, default=True)


def _read_numbers(path: Path) -> Any:
    """Return the array of a .npy file, or the rows of a text; ValueError or EOFError for another file."""
    if path.name.endswith(".npy"):
        return np.load(io.BytesIO(read_bytes(path, _MOST_BYTES)), allow_pickle=False)
    return np.loadtxt(read_text(path).replace(",", " ").splitlines(), ndmin=2)


def read_qpos(qpos: Any, size: int) -> Array | None:
    """Return ``qpos`` (size,), or a trajectory (n, 1 + size) with seconds that increase; None if not given.

    Args:
        qpos: numbers, rows of numbers, the path of a file of them, or None.
        size: how many numbers a state of the model has.

    Raises:
        ArgumentError: another shape, or a file that has no numbers.
    """
    if qpos is None:
        return None
    where = "qpos"
    values = qpos
    if isinstance(qpos, str | Path):
        where = f"qpos: {qpos}"
        try:
            values = _read_numbers(Path(qpos))
        except (ValueError, EOFError) as cause:
            raise ArgumentError(f"{where}: expected numbers, got: {cause}") from cause
        if values.shape == (1, size):
            values = values[0]
    array = numbers(where, values, (None,) if np.ndim(values) == 1 else (None, None))
    if array.shape == (size,):
        return array
    if array.ndim == 2 and array.shape[1] == 1 + size and len(array) and (np.diff(array[:, 0]) > 0).all():
        return array
    expected = f"expected {size} numbers, or rows of an increasing time and {size} numbers"
    raise ArgumentError(f"{where}: {expected}, got {' x '.join(map(str, array.shape))}")
