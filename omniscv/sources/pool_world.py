"""The worlds of several replicas as one."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager

from omniscv.geometry import Pose
from omniscv.geometry.scene_geometry import ObjectBox
from omniscv.sources.world import ExposureMethod, World


class PoolWorld(World):
    """Reads from the first world, and changes all of them.

    ``objects_changed`` is called where there may be other objects than before.
    """

    def __init__(self, worlds: Sequence[World], objects_changed: Callable[[], None]) -> None:
        self._worlds, self._objects_changed = tuple(worlds), objects_changed

    def objects(self) -> list[str]:
        return self._worlds[0].objects()

    def pose(self, name: str) -> Pose:
        return self._worlds[0].pose(name)

    def bounds(self, name: str) -> ObjectBox:
        return self._worlds[0].bounds(name)

    def move(self, name: str, pose: Pose) -> None:
        self._each(lambda world: world.move(name, pose))

    def show(self, name: str) -> None:
        self._each(lambda world: world.show(name))

    def hide(self, name: str) -> None:
        self._each(lambda world: world.hide(name))

    def spawn(self, kind: str, name: str, pose: Pose) -> None:
        self._each(lambda world: world.spawn(kind, name, pose))
        self._objects_changed()

    def destroy(self, name: str) -> None:
        self._each(lambda world: world.destroy(name))
        self._objects_changed()

    def pause(self) -> None:
        self._each(lambda world: world.pause())

    def resume(self) -> None:
        self._each(lambda world: world.resume())

    @property
    def paused(self) -> bool:
        """Whether the clocks of all stand."""
        return all(world.paused for world in self._worlds)

    def console(self, command: str) -> None:
        self._each(lambda world: world.console(command))

    def call(self, name: str, function: str, *arguments: object) -> str:
        first, *_ = [world.call(name, function, *arguments) for world in self._worlds]
        return first

    def light(
        self, name: str, pose: Pose, intensity: float, color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    ) -> None:
        self._each(lambda world: world.light(name, pose, intensity, color))

    def exposure(self, method: ExposureMethod, bias_ev: float | None = None) -> None:
        self._each(lambda world: world.exposure(method, bias_ev))

    @contextmanager
    def changes(self) -> Iterator[None]:
        with ExitStack() as all_of_them:
            all_of_them.callback(self._objects_changed)
            for world in self._worlds:
                all_of_them.enter_context(world.changes())
            yield

    def _each(self, change: Callable[[World], None]) -> None:
        for world in self._worlds:
            change(world)
