"""What an address or a job says of a MuJoCo model."""

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
    return None if value is None else str(value) if isinstance(value, int) else text(name, value)


def _flag(name: str, value: object) -> bool:
    return {"1": True, "0": False}[value] if value in ("0", "1") else flag(name, value)


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


def read_qpos(qpos: Any, size: int) -> Array | None:
    """Return ``qpos`` (size,), or a trajectory (n, 1 + size) with seconds that increase; None if not given.

    Raises ArgumentError for another shape, or a file that has no numbers.
    """
    if qpos is None:
        return None
    where = "qpos"
    values = qpos
    if isinstance(qpos, str | Path):
        where = f"qpos: {qpos}"
        try:
            if str(qpos).endswith(".npy"):
                import io

                values = np.load(io.BytesIO(read_bytes(Path(qpos), _MOST_BYTES)), allow_pickle=False)
            else:
                lines = read_text(Path(qpos)).replace(",", " ").splitlines()
                values = np.loadtxt(lines, ndmin=2)
        except (ValueError, EOFError) as cause:
            raise ArgumentError(f"{where}: expected numbers, got: {cause}") from cause
        values = values[0] if values.ndim == 2 and len(values) == 1 and values.shape[1] == size else values
    array = numbers(where, values, (None,) if np.ndim(values) == 1 else (None, None))
    if array.shape == (size,):
        return array
    if array.ndim == 2 and array.shape[1] == 1 + size and len(array) and (np.diff(array[:, 0]) > 0).all():
        return array
    expected = f"expected {size} numbers, or rows of an increasing time and {size} numbers"
    raise ArgumentError(f"{where}: {expected}, got {' x '.join(map(str, array.shape))}")
