"""From requests to commands: poses set where they change, pictures asked for, late ones skipped."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

from omniscv.captures.unreal.motion import SETTLED, Motion, witness
from omniscv.captures.view import Request, View

IMAGE = {
    "lit": ("lit png", "png"),
    "object_mask": ("object_mask png", "png"),
    "depth": ("depth npy", "npy planar cm"),
    "normal": ("normal png", "png normal"),
}
"""By mode: the end of the command, and the encoding of what it answers."""


class Use(Enum):
    """What becomes of a command's reply."""

    CHECK = "it must be ok"
    SKIP = "it may be late or garbage, whatever it is"
    REFERENCE = "it is what the camera shows before it moves"
    WITNESS = "it tells whether the camera is where it was sent"
    KEEP = "it is a capture"


@dataclass(frozen=True)
class Step:
    """A command, what its reply is for, and the picture that it asks for, if any."""

    command: str
    use: Use
    request: Request | None = None


def make_steps(camera: int, requests: Iterable[Request], posed: View | None, motion: Motion) -> list[Step]:
    """The commands for captures, in order.

    Args:
        camera: the camera's number.
        requests: what to capture.
        posed: the view that the camera is set to; None: unknown.
        motion: what it has shown.
    """
    steps: list[Step] = []
    latest, shown, skips = motion.latest, dict(motion.shown), motion.skips()
    for request in requests:
        reference = _reference(request, posed, motion.in_doubt)
        if reference is not None:
            steps += [Step(c, Use.CHECK) for c in pose_commands(camera, posed, reference.view)]
            steps += [_picture(camera, reference, Use.SKIP)] * (SETTLED if motion.in_doubt else 0)
            steps.append(_picture(camera, reference, Use.REFERENCE))
            posed, latest, shown[request.mode] = reference.view, reference, reference.view
        if motion.in_doubt or posed is None or posed != request.view:
            steps += [Step(command, Use.CHECK) for command in pose_commands(camera, posed, request.view)]
            first = witness(request, latest, shown)
            steps += [_picture(camera, first or request, Use.SKIP)] * skips
            if first is not None:
                steps.append(_picture(camera, first, Use.WITNESS))
                shown[first.mode] = first.view
            skips = motion.lag
        steps.append(_picture(camera, request, Use.KEEP))
        posed, latest, shown[request.mode] = request.view, request, request.view
    return steps


def _reference(request: Request, posed: View | None, in_doubt: bool) -> Request | None:
    """A picture to take before a move, where there is none of the same size that the next could equal."""
    if posed is None:
        return None
    wanted = request.view
    before = View(posed.pose, wanted.fov_deg, wanted.width, wanted.height)
    needed = before != wanted and (in_doubt or before != posed)
    return Request(before, request.mode) if needed else None


def _picture(camera: int, request: Request, use: Use) -> Step:
    return Step(f"vget /camera/{camera}/{IMAGE[request.mode][0]}", use, request)


def pose_commands(number: int, before: View | None, view: View) -> list[str]:
    """What changes from one view to the next; numbers with fixed decimals, as servers parse them."""
    camera, commands = f"vset /camera/{number}", []
    location, rotation = view.pose.to_unreal()
    if before is None or (before.width, before.height) != (view.width, view.height):
        commands.append(f"{camera}/size {view.width} {view.height}")
    if before is None or before.fov_deg != view.fov_deg:
        commands.append(f"{camera}/fov {view.fov_deg:.8f}")
    if before is None or before.pose.to_unreal().location_cm != location:
        commands.append("{}/location {:.6f} {:.6f} {:.6f}".format(camera, *location))
    if before is None or before.pose.to_unreal().rotation_deg != rotation:
        commands.append("{}/rotation {:.8f} {:.8f} {:.8f}".format(camera, *rotation))
    return commands
