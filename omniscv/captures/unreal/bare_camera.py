"""A camera as it is, by bare commands of any dialect: nothing is repaired, so faults can be seen."""

from __future__ import annotations

import re
import struct
import time
from types import TracebackType
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from omniscv.captures.decode import decode
from omniscv.captures.unreal.link import Link
from omniscv.captures.unreal.probe import L, dialect_of
from omniscv.captures.unreal.session import Reply
from omniscv.captures.unreal.steps import IMAGE
from omniscv.captures.view import View
from omniscv.errors import BadReply, ServerRefused
from omniscv.geometry import Array, Pose

EDGE_PX = 128
"""Pictures are square and of this size, where the server can be told so."""
_LARGEST_PX = 1 << 13
_NPY_SHAPE = re.compile(rb"'shape': \((\d{1,5}), (\d{1,5})")
_PICTURES = 8
"""After so many pictures in one place a camera shows it, if it ever does."""
_NOISE, _MOVING = 0.01, 0.05
"""Relative depth, and share of a picture, by which pictures of one place may differ."""


class Settled(NamedTuple):
    """What a camera did after a turn.

    Attributes:
        rests: whether its pictures came to show one thing.
        late: how many pictures came before the first of that.
        seconds: when that came.
        depth: (H, W) that, in the server's meaning and unit.
    """

    rests: bool
    late: int
    seconds: float
    depth: NDArray[Any]


class BareCamera:
    """A camera that is set and asked by bare commands. A context manager, which leaves things in order.

    With plugin 1.x it is spawned, with 0.3.10 it is the player's, which is put back at the end.

    Args:
        link: the way to the server.
        position: (3,) where to look around, world frame, metres; None: where the player is.

    Attributes:
        dialect: 0.3.10, M, N1 or N2.
        size: width and height of its lit pictures, px.
        fov_deg: the horizontal field of view that it says it has: 90 degrees along the shorter side.
        mask_fov_deg: that of object masks, which 0.3.10 takes from the window, as its settings say.
        position: (3,) where it is.
        lag: how many pictures after a move to throw away.

    Raises:
        SourceError: nobody answers, or not as an UnrealCV server does.
    """

    def __init__(self, link: Link, position: Array | None = None) -> None:
        self._link = link
        self.dialect = dialect_of(link)
        self._start = [_numbers(link.text(f"vget /camera/0/{what}")) for what in ("location", "rotation")]
        self.lag = _PICTURES
        if self.dialect == L:
            number, fov = 0, "horizontal_fieldofview"
            self._start_fov = link.text(f"vget /camera/0/{fov}")
        else:
            number, fov = len(link.text("vget /cameras").split()), "fov"
            link.text("vset /cameras/spawn")
            link.text(f"vset /camera/{number}/size {EDGE_PX} {EDGE_PX}")
        self._at = f"/camera/{number}"
        self.size = _size(self.payload("lit"))
        link.text(f"vset {self._at}/{fov} {across(*self.size):.4f}")
        self.fov_deg = float(link.text(f"vget {self._at}/{fov}"))
        self.mask_fov_deg = _setting(link, "FOV") if self.dialect == L else self.fov_deg
        here = Pose.from_unreal(self._start[0], (0, 0, 0)).position
        self.position = here if position is None else position

    def go(self, yaw_deg: float, pitch_deg: float = 0.0, forward_m: float = 0.0) -> Pose:
        """Turns to world angles, moves along the new axis, and waits until pictures show it."""
        pose = self._sent(yaw_deg, pitch_deg, forward_m)
        for _ in range(self.lag):
            self.payload("depth")
        return pose

    def settle(self, yaw_deg: float, pitch_deg: float) -> Settled:
        """Turns, and watches depth come to rest."""
        began = time.monotonic()
        self._sent(yaw_deg, pitch_deg, 0.0)
        came = [(self.pixels("depth"), time.monotonic() - began) for _ in range(_PICTURES)]
        last = came[-1][0]
        other = [i for i, (depth, _) in enumerate(came) if not alike(depth, last)]
        late = other[-1] + 1 if other else 0
        return Settled(late < _PICTURES - 1, late, came[late][1], last)

    def rotation(self) -> tuple[float, ...]:
        """Pitch, yaw and roll that the camera says it has, degrees."""
        return _numbers(self._link.text(f"vget {self._at}/rotation"))

    def payload(self, mode: str) -> bytes:
        """A picture's bytes.

        Raises:
            ServerRefused: the server has no such picture.
        """
        return self._link.ask(self._picture(mode), self._payload_of)

    def pixels(self, mode: str) -> NDArray[Any]:
        """A picture: (H, W, 3) uint8, or (H, W) float32 depth as it comes, in the server's meaning and unit.

        Raises:
            ServerRefused: the server has no such picture.
            BadReply: the bytes are no picture.
        """

        def decoded(reply: Reply) -> NDArray[Any]:
            payload = self._payload_of(reply)
            view = View(Pose(np.zeros(3), np.eye(3)), 90.0, *_size(payload))
            return decode(payload, "npy" if mode == "depth" else "png", mode, view)

        return self._link.ask(self._picture(mode), decoded)

    def _picture(self, mode: str) -> str:
        return f"vget {self._at}/{IMAGE[mode][0]}"

    def _payload_of(self, reply: Reply) -> bytes:
        if isinstance(reply, str):
            kind = ServerRefused if reply.startswith("error") else BadReply
            raise kind(f"{self._link.address}: expected a picture, got {reply[:200]!r}")
        return reply

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None and self.dialect == L:
            self._set(*self._start)
            self._link.text(f"vset /camera/0/horizontal_fieldofview {self._start_fov}")
            self._link.text("vset /viewmode lit")  # masks leave the window in their mode

    def _sent(self, yaw_deg: float, pitch_deg: float, forward_m: float) -> Pose:
        turned = Pose.from_angles(self.position, yaw_deg, pitch_deg)
        pose = Pose(turned.to_world((0.0, 0.0, forward_m)), turned.R_w_c)
        self._set(*pose.to_unreal())
        return pose

    def _set(self, location_cm: tuple[float, ...], rotation_deg: tuple[float, ...]) -> None:
        for what, numbers in (("location", location_cm), ("rotation", rotation_deg)):
            self._link.text("vset {}/{} {:.4f} {:.4f} {:.4f}".format(self._at, what, *numbers))


