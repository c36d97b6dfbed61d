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
# A size and a field of view that are set once, to be read back:
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
        """Return the commands for what differs between ``before`` and ``view``."""
        known = {} if before is None else _settings(before)
        commands = []
        for key, value in _settings(view).items():
            if known.get(key) != value:
                commands.append(f"vset /camera/{self.camera}/{key} {value}")
        return commands

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
            answer, reading = self.connection.texts([f"vset {at} {text}", f"vget {at}"])
            if answer != "ok" or reading.startswith("error"):
                return  # M reads no size; a game that has started again lacks the camera: captures find that
            if not np.allclose(numbers(reading, len(values)), values, rtol=0, atol=_SAME_DEG):
                raise self._refused(f"{_TRIED[what]} {text}, which was set, got {shown(reading)}")

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
        if position is not None:
            pose = Pose(position, pose.rotation)
        location_cm, _ = pose.to_unreal()
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
        self._matched = (tuple(location_cm), matched)
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
        """Yield captures of ``requests``, over a ``client``, until a frame may be stale.

        A reply that is cut short swallows bytes of the next frame. So a picture counts only once the next
        reply is in step; the version, requested at the end, follows the last picture, and the scene's name.
        """
        captures = self._collected(client, requests)
        yield from list(captures) if self.one_tick else captures  # one tick counts as a whole

    def _collected(self, client: Client, requests: Requests) -> Iterator[Capture]:
        batch = requests[:1] if self.stale_frames.in_doubt else requests
        plan = _Plan(self)
        steps = plan.steps(batch)
        self._stops = plan.stops
        self._aimed = batch[-1].view
        commands = [*(step.command for step in steps), VERSION, *self.connection.scene]
        if self.one_tick:
            replies = client.stream([f"vbatch {len(commands)}", *commands])
            self._expect("ok", "vbatch", next(replies))
        else:
            replies = client.stream(commands)
        is_fresh = True
        complete = None  # a capture that counts once the next reply is in step
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
                is_fresh = is_fresh and self._is_fresh(capture, step.use)
                if is_fresh and step.use == "keep":
                    complete = capture
        self._expect(self._version, VERSION, next(replies))
        self.connection.compare_scene(replies)
        if complete is not None:
            yield complete

    def _is_fresh(self, capture: Capture, use: str) -> bool:
        """Return whether a frame is fresh; frames of references, and of one tick, are only remembered."""
        sight = _sight(capture.request)
        frame = {capture.mode: capture.payload or b""}
        if self.one_tick or use == "reference":  # in one tick no frame becomes fresher
            self.stale_frames.note(sight, frame)
            return True
        return self.stale_frames.accepts(sight, frame)

    def check_scene(self) -> None:
        """As the driver's; the captures of a turn end with the scene's name, which was compared."""


class _Plan:
    """The commands of one batch of a driver; before a move is a frame of its mode and size to compare.

    Attributes:
        stops: of the camera's exposure after the batch; None if it is unknown.
    """

    def __init__(self, driver: ModernDriver) -> None:
        self._driver = driver
        self._steps: list[Step] = []
        self._aimed = driver._aimed
        self.stops = driver._stops
        self._in_doubt = driver.stale_frames.in_doubt
        self._states = dict(driver.stale_frames.states)
        self._skips = driver.stale_frames.skips()

    def steps(self, requests: Requests) -> list[Step]:
        """Return the commands for captures of ``requests``."""
        for request, following in zip(requests, [*requests[1:], None], strict=True):
            if self._in_doubt or self._aimed != request.view or self._must_expose(request):
                self._add_move(request)
            self._add_picture("keep", request)
            self._states[request.mode] = _sight(request)
            position = request.view.key().position
            if following is None or following.view.key().position != position:
                command = f"vget /camera/{self._driver.camera}/location"
                self._steps.append(Step(command, "where", request))
        return self._steps

    def _must_expose(self, request: Request) -> bool:
        return self.stops != _stops_of(request, self.stops)

    def _add_move(self, request: Request) -> None:
        """Add the move to a request, after a reference of what is seen before it, unless that is known."""
        if self._driver.one_tick:
            self._set(request)
            return
        before = self._before(request)
        is_known = not self._in_doubt and self._states.get(request.mode) == _sight(before)
        if _sight(before) != _sight(request) and not is_known:
            self._set(before)
            self._add_picture("skip", before, SETTLED if self._in_doubt else 0)
            self._add_picture("reference", before)
        self._set(request)
        warmup = self._driver._options.warmup if request.mode == "lit" else 0
        self._add_picture("skip", request, max(self._skips, warmup))
        self._skips = self._driver.stale_frames.lag

    def _before(self, request: Request) -> Request:
        """Return the request with the camera as it is; itself if that is not known."""
        if self._aimed is None:
            return request
        view = replace(request.view, pose=self._aimed.pose)
        return replace(request, view=view, stops=self.stops if request.mode == "lit" else None)

    def _set(self, request: Request) -> None:
        """Add the commands that aim and expose the camera for a request."""
        stops = _stops_of(request, self.stops)
        commands = self._driver.aim(self._aimed, request.view)
        commands += self._driver._change_stops(self.stops, stops)
        for command in commands:
            self._steps.append(Step(command, "check"))
        self._aimed = request.view
        self.stops = stops

    def _add_picture(
        self, use: Literal["skip", "reference", "keep"], request: Request, count: int = 1
    ) -> None:
        command = self._driver.table.image(self._driver.camera, request.mode)
        self._steps.extend([Step(command, use, request)] * count)


def _check_as_before(chosen: Exposure, before: Exposure | None) -> None:
    """Raise ArgumentError for another exposure than the one that a recording's colours have."""
    if before is None or _in_words(before) == _in_words(chosen):
        return
    expected = f"expected {_in_words(before)}, as recorded before, got {_in_words(chosen)}"
    advice = "leave exposure out to go on with it, or record into another file"
    raise ArgumentError(f"exposure: {expected}; {advice}")


def _in_words(exposure: Exposure) -> str:
    return "the game's own" if exposure == "game" else f"a bias of {exposure:g}"


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
