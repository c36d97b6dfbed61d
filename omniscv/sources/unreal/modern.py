"""The camera driver of plugin 1.x (dialects M and N1 to N3): a spawned camera, commands in batches."""

import logging
from collections.abc import Iterator
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from omniscv.arguments import shown
from omniscv.errors import ArgumentError, BadReplyError, ServerRefusedError
from omniscv.geometry import Pose
from omniscv.sources.base import Capture, Request, View
from omniscv.sources.unreal.client import Client
from omniscv.sources.unreal.driver import SETTLED, CameraDriver, Requests, by_hand, lumen, matching_bias
from omniscv.sources.unreal.motionless import check_location
from omniscv.sources.unreal.protocol import CAMERAS, EXPOSURE_METHOD, MODERN, VERSION, name, names, numbers
from omniscv.sources.world import Exposure, SharedExposure, exposure_to_text

_log = logging.getLogger("omniscv")

_LIMITS_DEG = (1.0, 179.0)  # fields of view that engines do not clamp in silence
# are set once, to be read back
_TRIED_PX = (64, 48)
_TRIED_DEG = 100.0
_TRIED = {"fov": "a field of view, degrees, of", "size": "a size, px, of"}
_SAME_DEG = 1e-3  # servers print six decimals, of single precision


class Step(NamedTuple):
    """A command of a batch, and the request of its picture, None for one that moves the camera.

    ``use`` is of the reply. ``check``: it must be ok; ``where``: it is where the camera is; ``skip``: it may
    be stale or garbage; ``reference``: it shows what the camera sees before it moves; ``keep``: it is a
    capture.
    """

    command: str
    use: Literal["check", "where", "skip", "reference", "keep"]
    request: Request | None = None