def alike(depth: NDArray[Any], other: NDArray[Any]) -> bool:
    """Whether two pictures show the same, but for noise and small things that move."""
    return bool(np.isclose(depth, other, rtol=_NOISE).mean() > 1 - _MOVING)


def across(width: int, height: int) -> float:
    """The horizontal field of view that sees 90 degrees up and down, degrees."""
    return float(2 * np.degrees(np.arctan(width / height)))


def _setting(link: Link, name: str) -> float:
    status = link.text("vget /unrealcv/status")
    found = re.search(rf"^{name}: (\d+(?:\.\d+)?)$", status, re.MULTILINE | re.ASCII)
    if found is None:
        raise BadReply(f"{link.address}: expected {name} among the settings, got {status[:300]!r}")
    return float(found[1])


def _numbers(text: str) -> tuple[float, ...]:
    try:
        values = tuple(float(word) for word in text.split())
    except ValueError:
        values = ()
    if len(values) != 3:
        raise BadReply(f"expected three numbers, got {text[:200]!r}")
    return values


def _size(payload: bytes) -> tuple[int, int]:
    """Width and height by the header of a PNG or NPY."""
    if payload.startswith(b"\x89PNG") and len(payload) >= 24:
        width, height = struct.unpack(">II", payload[16:24])
    elif found := _NPY_SHAPE.search(payload[:256]):
        height, width = int(found[1]), int(found[2])
    else:
        raise BadReply(f"expected a PNG or NPY, got {len(payload)} bytes that start with {payload[:24]!r}")
    if not 1 <= height <= width <= _LARGEST_PX:
        raise BadReply(
            f"expected a picture at most {_LARGEST_PX} px wide and no higher, got {width} x {height}"
        )
    return width, height
