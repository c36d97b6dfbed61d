"""What was changed in a running world, which state that is, and how it is put back."""

from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from omniscv.errors import ServerRefusedError
from omniscv.geometry.instant import Instant

Key = tuple[str, str]
"""What was changed, such as ``pose``, and of which object."""


@dataclass(frozen=True)
class Undo:
    """How a change is put back.

    Attributes:
        commands: that set the values from before.
        run: what else to do.
    """

    commands: tuple[str, ...] = ()
    run: Callable[[], None] | None = None


_KNOWN = ("pose", "seen", "hidden", "left out", "time", "name")
"""What an instant has; poses were set, or seen; what is left out of captures is no part of a state."""

Layer = dict[Key, tuple[Any, Undo]]
"""By key, its value from before the layer's first change of it, and how that is put back."""


class Journal:
    """The values that were set, and layers of how to put them back.

    A layer is open from the beginning of some changes until they are put back.

    Attributes:
        instant: what is known of the world as it is now.
    """

    def __init__(self) -> None:
        self.instant = Instant()
        self.layers: list[Layer] = []
        self._values: dict[Key, Any] = {}

    def value(self, what: str, name: str = "") -> Any:
        """Return what was set; None for what was not changed."""
        return self._values.get((what, name))

    def named(self, what: str) -> list[tuple[str, Any]]:
        """Return the names of what was set, and the values."""
        return [(name, value) for (each, name), value in self._values.items() if each == what]

    def open(self) -> Layer:
        """Return a new layer, which takes in all changes from now on."""
        self.layers.append({})
        return self.layers[-1]

    def note(self, what: str, name: str, value: Any, undo: Undo | None = None) -> None:
        """Note a change, before it is made, so that it is put back however it ends.

        A value of None is the one from before any change; without ``undo`` it stays when layers are put back.
        """
        key = what, name
        if undo is not None:
            for layer in self.layers:
                layer.setdefault(key, (self._values.get(key), undo))
        self._set(key, value)

    @contextmanager
    def unless_refused(self) -> Iterator[None]:
        """A context in which changes are noted and made; forget them again if the server refuses them."""
        values, layers = dict(self._values), [dict(layer) for layer in self.layers]
        try:
            yield
        except ServerRefusedError:
            for layer, before in zip(self.layers, layers, strict=True):
                layer.clear()
                layer.update(before)
            self._values = values
            self.instant = _instant(values)
            raise

    def lose(self, kinds: Collection[str]) -> list[str]:
        """Forget what was changed in some ways, as it is so no more; return what that was."""
        lost = [key for key in self._values if key[0] in kinds]
        for key in lost:
            self._set(key, None)
            for layer in self.layers:
                layer.pop(key, None)
        return [" ".join(filter(None, key)) for key in lost]

    def forget(self, name: str) -> None:
        """Forget all about an object that is gone."""
        for key in [key for key in self._values if key[1] == name]:
            self._set(key, None)
        for layer in self.layers:
            for key in [key for key in layer if key[1] == name]:
                del layer[key]

    def undone(self, layer: Layer, key: Key) -> None:
        """Note that a layer's change was put back."""
        if key in layer:
            value, _ = layer.pop(key)
            self._set(key, value)

    def close(self, layer: Layer) -> None:
        """Remove a layer."""
        self.layers = [each for each in self.layers if each is not layer]

    def _set(self, key: Key, value: Any) -> None:
        if value is None:
            self._values.pop(key, None)
        else:
            self._values[key] = value
        self.instant = _instant(self._values)


def _instant(values: dict[Key, Any]) -> Instant:
    """Return the instant of values; what is no pose, hidden object or time becomes a part of its name."""
    known = [(kind, what, name) for kind in ("seen", "pose") for what, name in values]
    poses = {name: values[what, name] for kind, what, name in known if what == kind}
    hidden = frozenset(name for what, name in values if what == "hidden")
    parts = [values["name", ""]] if ("name", "") in values else []
    others = sorted(key for key in values if key[0] not in _KNOWN)
    parts += [f"{' '.join(filter(None, key))}: {values[key]}" for key in others]
    return Instant(MappingProxyType(poses), hidden, values.get(("time", "")), "; ".join(parts))