class ModernDriver(CameraDriver):
    """Spawns a camera: straight up and down are exact, no pose lags, size and field of view can be set."""

    table = MODERN
    _stops: float | None = 0.0  # of the camera's exposure; None if it is unknown
    _changed_by_hand = False  # whether its exposure was ever set
    _exposure: Exposure = "game"  # of the camera's colours
    _exposed_for: SharedExposure | None = None  # the last one that it was set for
    _matched: tuple[tuple[float, ...], Exposure] | None = None  # where the game's was measured last, and it

    def attach(self) -> None:
        self.forget()
        try:
            count = len(names(self.connection.text(CAMERAS)))
        except ServerRefusedError as no:
            raise ServerRefusedError(f"expected plugin 0.3.10, or 1.x with {CAMERAS!r}, got: {no}") from no
        if count == 0:  # numbers of cameras would start at one that does not exist
            raise self._refused(f"the player's camera from {CAMERAS!r}, got no camera; start the game")
        if not self._restore or self.camera >= count:
            self._prepared = False
            self._spawn(count)
        if not self._prepared:  # after the camera: a game that starts again in between lacks it
            self._prepare()
            self._prepared = True

    def check(self, request: Request) -> None:
        super().check(request)
        low, high = _LIMITS_DEG
        if not low <= request.view.fov_deg <= high:
            expected = f"expected {low:.6g} to {high:.6g} degrees, which engines do not clamp"
            raise ArgumentError(f"fov_deg: {expected}, got {request.view.fov_deg:.6g}")

    def aim(self, before: View | None, view: View) -> list[str]:
        known = {} if before is None else _settings(before)
        changed = {key: value for key, value in _settings(view).items() if known.get(key) != value}
        return [f"vset /camera/{self.camera}/{key} {value}" for key, value in changed.items()]

    def _spawn(self, number: int) -> None:
        self.spawned += 1
        self._changed_by_hand = False
        self._stops = 0.0
        self._exposed_for = None
        self._restore = [f"vset /object/{name(self.connection.text('vset /cameras/spawn'))}/destroy"]
        self.camera = number

    def _spawn_another(self) -> None:
        """Spawn a camera as the game has them: what was set on the last one cannot be put back."""
        before = self._restore
        self._spawn(len(names(self.connection.text(CAMERAS))))
        self._restore += before

    def _is_gone(self) -> bool:
        return self.camera >= len(names(self.connection.text(CAMERAS)))

    def verify(self) -> None:
        for what, values in {"fov": (_TRIED_DEG,), "size": _TRIED_PX}.items():
            at = f"/camera/{self.camera}/{what}"
            text = " ".join(map(str, values))
            done, read = self.connection.texts([f"vset {at} {text}", f"vget {at}"])
            if done != "ok" or read.startswith("error"):
                return  # M reads no size; a game that has started again lacks the camera: captures find that
            if not np.allclose(numbers(read, len(values)), values, rtol=0, atol=_SAME_DEG):
                raise self._refused(f"{_TRIED[what]} {text}, which was set, got {shown(read)}")

    def expose(self, requests: Requests) -> None:
        colors = [request for request in requests if request.mode == "lit"]
        shared = self.shared_exposure
        chosen = self._options.exposure
        if not colors or self._exposed_for is shared:
            return
        if chosen is None and not self.connection.supports(EXPOSURE_METHOD):
            chosen = "game"
        elif chosen is not None and chosen != "auto":
            _check_as_before(chosen, shared.value)
        try:
            if chosen is None or chosen == "auto":
                chosen = shared.get(lambda: self._matching(colors[0].view.pose))
            self._set_exposure(chosen)
        except ServerRefusedError as refused:
            if self._is_gone():
                raise BadReplyError(f"{refused}; the camera is gone") from refused
            raise
        self._exposed_for = shared

    def _matching(self, pose: Pose) -> Exposure:
        """Return the manual exposure that matches the game's own, which is kept if none does."""
        position = self.shared_exposure.position
        location_cm, _ = (pose if position is None else Pose(position, pose.rotation)).to_unreal()
        if self._matched and (position is None or self._matched[0] == tuple(location_cm)):
            return self._matched[1]
        if self._changed_by_hand:  # an earlier attempt was cut short
            self._spawn_another()
        self._changed_by_hand = True
        why = "no manual exposure matches it"
        try:
            bias = matching_bias(self.connection, self.camera, location_cm)
        except ServerRefusedError as refused:
            if self._options.exposure is not None or self._is_gone():
                raise
            bias = None
            why = str(refused)
        if bias is None:
            _log.warning("%s: colours keep the game's own exposure: %s", self.connection.address, why)
        matched: Exposure = "game" if bias is None else bias
        self._matched = tuple(location_cm), matched
        return matched

    def _set_exposure(self, chosen: Exposure) -> None:
        """Set all of an exposure but its bias, which is set with the next colour."""
        if chosen != "game":
            self.connection.set(lumen(self.camera))
            self.color_settings = {"exposure": exposure_to_text(chosen)}
        elif self._changed_by_hand:
            self._spawn_another()
            self.color_settings = {}
        else:
            return
        self._exposure = chosen
        self._changed_by_hand = chosen != "game"
        self.stale_frames.reset()  # the last pictures were others than captures
        self.forget()

    def forget(self) -> None:
        super().forget()
        self._stops = None if self._changed_by_hand else 0.0

    def _change_stops(self, before: float | None, stops: float | None) -> list[str]:
        """Return the commands that change the exposure: from the first one on, it is set by hand."""
        if stops == before:
            return []
        self._changed_by_hand = True
        bias = 0.0 if self._exposure == "game" else self._exposure
        return by_hand(self.camera, bias + (stops or 0.0))

    def collect(self, client: Client, requests: Requests) -> Iterator[Capture]:
        """Yield captures until a frame may be stale.

        A reply that is cut short swallows bytes of the next frame. So a picture counts only once the next
        reply is in step; the version, requested at the end, follows the last picture, and the scene's name.
        """
        captures = self._collected(client, requests)
        yield from list(captures) if self.one_tick else captures  # one tick counts as a whole

    def _collected(self, client: Client, requests: Requests) -> Iterator[Capture]:
        batch = requests[:1] if self.stale_frames.in_doubt else requests
        steps = self._steps(batch)
        self._aimed = batch[-1].view
        commands = [*(step.command for step in steps), VERSION, *self.connection.scene]
        replies = client.stream([f"vbatch {len(commands)}"] * self.one_tick + commands)
        if self.one_tick:
            self._expect("ok", "vbatch", next(replies))
        fresh = True
        complete = None
        for step, reply in zip(steps, replies, strict=False):
            if complete is not None:
                yield complete
                complete = None
            if step.request is None:
                self._expect("ok", step.command, reply)
            elif step.use == "where":
                check_location(self.connection.address, step.request.view, str(reply))
            elif step.use != "skip":
                capture = self._capture(step.request, step.request.view, reply)
                frame = {capture.mode: capture.payload or b""}
                if self.one_tick:  # in which no frame becomes fresher
                    self.stale_frames.note(_sight(step.request), frame)
                    complete = capture
                elif fresh and step.use == "reference":
                    self.stale_frames.note(_sight(step.request), frame)
                elif fresh and (fresh := self.stale_frames.accepts(_sight(step.request), frame)):
                    complete = capture
        self._expect(self._version, VERSION, next(replies))
        self.connection.compare_scene(replies)
        if complete is not None:
            yield complete

    def check_scene(self) -> None:
        """As the driver's; the captures of a turn end with the scene's name, which was compared."""

    def _steps(self, requests: Requests) -> list[Step]:
        """Return the commands for captures; before a move is a frame of its mode and size to compare."""
        steps: list[Step] = []
        aimed = self._aimed
        stops = self._stops
        in_doubt = self.stale_frames.in_doubt
        states = dict(self.stale_frames.states)
        skips = self.stale_frames.skips()

        def picture(use: Literal["skip", "reference", "keep"], request: Request, count: int = 1) -> None:
            steps.extend([Step(self.table.image(self.camera, request.mode), use, request)] * count)

        def move(request: Request) -> None:
            nonlocal aimed, stops
            next_stops = _stops_of(request, stops)
            commands = self.aim(aimed, request.view) + self._change_stops(stops, next_stops)
            steps.extend(Step(command, "check") for command in commands)
            aimed = request.view
            stops = next_stops

        for number, request in enumerate(requests):
            view = request.view
            mode = request.mode
            if in_doubt or aimed != view or stops != _stops_of(request, stops):
                before = request
                if aimed is not None:
                    shown = stops if mode == "lit" else None
                    before = replace(request, view=replace(view, pose=aimed.pose), stops=shown)
                is_known = not in_doubt and states.get(mode) == _sight(before)
                if not self.one_tick and _sight(before) != _sight(request) and not is_known:
                    move(before)
                    picture("skip", before, SETTLED if in_doubt else 0)
                    picture("reference", before)
                move(request)
                if not self.one_tick:
                    picture("skip", request, max(skips, self._options.warmup if mode == "lit" else 0))
                    skips = self.stale_frames.lag
            picture("keep", request)
            states[mode] = _sight(request)
            following = requests[number + 1].view if number + 1 < len(requests) else None
            if following is None or following.key().position != view.key().position:
                steps.append(Step(f"vget /camera/{self.camera}/location", "where", request))
        self._stops = stops
        return steps


