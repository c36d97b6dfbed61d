"""The exposure of one camera, where the plugin sets it for each, and a bias that matches the game's own.

Nothing reads these values back (supplement to the protocol reference, section 2.1). So they are set on
cameras that were spawned, which leave with the source.
"""

from collections.abc import Callable

import numpy as np

from omniscv.errors import ServerRefusedError
from omniscv.sources.codecs import decode_png
from omniscv.sources.requests import View
from omniscv.sources.unreal.client import Connection
from omniscv.sources.unreal.commands import EXPOSURE_METHOD
from omniscv.sources.unreal.replies import Reply
from omniscv.sources.world import EXPOSURE_LIMITS

_STEP = 0.25  # stops between the biases that are tried
_YAWS_DEG = (0, 90, 180, 270)
_EDGE_PX, _ADAPTS = 64, 24  # of pictures; the frames that automatic exposure is given
_STALE = 2  # frames in which a change of exposure may not show yet


def check(connection: Connection) -> None:
    """Raise ServerRefusedError for a server that cannot set the exposure of one camera."""
    if not connection.supports(EXPOSURE_METHOD):
        expected = "expected a server that sets the exposure of one camera (N2 or later)"
        got = f"got dialect {connection.plugin.dialect}; use fix_exposure"
        raise ServerRefusedError(f"{connection.address}: {expected}, {got}")


def by_hand(camera: str | int, bias: float) -> list[str]:
    """Return the commands for manual exposure that a bias in stops alone decides.

    A cine model that is on ignores them: it keeps the values from when it was switched on.
    """
    settings = ("exposure_method manual", "physical_exposure 0", f"exposure_bias {bias:.8f}")
    return [f"vset /camera/{camera}/{setting}" for setting in settings]


def lumen(camera: str | int) -> list[str]:
    """Return the commands that light a camera's pictures as the game's own view in Unreal 5."""
    return [f"vset /camera/{camera}/{what} lumen" for what in ("illumination", "reflection")]


def matching_bias(connection: Connection, camera: str | int) -> float:
    """Return the bias at which manual exposure is as bright as the automatic one, in four directions.

    A bisection over quarters of a stop: brightness grows with the bias, by which curve is not known.

    Args:
        connection: to the server.
        camera: a spawned one; its size, field of view and rotation are left changed, its place is not.
    """
    at = f"vset /camera/{camera}"

    def brightness(*settings: str, frames: int) -> float:
        connection.set([f"{at}/{setting}" for setting in settings])
        greys = []
        for yaw in _YAWS_DEG:
            connection.set([f"{at}/rotation 0.0 {yaw}.0 0.0"])
            pictures = connection.read([f"vget /camera/{camera}/lit png"] * frames, _grey)
            greys.append(pictures[-1])
        return float(np.mean(greys))

    def manual(steps: int) -> float:
        bias = f"exposure_bias {steps * _STEP:.6f}"
        return brightness("exposure_method manual", bias, frames=1 + _STALE)

    connection.set([f"{at}/size {_EDGE_PX} {_EDGE_PX}", f"{at}/fov 90.0"])
    target = brightness("exposure_method histogram", "exposure_bias 0.0", frames=_ADAPTS)
    return _STEP * _nearest(manual, target, *(round(limit / _STEP) for limit in EXPOSURE_LIMITS))


def _nearest(function: Callable[[int], float], target: float, low: int, high: int) -> int:
    """Return the whole number at which an increasing function is nearest to a value."""
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if function(middle) <= target else (low, middle)
    return min(low, high, key=lambda steps: abs(function(steps) - target))


def _grey(_: str, reply: Reply) -> float:
    """Return a picture's mean, 0 to 255."""
    from omniscv.geometry import Pose

    view = View(Pose(np.zeros(3), np.eye(3)), 90.0, _EDGE_PX, _EDGE_PX)
    return float(decode_png(reply if isinstance(reply, bytes) else reply.encode(), view).mean())
