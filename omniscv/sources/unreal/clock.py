"""Pauses a game: by commands that say what they do, or by the one of plugin 0.3.10, which toggles."""

from omniscv.arguments import shown
from omniscv.errors import BadReplyError, ServerRefusedError
from omniscv.sources.unreal.exchange import Exchange
from omniscv.sources.unreal.replies import numbers
from omniscv.sources.unreal.world_commands import IS_PAUSED, PAUSE, RESUME

_ROTATION = "vget /camera/0/rotation"
_READINGS = 5  # each is a tick later at least
_TURN = (0.0, -30.0, 0.0)


class Clock:
    """The clock of plugin 1.x."""

    def __init__(self, exchange: Exchange) -> None:
        self._exchange = exchange

    @property
    def paused(self) -> bool:
        """Whether the game stands still."""
        (reply,) = self._exchange.ask([IS_PAUSED])
        if reply not in ("true", "false"):
            where = self._exchange.connection.address
            raise BadReplyError(f"{where}: expected true or false from {IS_PAUSED!r}, got {shown(reply)}")
        return reply == "true"

    def set(self, paused: bool) -> None:
        """Pause the game, or let it run; ServerRefusedError if it does not."""
        if self.paused != paused:
            self._exchange.do([PAUSE if paused else RESUME])


class TogglingClock(Clock):
    """The clock of plugin 0.3.10: its one command pauses or resumes, and none reports which.

    While a game runs, every tick of its controller writes the player's angles anew, as 0 to 360 degrees; in
    a game that is paused a negative angle stays as it was set (protocol reference, section 4).
    """

    @property
    def paused(self) -> bool:
        before = self._rotation()
        try:
            self._turn(_TURN)
            return all(self._rotation()[1] < 0 for _ in range(_READINGS))
        finally:
            self._turn(before)
            self._exchange.driver.forget()

    def set(self, paused: bool) -> None:
        if self.paused == paused:
            return
        self._exchange.reply(PAUSE)  # sent once: repeated, it would do the contrary
        if self.paused != paused:
            where, what = self._exchange.connection.address, "stands still" if paused else "goes on"
            raise ServerRefusedError(f"{where}: expected a game that {what} after {PAUSE!r}, but it does not")

    def _rotation(self) -> tuple[float, ...]:
        return tuple(numbers(self._exchange.ask([_ROTATION])[0], 3))

    def _turn(self, rotation: tuple[float, ...]) -> None:
        self._exchange.do(["vset /camera/0/rotation {:.3f} {:.3f} {:.3f}".format(*rotation)])


def clock_of(exchange: Exchange, pause_toggles: bool) -> Clock:
    """Return the clock of a dialect."""
    return TogglingClock(exchange) if pause_toggles else Clock(exchange)