def _check_as_before(chosen: Exposure, before: Exposure | None) -> None:
    """Raise ArgumentError for another exposure than the one that a recording's colours have."""
    known = [value for value in (before, chosen) if value is not None]
    in_words = ["the game's own" if value == "game" else f"a bias of {value:g}" for value in known]
    if len(set(in_words)) > 1:
        advice = "leave exposure out to go on with it, or record into another file"
        raise ArgumentError("exposure: expected {}, as recorded before, got {}; {}".format(*in_words, advice))


def _stops_of(request: Request, before: float | None) -> float | None:
    """Return the exposure for a request; modes other than colours keep the one before."""
    return (request.stops or 0.0) if request.mode == "lit" else before


def _sight(request: Request) -> tuple[View, float]:
    """Return what decides a picture: the view and its exposure."""
    return request.view, request.stops or 0.0


def _settings(view: View) -> dict[str, str]:
    """Return by command the arguments that set a view, with fixed decimals, as servers parse them."""
    location, rotation = view.pose.to_unreal()
    return {
        "size": f"{view.width} {view.height}",
        "fov": f"{view.fov_deg:.8f}",
        "location": "{:.6f} {:.6f} {:.6f}".format(*location),
        "rotation": "{:.8f} {:.8f} {:.8f}".format(*rotation),
    }
