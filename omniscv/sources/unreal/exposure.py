"""The exposure of one camera, where the plugin sets it for each, and a bias that matches the game's own.

Nothing reads these values back (supplement to the protocol reference, section 2.1). So they are set on
cameras that were spawned, which leave with the source.
"""

from collections.abc import Sequence

import numpy as np

from omniscv.arguments import shown
from omniscv.errors import BadReplyError
from omniscv.geometry import Pose
from omniscv.sources.codecs import decode_png, picture_size
from omniscv.sources.requests import View
from omniscv.sources.unreal.client import Connection
from omniscv.sources.unreal.driver import SETTLED
from omniscv.sources.unreal.protocol import Reply
from omniscv.sources.world import EXPOSURE_LIMITS

_YAWS_DEG = (0, 90, 180, 270)
_EDGE_PX = 64  # of the pictures
_MOST = 8  # pictures in one direction, in which automatic exposure settles
_SETTLED, _EQUAL, _NEAR = 0.5, 1.0, 8.0  # grey levels, of mean brightness
_PRECISION = 2  # decimals of a bias


def by_hand(camera: str | int, bias: float) -> list[str]:
    """Return the commands for manual exposure that a bias in stops alone decides.

    A cine model that is on ignores them: it keeps the values from when it was switched on.
    """
    settings = ("exposure_method manual", "physical_exposure 0", f"exposure_bias {bias:.8f}")
    return [f"vset /camera/{camera}/{setting}" for setting in settings]


def lumen(camera: str | int) -> list[str]:
    """Return the commands that light a camera's pictures as the game's own view in Unreal 5."""
    return [f"vset /camera/{camera}/{what} lumen" for what in ("illumination", "reflection")]


def matching_bias(connection: Connection, camera: str | int, location_cm: Sequence[float]) -> float | None:
    """Return the bias at which manual exposure is as bright as the game's own; None if none comes near.

    Brightness is the mean of four directions. It grows with the bias; the tone curve need not be known. Black
    or white pictures say nothing of the bias, so none matches them.

    Args:
        connection: to the server.
        camera: a spawned one, as the game exposes it. Its pose, size, field of view, illumination and
            exposure are left changed.
        location_cm: x, y, z in Unreal's frame.

    Raises:
        ServerRefusedError: the server refuses one of the commands.
    """
    looks = _Looks(connection, camera, location_cm)
    target = float(np.mean([looks.settled(yaw) for yaw in _YAWS_DEG]))
    if not _NEAR < target < 255 - _NEAR:
        return None
    tried: dict[float, float] = {}

    def excess(bias: float) -> float:
        """Return how much brighter than the target a bias is; 0 if the difference is invisible."""
        bias = round(bias, _PRECISION)
        if bias not in tried:
            looks.read(by_hand(camera, bias))  # the next picture may still have the exposure from before
            tried[bias] = float(np.mean([looks.after_turn(yaw) for yaw in _YAWS_DEG])) - target
        return tried[bias] if abs(tried[bias]) > _EQUAL else 0.0

    near, far = 0.0, float(-np.sign(excess(0.0)))
    while excess(near) * excess(far) > 0 and abs(far) < EXPOSURE_LIMITS[1]:
        near, far = far, 2 * far
    if excess(near) * excess(far) < 0:
        from scipy.optimize import brentq

        brentq(excess, near, far, xtol=10**-_PRECISION)
    best = min(tried, key=lambda bias: abs(tried[bias]))
    return best if abs(tried[best]) <= _NEAR else None


class _Looks:
    """Small pictures from one place. After a turn, one that equals the last one to the byte is stale."""

    def __init__(self, connection: Connection, camera: str | int, location_cm: Sequence[float]) -> None:
        self._connection, self._at, self._last = connection, f"/camera/{camera}", b""
        location = "{:.6f} {:.6f} {:.6f}".format(*location_cm)
        settings = f"size {_EDGE_PX} {_EDGE_PX}", "fov 90.0", f"location {location}"
        connection.set([f"vset {self._at}/{setting}" for setting in settings])
        connection.set(lumen(camera))
        for _ in range(SETTLED):  # the first pictures of a camera may be garbage
            self.read([])

    def settled(self, yaw_deg: int) -> float:
        """Return the brightness in a direction once two pictures agree."""
        before = self.after_turn(yaw_deg)
        for _ in range(_MOST - 1):
            mean = self.read([])
            if abs(mean - before) < _SETTLED:
                break
            before = mean
        return mean

    def after_turn(self, yaw_deg: int) -> float:
        """Return the brightness in a direction, of the first picture that shows it."""
        before, mean = self._last, self.read([f"vset {self._at}/rotation 0.0 {yaw_deg}.0 0.0"])
        for _ in range(SETTLED):
            if self._last != before:
                break
            mean = self.read([])
        return mean

    def read(self, settings: Sequence[str]) -> float:
        """Set something, and return the mean of the next picture, 0 to 255."""
        self._connection.set(settings)
        (self._last,) = self._connection.read([f"vget {self._at}/lit png"], _picture)
        return _mean(self._last)


def _picture(command: str, reply: Reply) -> bytes:
    """Return a reply that is a picture; BadReplyError for another one, which is then requested again."""
    if isinstance(reply, str):
        raise BadReplyError(f"expected a picture from {shown(command)}, got {shown(reply[:100])}")
    _mean(reply)
    return reply


def _mean(picture: bytes) -> float:
    """Return the mean of a PNG, which may have the size from before."""
    view = View(Pose(np.zeros(3), np.eye(3)), 90.0, *picture_size(picture))
    return float(decode_png(picture, view).mean())
