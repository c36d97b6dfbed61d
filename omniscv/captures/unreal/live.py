"""The live source: a camera of its own, posed for every view, asked for every mode."""

from __future__ import annotations

import contextlib
import time
from collections import deque
from collections.abc import Iterable, Iterator
from typing import Any

from omniscv.captures.decode import decode
from omniscv.captures.source import Capabilities, ObjectTable, Source
from omniscv.captures.unreal.link import FAULTS, Link
from omniscv.captures.unreal.masks import colors, paint
from omniscv.captures.unreal.motion import Motion
from omniscv.captures.unreal.session import Reply, Session
from omniscv.captures.unreal.steps import IMAGE, Step, Use, make_steps
from omniscv.captures.view import Capture, Request, View
from omniscv.errors import BadReply, ServerRefused, SourceError

_BATCH = 24
"""Requests under way at once: enough to hide latency, few enough to wait in memory."""
_BATCH_PX = 1 << 24
"""Pixels under way at once; a larger picture goes alone."""

VERSION = "vget /unrealcv/version"
CURES = ("vrun r.Tonemapper.Quality 1", "vrun r.EyeAdaptationQuality 0")
"""Against vignette and auto exposure (protocol reference, section 7.1)."""


class UnrealSource(Source):
    """Captures from a UE4/UE5 editor or packaged game with plugin 1.x.

    It spawns a camera of its own, so that straight up and down are exact and no pose lags, and sets its
    size and field of view. After a fault the connection is dropped and made anew, the pose set again, and
    the captures that were under way are repeated. A picture counts once it has the right id, signature,
    length and size, the reply behind it is in step, and it is not the one from before the camera moved.

    Args:
        link: the way to the server; closed with this.
        capabilities: what its dialect can do.
        fix_exposure: switches vignette and auto exposure off in the running game.

    Raises:
        SourceError: too many faults in a row, or a server that refuses what is needed.
    """

    def __init__(self, link: Link, capabilities: Capabilities, fix_exposure: bool) -> None:
        self._link, self._capabilities, self._fix_exposure = link, capabilities, fix_exposure
        self._ours: Session | None = None
        self._camera: int | None = None
        self._actor = ""
        self._posed: View | None = None
        self._motion = Motion()
        self._session()

    @property
    def capabilities(self) -> Capabilities:
        return self._capabilities

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        group: list[Request] = []
        pixels = 0
        for request in requests:
            size = request.view.width * request.view.height
            if len(group) == _BATCH or (group and pixels + size > _BATCH_PX):
                yield from self._delivered(group)
                group, pixels = [], 0
            group.append(request)
            pixels += size
        yield from self._delivered(group)

    def objects(self) -> ObjectTable:
        return ObjectTable(colors(self._link))

    def close(self) -> None:
        """Takes our camera out of the game, where the connection still serves, and leaves."""
        session = self._ours
        if self._actor and session is not None and not session.broken:
            with contextlib.suppress(SourceError):  # the game may be gone; then so is the camera
                list(session.stream([f"vset /object/{self._actor}/destroy"]))
        self._actor = ""
        self._link.close()

    def _session(self) -> Session:
        """A connection over which our camera answers."""
        while self._ours is None or self._ours.broken:
            self._posed = None
            self._motion.lost()
            self._find_camera()
            self._ours = self._link.session
        return self._ours

    def _find_camera(self) -> None:
        """Finds our camera, or makes whatever game is there now ready and spawns one."""
        try:
            count = len(self._link.text("vget /cameras").split())
        except ServerRefused as refused:
            raise ServerRefused(
                f"expected plugin 0.3.10, or 1.x with 'vget /cameras', got: {refused}"
            ) from refused
        if self._camera is not None and self._camera < count:
            return
        self._version, self._scene = self._link.text(VERSION), self._link.text("vget /scene/name")
        if self._fix_exposure:
            self._link.texts(CURES)
        paint(self._link)
        self._camera = count
        self._actor = self._link.text("vset /cameras/spawn")

    def _delivered(self, group: list[Request]) -> Iterator[Capture]:
        """A group's captures; what came before a fault is kept, and progress earns new retries."""
        waiting = deque(group)
        failures = 0
        while waiting:
            done: list[Capture] = []
            fault: SourceError | None = None
            session = self._session()
            try:
                self._collect(session, waiting, done)
            except FAULTS as cause:
                fault = cause
            yield from done
            failures = 0 if done else failures
            if fault is not None:
                failures += 1
                self._link.recover(fault, failures)

    def _collect(self, session: Session, waiting: deque[Request], done: list[Capture]) -> None:
        """Moves requests from ``waiting`` to captures in ``done``, until a picture comes late.

        A short reply draws bytes of the next frame in, so a picture counts only once the reply behind it
        is in step; the version, asked for at the end, stands behind the last.
        """
        assert self._camera is not None
        requests = [waiting[0]] if self._motion.in_doubt else list(waiting)
        steps = make_steps(self._camera, requests, self._posed, self._motion)
        self._posed = requests[-1].view
        replies = session.stream([*(step.command for step in steps), VERSION])
        late = False
        held: Capture | None = None
        for step in steps:
            reply = next(replies)
            if held is not None:
                done.append(held)
                waiting.popleft()
                held = None
            capture = self._judged(session, step, reply)
            if capture is None or late:
                continue
            if step.use is Use.REFERENCE:
                self._motion.note(capture.request, capture.payload)
            elif not self._motion.shows(capture.request, capture.payload):
                late = True
            elif step.use is Use.KEEP:
                held = capture
        if (version := next(replies)) != self._version:
            raise BadReply(
                f"{session.address}: expected version {self._version!r} as before, got {version!r}"
            )
        if held is not None:
            done.append(held)
            waiting.popleft()

    def _judged(self, session: Session, step: Step, reply: Reply) -> Capture | None:
        """The picture of a step, if it has one that matters.

        Raises:
            BadReply: the reply is not what the step asks for.
        """
        if step.use is Use.CHECK and reply != "ok":
            raise BadReply(f"{session.address}: expected ok from {step.command!r}, got {reply[:200]!r}")
        if step.request is None or step.use is Use.SKIP:
            return None
        if isinstance(reply, str):
            raise BadReply(
                f"{session.address}: expected a picture from {step.command!r}, got {reply[:200]!r}"
            )
        request, encoding = step.request, IMAGE[step.request.mode][1]
        pixels = decode(reply, encoding, request.mode, request.view)
        return Capture(request, request.view, pixels, reply, encoding, self._provenance(step.command))

    def _provenance(self, command: str) -> dict[str, Any]:
        return {
            "server": self._link.address,
            "scene": self._scene,
            "version": self._version,
            "dialect": self._capabilities.dialect,
            "command": command,
            "time": time.time(),
        }
