"""What sources share that render one scene at any instant: Blender's and MuJoCo's."""

from abc import abstractmethod
from collections.abc import Iterable, Mapping
from types import MappingProxyType

from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.instant import Instant
from omniscv.sources.base import (
    ObjectTable,
    Request,
    SceneIdentity,
    Source,
    SourceView,
    copy_with,
    known_objects,
)


class Rendered(Source):
    """A source that renders one scene at any instant, and without any objects; several may be used at once.

    Subclasses set ``_name`` for messages, ``_identity`` and ``_objects``, and have ``_check_open``.
    """

    _name: str
    _identity: SceneIdentity
    _objects: ObjectTable
    _hidden = frozenset[str]()
    _instant = Instant()
    _moved: Mapping[str, Pose] = MappingProxyType({})

    @abstractmethod
    def _check_open(self) -> None:
        """Raise :func:`closed_error` if it is closed."""

    @property
    def scene_identity(self) -> SceneIdentity:
        return self._identity

    @property
    def instant(self) -> Instant:
        return self._instant

    def objects(self) -> ObjectTable:
        self._check_open()
        return self._objects

    def without(self, objects: Iterable[str]) -> Source:
        self._check_open()
        hidden = self._hidden.union(objects)
        known_objects(hidden, self._objects.ids, self._name)
        return SourceView(copy_with(self, _hidden=hidden))

    def at(self, instant: Instant) -> Source:
        self._check_open()
        named = {*instant.hidden, *instant.poses, *instant.varied.get("objects", {})}
        known_objects(named, self._objects.ids, self._name)
        drawn, undrawn = instant.placed(self.poses)
        hidden = self._hidden.union(instant.hidden, undrawn)
        moved = {**instant.poses, **drawn}
        return SourceView(copy_with(self, _hidden=hidden, _instant=instant, _moved=moved))

    def _check(self, request: Request) -> None:
        """Raise ArgumentError for a request of another state, or of a modality that is not rendered."""
        request.check_state(self.state, self._name)
        modes = self.capabilities.modes
        if request.mode not in modes:
            known = f"expected one of {', '.join(sorted(modes))} of {self.capabilities.dialect}"
            raise ArgumentError(f"mode: {known}, got {request.mode!r}")
