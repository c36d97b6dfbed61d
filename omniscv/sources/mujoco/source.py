"""Captures of a MuJoCo model; several instants of it share one renderer, and take turns."""

from __future__ import annotations

import copy
import hashlib
import io
import os
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import one_of, shown
from omniscv.errors import ArgumentError, SourceError
from omniscv.geometry import Array, Pose
from omniscv.geometry.instant import Instant
from omniscv.geometry.scene_geometry import SceneGeometry
from omniscv.records import read
from omniscv.sources import codecs
from omniscv.sources.base import (
    STATIC_SETTINGS,
    Capabilities,
    Capture,
    ObjectTable,
    ProcessBound,
    Request,
    SceneIdentity,
    Source,
    SourceView,
    Traced,
    View,
    closed_error,
    copy_with,
)
from omniscv.sources.mujoco.drawn import check_state
from omniscv.sources.mujoco.model import LIGHT, MATERIAL, Model
from omniscv.sources.mujoco.renderer import needs_egl, raster_error
from omniscv.sources.mujoco.settings import Settings
from omniscv.sources.registry import split_address
from omniscv.sources.rendered import Rendered

if TYPE_CHECKING:
    from mujoco import MjData, MjModel

CAPABILITIES = Capabilities(
    frozenset(("lit", "object_mask", "depth", "normals")),
    dialect="mujoco",
    near_m=0.001,
    varies=frozenset(("objects", "lights", "materials")),
    traces=True,
)
_RASTER = replace(CAPABILITIES, modes=CAPABILITIES.modes - {"normals"}, traces=False)


class MujocoSource(Rendered):
    """Captures of one model. Threads take turns, one picture at a time.

    ``model`` has the state that is shown at first, and belongs to this source. Raises ArgumentError for one
    that cannot be shown with its settings.
    """

    def __init__(self, model: Model, identity: SceneIdentity) -> None:
        if model.settings.data == "rays" and (model.m.nskin or model.m.nflex):
            what = "skins" if model.m.nskin else "flexes"
            expected = f"expected a model whose rays meet all of it, got {what}; write data=raster"
            raise ArgumentError(f"{identity.name}: {expected}")
        self._model = model
        self._begin = model.begin
        self._identity = identity
        self._name = identity.name
        self._objects = ObjectTable({}, ids=model.ids)

    @property
    def capabilities(self) -> Capabilities:
        """Without normals and rays where data come from the renderer, without colours where it is off."""
        can = CAPABILITIES if self._settings.data == "rays" else _RASTER
        can = replace(can, traces=can.traces and self._settings.traces)
        if hasattr(self._model.mujoco, "GLContext") or needs_egl():
            return can
        return replace(can, modes=can.modes - {"lit"})

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        """As :meth:`Source.capture`; ids, depth and normals of a view are made once."""
        last: View | None = None
        data: dict[str, Any] = {}
        for request in requests:
            self._check(request)
            if request.mode == "lit":
                with self._shown() as model:
                    data["lit"] = _fixed(self._model.renderer.colors(request.view))
            elif request.view != last or request.mode not in data:
                with self._shown() as model:
                    make = self._by_rays if model.settings.data == "rays" else self._by_renderer
                    last = request.view
                    data = make(model, request.view)
            payload = data.get("bounded") if request.mode == "depth" else None
            encoding = None if payload is None else codecs.BOUNDED
            pixels = data[request.mode]
            yield Capture(request, request.view, pixels, self._provenance(), payload, encoding)

    def _by_rays(self, model: Model, view: View) -> dict[str, Any]:
        directions_w = view.directions_w()
        hits = model.trace(view.pose.position, directions_w)
        depth = hits.distance / view.ray_lengths()
        return {
            "object_mask": _fixed(hits.label),
            "depth": _fixed(depth.astype(np.float32)),
            "normals": _fixed(hits.normal.astype(np.float32)),
        }

    def _by_renderer(self, model: Model, view: View) -> dict[str, Any]:
        geom, depth = self._model.renderer.geoms_and_depth(view)
        error = raster_error(model, geom, depth, view)
        file = io.BytesIO()
        np.save(file, np.stack([depth, error], axis=-1).astype(np.float32))
        mask = model.label_of[geom]
        metres = depth.astype(np.float32)
        return {"object_mask": _fixed(mask), "depth": _fixed(metres), "bounded": file.getvalue()}

    def trace(self, origins_w: Array, directions_w: Array) -> Traced:
        """As :meth:`Source.trace`: from ``origins_w`` along ``directions_w``; not with ``data=raster``."""
        if self._settings.data == "raster":
            return super().trace(origins_w, directions_w)
        with self._shown() as model:
            return model.trace(origins_w, directions_w)

    def geometry(self) -> SceneGeometry:
        """The boxes of all objects but planes, in their own axes."""
        boxes = {}
        with self._shown() as model:
            for name in model.ids:
                box = model.box(name) if name in model.handles else None
                if box is not None:
                    boxes[name] = box
        return SceneGeometry(boxes)

    def poses(self, objects: Collection[str] | None = None) -> Mapping[str, Pose]:
        with self._shown() as model:
            names = {*model.movable(), *self._moved} if objects is None else objects
            return {name: model.pose(name) for name in sorted(names) if name in model.handles}

    def own_poses(self, time_s: float) -> Mapping[str, Pose]:
        with self.at(Instant(time=time_s)) as there:
            return there.poses()

    def variable(self, kind: str) -> Mapping[str, Mapping[str, int]]:
        if kind == "lights":
            return dict.fromkeys(self._model.lights(), LIGHT)
        if kind == "materials":
            return dict.fromkeys(self._model.materials(), MATERIAL)
        settings = dict(super().variable(kind))
        for name in settings:
            if name in self._model.soft:
                settings[name] = STATIC_SETTINGS
        return settings

    def at(self, instant: Instant) -> Source:
        soft = self._model.soft
        if fixed := sorted(soft.keys() & {*instant.poses, *instant.varied.get("objects", {})}):
            drawn = instant.varied.get("objects", {}).get(fixed[0], {})
            if fixed[0] in instant.poses or drawn.keys() - STATIC_SETTINGS.keys():
                expected = "expected bodies and geoms, which can be moved"
                raise ArgumentError(f"{self._name}: {expected}, got {soft[fixed[0]].kind} {shown(fixed[0])}")
        return super().at(instant)

    def own_views(self) -> Mapping[str, View]:
        """Return the views of the model's own cameras. One on a body moves with it. Left out are orthographic
        cameras, and those whose optical axis is not in the middle."""
        with self._shown() as model:
            return model.own_views()

    def with_state(self, data: MjData) -> Source:
        """Return a source of the same model in the state of another ``MjData``, which is copied.

        The state is shown as it is, whatever the source's ``time`` and ``qpos``; :meth:`at` a time, physics
        goes on from it. Both may be used at the same time, as long as this source is open; the renderer is
        shared.
        """
        check_state(data)
        begin = self._model.state_of(data)
        name = f"state {hashlib.sha256(begin.tobytes()).hexdigest()[:16]}"
        return SourceView(copy_with(self, _begin=begin, _instant=Instant(name=name), _moved={}))

    def close(self) -> None:
        self._model.close()

    @property
    def _settings(self) -> Settings:
        return self._model.settings

    @contextmanager
    def _shown(self) -> Iterator[Model]:
        """Yield the model in this source's state; nobody else uses it meanwhile."""
        with self._model.lock:
            self._check_open()
            self._model.show(self._begin, self._hidden, self._instant, self._moved)
            yield self._model

    def _check_open(self) -> None:
        if self._model.closed.is_set():
            raise closed_error(self._identity.name)

    def _provenance(self) -> dict[str, Any]:
        server = f"MuJoCo {self._model.mujoco.__version__}"
        data = self._settings.data
        return {"server": server, "scene": self._name, "dialect": "mujoco", "data": data}


def from_model(
    model: MjModel, data: MjData | None = None, /, name: str = "model", **options: Any
) -> MujocoSource:
    """Return a source of a model of MuJoCo in the state that its data have; both are copied.

    Args:
        model, data: an ``MjModel``, and an ``MjData`` of it; its initial state if not given.
        name: of the scene, for recordings.
        options: the fields of :class:`omniscv.sources.mujoco.settings.Settings`; others are an ArgumentError.
    """
    mujoco = _mujoco(name)
    settings = read(Settings, options, "options")
    for key in ("keyframe", "qpos"):
        if data is not None and getattr(settings, key) is not None:
            given = shown(getattr(settings, key))
            raise ArgumentError(f"{key}: expected none beside data, whose state is shown, got {given}")
    model = copy.copy(model)
    data = mujoco.MjData(model) if data is None else copy.copy(data)
    size = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, size)
    appearance = asdict(settings)
    del appearance["traces"]  # no capture depends on it
    shown_as = repr(sorted(appearance.items())).encode()
    digest = hashlib.sha256(size.tobytes() + shown_as).hexdigest()[:16]
    return MujocoSource(Model(model, data, settings), SceneIdentity(name, content=digest))


def open_mujoco(address: str, **options: Any) -> Source:
    """Open ``mujoco://MODEL.xml?data=raster&by=geom``, a model of MuJoCo: MJCF, URDF or its binary form.

    Options, behind the question mark or by name, are :class:`omniscv.sources.mujoco.settings.Settings`.
    Raises ArgumentError for a wrong one, or a file that is no model, SourceError where MuJoCo is not
    installed.
    """
    readers = {"time": float, "numslices": int, "camera": str, **dict.fromkeys(_TEXTS, str)}
    path, written = split_address(address, readers)
    wanted = written.pop("camera", None)
    mujoco = _mujoco(address)
    try:
        if path.endswith(".mjb"):
            model = mujoco.MjModel.from_binary_path(path)
        else:
            model = mujoco.MjModel.from_xml_path(path)
    except (ValueError, OSError) as wrong:
        why = " ".join(str(wrong).split())
        raise ArgumentError(
            f"source: expected a model of MuJoCo in {shown(path)}, got: {why[:300]}"
        ) from wrong
    if twice := sorted(options.keys() & written.keys()):
        expected = f"expected it once, in the address or beside it, got {shown(written[twice[0]])} and"
        raise ArgumentError(f"{twice[0]}: {expected} {shown(options[twice[0]])}")
    try:
        source = from_model(model, None, Path(path).stem, **options, **written)
    except ArgumentError as wrong:
        raise ArgumentError(f"{path}: {wrong.message}") from wrong
    if wanted is not None:
        with source:
            raise _advice_on_camera(source.own_views(), path, wanted)
    return ProcessBound(source, address)


def _advice_on_camera(known: Mapping[str, View], path: str, name: str) -> ArgumentError:
    """Return the error of an address that names one of the model's cameras: what a job has in its place."""
    one_of(f"source: {path}: camera", name, known)
    view = known[name]
    yaw, pitch, roll = [round(angle, 9) + 0.0 for angle in view.pose.angles()]  # no negative zero
    position = ", ".join(f"{value:.6g}" for value in view.pose.position)
    pose = f"position: [{position}], yaw_deg: {yaw:.10g}, pitch_deg: {pitch:.10g}, roll_deg: {roll:.10g}"
    lens = f"model: pinhole, width: {view.width}, height: {view.height}, fov_deg: {view.fov_deg:.9g}"
    instead = f"write poses: [{{{pose}}}] and cameras: {{{name}: {{{lens}}}}}"
    moving = f"or, where it moves, no poses and cameras: {{{name}: {{model: pinhole, of: {name}}}}}"
    expected = f"expected no camera in the address, got {shown(name)}"
    return ArgumentError(f"source: {path}: {expected}; {instead}; {moving}")


_TEXTS = ("keyframe", "qpos", "groups", "by", "data", "headlight", "fog", "traces")


def _mujoco(what: str) -> Any:
    """Return the package; without a screen, it renders by EGL unless the environment says otherwise."""
    if "mujoco" not in sys.modules and needs_egl():
        os.environ.setdefault("MUJOCO_GL", "egl")
    try:
        import mujoco
    except ImportError as cause:
        raise SourceError(f"{what}: expected MuJoCo; install omniscv[mujoco]") from cause
    except AttributeError as cause:  # of its wrapper of OpenGL: the library that it is told to use is missing
        wanted = f"expected the library of MUJOCO_GL={os.environ.get('MUJOCO_GL', '')}"
        advice = "set it to egl, or to disabled for data alone"
        raise SourceError(f"{what}: {wanted}, which is not there; {advice}") from cause
    return mujoco


def _fixed(pixels: NDArray[Any]) -> NDArray[Any]:
    pixels.flags.writeable = False
    return pixels
