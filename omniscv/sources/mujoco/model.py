"""A MuJoCo model at an instant: what is placed, hidden and drawn; its objects, their boxes, and rays."""

import itertools
import math
import threading
from collections.abc import Collection, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import one_of, shown
from omniscv.errors import ArgumentError
from omniscv.geometry import Array, Pose
from omniscv.geometry.instant import Instant
from omniscv.geometry.scene_geometry import ObjectBox
from omniscv.sources.base import Traced, View
from omniscv.sources.mujoco.drawn import (
    HIDDEN,
    SOFT,
    Planes,
    check_finite,
    met_opacity,
    opacity,
    soft_objects,
)
from omniscv.sources.mujoco.renderer import FAR_M, Renderer
from omniscv.sources.mujoco.settings import Settings, read_qpos

LIGHT = {"diffuse": 3, "ambient": 3, "specular": 3, "pos": 3, "dir": 3, "active": 1}
MATERIAL = {"rgba": 3, "emission": 1, "specular": 1, "shininess": 1, "reflectance": 1}
"""What draws may set of lights and materials, and how many numbers each has: names of MuJoCo's arrays."""
_CHANGED = (
    *("geom_rgba", "geom_matid", "geom_pos", "geom_quat", "geom_sameframe"),
    *("body_pos", "body_quat", "bvh_aabb"),
    *(f"light_{key}" for key in LIGHT),
    *(f"mat_{key}" for key in MATERIAL),
    *(f"{kind}_group" for kind in SOFT),
)
"""Arrays of the model that instants change."""
_GROUPS = 6
_MOST_OBJECTS = 0xFFFF
_ENDLESS_M = 1e10
_FAR_EXTENTS = 200
"""Farther than as many sizes of the model nothing is drawn or met, if that is more than :data:`FAR_M`."""
_DIVERGING = ("BADQPOS", "BADQVEL", "BADQACC")
"""MuJoCo's warnings of physics that are no longer finite."""
_CORNERS = np.array(list(itertools.product((-1, 1), repeat=3)))
_ANYWHERE = np.array([0, 0, 0, 1e6, 1e6, 1e6])  # centre and half size of a box that holds every scene


class Handle(NamedTuple):
    """What an object is: ``kind`` is ``body``, ``geom`` or one of :data:`SOFT`, ``number`` its index in the
    model."""

    kind: str
    number: int


class Model:
    """A model and its state. :attr:`lock` is held while one instant is shown and read.

    ``model`` is an ``MjModel``, ``data`` an ``MjData`` with the state in which the world starts; both belong
    to this object. Raises ArgumentError for a keyframe or ``qpos`` that the model does not have, or too many
    objects.
    """

    def __init__(self, model: Any, data: Any, settings: Settings) -> None:
        import mujoco

        self.mujoco = mujoco
        self.m = model
        self.d = data
        self.settings = settings
        self.lock = threading.RLock()
        self.closed = threading.Event()
        self._track: Array | None = None
        self._start()
        check_finite(mujoco, model, data)
        self._window_px = (int(model.vis.global_.offwidth), int(model.vis.global_.offheight))
        self.far_m = max(FAR_M, _FAR_EXTENTS * float(model.stat.extent))
        self.planes = Planes.of(mujoco, model)
        self._name_objects()
        self._label()
        self._unchanged = {name: getattr(model, name).copy() for name in _CHANGED}
        self._shown: tuple[Any, ...] | None = None
        self._walked = (0, self.begin)  # steps of physics, and the state after them

    def _name_objects(self) -> None:
        """Find the objects, their geoms, and which of them are shown; ArgumentError for too many."""
        model = self.m
        visible = opacity(model) > 0
        # Rays pass invisible geoms, too:
        model.geom_matid[~visible] = -1
        model.geom_rgba[~visible, 3] = 0
        self._passed = np.flatnonzero(visible & (met_opacity(model) == 0))
        self.handles, self._object_of = _objects(self.mujoco, model, self.settings.by)
        self.groups = np.array([str(group) in self.settings.groups for group in range(_GROUPS)], np.uint8)
        names = list(self.handles)
        drawn = (self.groups[model.geom_group] > 0) & visible
        shown_names = {names[i] for i in self._object_of[drawn]}
        self.soft = self._soft_handles(shown_names) if self.settings.data == "raster" else {}
        self.ids: dict[str, int] = {}
        for label, name in enumerate(sorted({*shown_names, *self.soft}), start=1):
            self.ids[name] = label
        if len(self.ids) > _MOST_OBJECTS:
            actual = f"{len(self.ids)}; use body"
            raise ArgumentError(f"by: expected at most {_MOST_OBJECTS} objects, got {actual}")

    def _label(self) -> None:
        """Set the label of all that is drawn: of geoms, then of each kind that only the renderer shows."""
        names = list(self.handles)
        labels = [self.ids.get(names[i], 0) for i in self._object_of]
        self.first_of = {"geom": 0}  # index of the first of a kind among all that is drawn
        for kind in SOFT:
            self.first_of[kind] = len(labels)
            labels += [0] * getattr(self.m, f"n{kind}")
        for name, handle in self.soft.items():
            labels[self.first_of[handle.kind] + handle.number] = self.ids[name]
        self.label_of = np.array([*labels, 0], np.uint16)  # the last one of nothing

    def _soft_handles(self, taken: Collection[str]) -> dict[str, Handle]:
        """Return by name what only the renderer shows; names of other objects get the kind behind them."""
        handles: dict[str, Handle] = {}
        for kind, number, name in soft_objects(self.mujoco, self.m):
            is_unique = name not in taken and name not in handles
            handles[name if is_unique else f"{name} ({kind} {number})"] = Handle(kind, number)
        return handles

    def _start(self) -> None:
        """Bring the data to the keyframe and ``qpos`` of the settings."""
        keyframe = self.settings.keyframe
        qpos = read_qpos(self.settings.qpos, self.m.nq)
        if keyframe is not None:
            kind = self.mujoco.mjtObj.mjOBJ_KEY
            name = str(keyframe)
            key = int(name) if name.isdigit() else self.mujoco.mj_name2id(self.m, kind, name)
            if not 0 <= key < self.m.nkey:
                known = [self.m.key(i).name or str(i) for i in range(self.m.nkey)]
                expected = f"expected one of the model's: {', '.join(known) or 'none'}"
                raise ArgumentError(f"keyframe: {expected}; got {shown(keyframe)}")
            self.mujoco.mj_resetDataKeyframe(self.m, self.d, key)
        if qpos is not None and qpos.ndim == 2:
            self._track = qpos
            self.d.qpos[:] = qpos[0, 1:]
        elif qpos is not None:
            self.d.qpos[:] = qpos
        self.mujoco.mj_forward(self.m, self.d)
        self.begin = self.state_of(self.d)

    def state_of(self, data: Any) -> Array:
        """Return the numbers of a state that physics continues from."""
        kind = self.mujoco.mjtState.mjSTATE_INTEGRATION
        state = np.empty(self.mujoco.mj_stateSize(self.m, kind))
        self.mujoco.mj_getState(self.m, data, state, kind)
        return state

    @cached_property
    def renderer(self) -> Renderer:
        """The one of all instants, made when the first picture is rendered."""
        return Renderer(self)

    def close(self) -> None:
        with self.lock:
            if not self.closed.is_set() and "renderer" in vars(self):
                self.renderer.close()
            self.closed.set()

    # -- the world at an instant --------------------------------------------------------------------------

    @property
    def shown(self) -> object:
        """What identifies the state that is shown; None while it is not known."""
        return self._shown

    def show(
        self, begin: Array, hidden: Collection[str], instant: Instant, poses: Mapping[str, Pose]
    ) -> None:
        """Bring the world to an instant; nothing is done where it is shown already.

        Args:
            begin: the state at time 0, as :meth:`state_of` returns it.
            hidden: the objects that are left out.
            instant: its time, and what was drawn of lights and materials.
            poses: of the objects that are moved.
        """
        key = (begin.tobytes(), frozenset(hidden), instant.state, frozenset(poses))
        if key == self._shown:
            return
        self._shown = None  # until all is done
        for name, values in self._unchanged.items():
            getattr(self.m, name)[...] = values
        time = instant.time
        if time is None and begin is self.begin:  # a state that was given is shown as it is
            time = self.settings.time
        self._advance(begin, time)
        # MuJoCo looks for what many rays meet only in boxes around the geoms of each body that collide.
        self.m.bvh_aabb[self.m.body_bvhadr[self.m.body_bvhadr >= 0]] = _ANYWHERE
        for name in sorted(poses, key=self._tree_depth):
            self._place(self.handles[name], poses[name])
            self._compute()
        self._hide(hidden)
        for name, values in instant.varied.get("lights", {}).items():
            self._set("light", self.lights()[name], values, LIGHT)
        for name, values in instant.varied.get("materials", {}).items():
            self._set("mat", self.m.material(name).id, values, MATERIAL)
        self._compute()
        self._shown = key

    def _hide(self, objects: Collection[str]) -> None:
        """Let rays and the renderer pass through some objects."""
        names = list(self.handles)
        is_hidden = np.array([names[i] in objects for i in self._object_of], np.bool_)
        self.m.geom_matid[is_hidden] = -1
        self.m.geom_rgba[is_hidden, 3] = 0
        for name in objects:
            if name in self.soft:
                kind, number = self.soft[name]
                getattr(self.m, f"{kind}_group")[number] = HIDDEN

    def lights(self) -> dict[str, int]:
        """Return the number of each light by its name."""
        numbers = {}
        for i in range(self.m.nlight):
            numbers[self.m.light(i).name or f"light {i}"] = i
        return numbers

    def materials(self) -> list[str]:
        """Return the names of the materials."""
        return [self.m.material(i).name for i in range(self.m.nmat)]

    def _set(self, kind: str, index: int, values: Mapping[str, Any], known: Mapping[str, int]) -> None:
        for key, value in values.items():
            one_of(kind, key, known)
            array = getattr(self.m, f"{kind}_{key}")
            if array.ndim > 1:
                array[index, : known[key]] = value
            else:
                array[index] = np.ravel(value)[0]

    def _compute(self) -> None:
        """Compute where everything is, without a step in time."""
        for step in ("mj_kinematics", "mj_comPos", "mj_camlight", "mj_flex", "mj_tendon"):
            getattr(self.mujoco, step)(self.m, self.d)

    def _advance(self, begin: Array, time: float | None) -> None:
        """Bring the data to a time: by steps of physics, or along a trajectory of ``qpos``."""
        seconds = 0.0 if time is None else time
        kind = self.mujoco.mjtState.mjSTATE_INTEGRATION
        if self._track is not None and begin is not self.begin:
            if time is not None:
                expected = "expected none in a state that was given, of a source with a trajectory of qpos"
                raise ArgumentError(f"time: {expected}, got {time:g}")
            self.mujoco.mj_setState(self.m, self.d, begin, kind)
        elif self._track is not None:
            self.mujoco.mj_setState(self.m, self.d, begin, kind)
            self.d.qpos[:] = self._on_track(self._track, seconds)
        else:
            step = round(seconds / self.m.opt.timestep)
            if step < 0:
                raise ArgumentError(f"time: expected seconds of at least 0, got {seconds:g}")
            same = self._walked[0] <= step and self._walked_from is begin
            done, state = self._walked if same else (0, begin)
            self.mujoco.mj_setState(self.m, self.d, state, kind)
            self._walk(step - done)
            self._walked = (step, self.state_of(self.d))
            self._walked_from = begin
        self._compute()

    _walked_from: Array | None = None

    def _walk(self, steps: int) -> None:
        """Simulate steps of physics; ArgumentError where they diverge: MuJoCo begins anew then."""
        warnings = []
        for name in _DIVERGING:
            warning = self.d.warning[getattr(self.mujoco.mjtWarning, f"mjWARN_{name}")]
            warning.number = 0
            warnings.append(warning)
        for _ in range(steps):
            time = self.d.time
            self.mujoco.mj_step(self.m, self.d)
            if any(warning.number for warning in warnings):
                expected = "expected a model whose physics stay finite, got none after"
                raise ArgumentError(f"time: {expected} {time:.6g} s; give it a smaller timestep")

    def _on_track(self, track: Array, time: float) -> Array:
        """Return ``qpos`` at a time: turned and moved at constant rates from one row to the next."""
        times = track[:, 0]
        if not times[0] <= time <= times[-1]:
            span = f"{times[0]:g} to {times[-1]:g} s"
            raise ArgumentError(f"time: expected {span}, which the trajectory of qpos covers, got {time:g}")
        i = int(np.clip(np.searchsorted(times, time, "right") - 1, 0, max(0, len(times) - 2)))
        qpos = track[i, 1:].copy()
        if len(times) > 1:
            rates = np.empty(self.m.nv)
            span = times[i + 1] - times[i]
            self.mujoco.mj_differentiatePos(self.m, rates, span, track[i, 1:], track[i + 1, 1:])
            self.mujoco.mj_integratePos(self.m, qpos, rates, time - times[i])
        return qpos

    def _tree_depth(self, name: str) -> int:
        """Return how deep an object lies in the tree of bodies: those that carry others are placed first."""
        kind, index = self.handles[name]
        body = index if kind == "body" else self.m.geom_bodyid[index]
        depth = 0
        while body:
            body = self.m.body_parentid[body]
            depth += 1
        return 2 * depth + (kind == "geom")

    def _place(self, handle: Handle, pose: Pose) -> None:  # noqa: PLR0915 - every kind of geom in one place
        """Move a body, with all that hangs on it, or a geom."""
        m = self.m
        d = self.d
        i = handle.number
        free = self.mujoco.mjtJoint.mjJNT_FREE
        if handle.kind == "geom":
            body = m.geom_bodyid[i]
            local = np.linalg.inv(_matrix(d.xpos[body], d.xmat[body])) @ _matrix(pose.position, pose.rotation)
            m.geom_pos[i] = local[:3, 3]
            m.geom_quat[i] = self._quaternion(local)
            m.geom_sameframe[i] = 0
            return
        joints = range(m.body_jntadr[i], m.body_jntadr[i] + m.body_jntnum[i])
        free_joints = [joint for joint in joints if m.jnt_type[joint] == free]
        mocap = m.body_mocapid[i]
        target = _matrix(pose.position, pose.rotation)
        if free_joints:
            at = m.jnt_qposadr[free_joints[0]]
            d.qpos[at : at + 3] = pose.position
            d.qpos[at + 3 : at + 7] = self._quaternion(target)
        elif mocap >= 0:
            d.mocap_pos[mocap] = pose.position
            d.mocap_quat[mocap] = self._quaternion(target)
        else:  # its frame in its parent, such that the joints as they are give the pose
            parent = m.body_parentid[i]
            T_w_p = _matrix(d.xpos[parent], d.xmat[parent])
            T_w_i = _matrix(d.xpos[i], d.xmat[i])
            R = np.empty(9)
            self.mujoco.mju_quat2Mat(R, m.body_quat[i])
            frame = np.linalg.inv(T_w_p) @ target @ np.linalg.inv(T_w_i) @ T_w_p @ _matrix(m.body_pos[i], R)
            m.body_pos[i] = frame[:3, 3]
            m.body_quat[i] = self._quaternion(frame)

    def _quaternion(self, matrix: Array) -> Array:
        q = np.empty(4)
        self.mujoco.mju_mat2Quat(q, np.ascontiguousarray(matrix[:3, :3]).ravel())
        return q

    # -- what is known of it ------------------------------------------------------------------------------

    def pose(self, name: str) -> Pose:
        """Return where an object is: its frame's position, and ``R_w_o``."""
        kind, i = self.handles[name]
        if kind == "body":
            position = self.d.xpos[i]
            rotation = self.d.xmat[i]
        else:
            position = self.d.geom_xpos[i]
            rotation = self.d.geom_xmat[i]
        return Pose(position.copy(), _orthonormal(rotation.reshape(3, 3)))

    def own_views(self) -> dict[str, View]:
        """Return the views of the model's cameras by name, where they are now: perspective ones whose optical
        axis is in the middle."""
        views = {}
        for i in range(self.m.ncam):
            name = self.m.camera(i).name or f"camera {i}"
            orthographic = getattr(self.m, "cam_projection", getattr(self.m, "cam_orthographic", None))
            if (orthographic is not None and orthographic[i]) or self.m.cam_intrinsic[i, 2:].any():
                continue
            width, height = map(int, self.m.cam_resolution[i])
            if width * height <= 1:  # not given
                width, height = self._window_px
            across = math.tan(math.radians(self.m.cam_fovy[i]) / 2) * width / height
            if self.m.cam_sensorsize[i, 0]:
                across = self.m.cam_sensorsize[i, 0] / 2 / self.m.cam_intrinsic[i, 0]
            R_w_c = _orthonormal(self.d.cam_xmat[i].reshape(3, 3) * (1, -1, -1))  # MuJoCo: y up, z back
            fov_deg = math.degrees(2 * math.atan(across))
            views[name] = View(Pose(self.d.cam_xpos[i].copy(), R_w_c), fov_deg, width, height)
        return views

    def movable(self) -> list[str]:
        """Return the names of the objects that physics moves."""
        movable = []
        for name, (kind, index) in self.handles.items():
            body = index if kind == "body" else self.m.geom_bodyid[index]
            if self.m.body_weldid[body] and name in self.ids:
                movable.append(name)
        return movable

    def box(self, name: str) -> ObjectBox | None:
        """Return the box around an object's geoms, in its own axes; None around a plane, which has no end."""
        names = list(self.handles)
        frame = self.pose(name)
        of_object = self._object_of == names.index(name)
        geoms = np.flatnonzero(of_object & (self.m.geom_type > int(self.mujoco.mjtGeom.mjGEOM_PLANE)))
        if not len(geoms) or of_object.sum() > len(geoms):
            return None
        middles = self.m.geom_aabb[geoms, None, :3]
        halves = self.m.geom_aabb[geoms, None, 3:]
        R_w_g = self.d.geom_xmat[geoms].reshape(-1, 1, 3, 3)
        corners = ((middles + _CORNERS * halves)[..., None, :] @ np.swapaxes(R_w_g, -1, -2))[..., 0, :]
        along = (corners + self.d.geom_xpos[geoms, None] - frame.position).reshape(-1, 3) @ frame.rotation
        low = along.min(axis=0)
        high = along.max(axis=0)
        center = frame.position + frame.rotation @ ((low + high) / 2)
        return ObjectBox.of(center, frame.rotation.T, high - low, "vertices")

    def trace(self, origins_w: Array, directions_w: Array) -> Traced:
        """Return what rays meet: see :meth:`omniscv.sources.Source.trace`.

        ``origins_w`` are (..., 3) metres, or (3,) of all rays; ``directions_w`` (..., 3) unit vectors.
        """
        shape = directions_w.shape[:-1]
        rays = np.ascontiguousarray(directions_w.reshape(-1, 3), np.float64)
        geom = np.full(len(rays), -1, np.int32)
        distance = np.full(len(rays), -1.0)
        normal = np.zeros((len(rays), 3))
        used = np.flatnonzero(np.isfinite(rays).all(axis=1))  # a ray with NaN meets nothing
        points = np.reshape(origins_w, (-1, 3))
        point_of = np.zeros(len(used), np.int64)
        if np.ndim(origins_w) > 1:
            points, point_of = np.unique(points[used], axis=0, return_inverse=True)
        order = np.argsort(point_of.ravel(), kind="stable")
        ends = np.cumsum(np.bincount(point_of.ravel(), minlength=len(points)))[:-1]
        with self._without(self._passed, met=True):
            for point, rows in zip(points, np.split(used[order], ends), strict=False):
                geom[rows], distance[rows], normal[rows] = self._meet(point, rays[rows])
        geom[distance > self.far_m] = -1
        nothing = (geom < 0) | (distance < 0)
        distance[nothing] = np.inf
        normal[nothing] = 0
        label = self.label_of[np.where(geom < 0, -1, geom)]
        normal[np.einsum("ij,ij->i", normal, rays) > 0] *= -1  # towards the ray, also from inside
        return Traced(distance.reshape(shape), label.reshape(shape), normal.reshape(*shape, 3))

    def _meet(self, point: Array, rays: Array) -> tuple[NDArray[np.int32], Array, Array]:
        """Return the geoms, -1 for none, distances and normals that rays (N, 3) from one point meet."""
        count = len(rays)
        geom = np.full(count, -1, np.int32)
        distance = np.full(count, -1.0)
        normal = np.zeros(3 * count)
        aimed = np.ascontiguousarray(rays).ravel()
        results = (geom, distance, normal)
        self.mujoco.mj_multiRay(self.m, self.d, point, aimed, self.groups, 1, -1, *results, count, _ENDLESS_M)
        normals = normal.reshape(-1, 3)
        for plane in self.planes.endless:
            met = np.flatnonzero(geom == self.planes.geoms[plane])
            ends_w = point + distance[met, None] * rays[met]
            beyond = met[self.planes.beyond(self.d, plane, point, ends_w)]
            if len(beyond):  # they go on behind it
                with self._without(self.planes.geoms[plane : plane + 1]):
                    geom[beyond], distance[beyond], normals[beyond] = self._meet(point, rays[beyond])
        return geom, distance, normals

    @contextmanager
    def _without(self, geoms: NDArray[np.int64], met: bool = False) -> Iterator[None]:
        """Hide geoms from rays and the renderer; or let rays meet what they pass for its material."""
        materials = self.m.geom_matid[geoms].copy()
        opacities = self.m.geom_rgba[geoms, 3].copy()
        self.m.geom_matid[geoms] = -1
        if not met:
            self.m.geom_rgba[geoms, 3] = 0
        try:
            yield
        finally:
            self.m.geom_matid[geoms] = materials
            self.m.geom_rgba[geoms, 3] = opacities

    def seen_from(self, center_w: Array) -> AbstractContextManager[None]:
        """Return a context in which planes that an optical centre sees from behind are hidden."""
        return self._without(self.planes.seen_from_behind(self.d, center_w))


def _objects(mujoco: Any, m: Any, by: str) -> tuple[dict[str, Handle], NDArray[np.int64]]:
    """Return objects by name, and (ngeom,) the object of each geom; of the world itself each geom is one."""
    handles: dict[str, Handle] = {}
    index_of: dict[Handle, int] = {}
    object_of = []
    for geom in range(m.ngeom):
        body = int(m.geom_bodyid[geom])
        handle = Handle("geom", geom) if by == "geom" or body == 0 else Handle("body", body)
        if handle not in index_of:
            form = mujoco.mjtGeom(m.geom_type[geom]).name.removeprefix("mjGEOM_").lower()
            name = m.body(body).name or f"body {body}"
            if handle.kind == "geom":
                name = m.geom(geom).name or f"{name}/{form}{geom - m.body_geomadr[body]}"
            if name in handles:
                name = f"{name} ({handle.kind} {handle.number})"
            index_of[handle] = len(handles)
            handles[name] = handle
        object_of.append(index_of[handle])
    return handles, np.array(object_of, np.int64)


def _matrix(position: Any, rotation: Any) -> Array:
    """Return (4, 4) the transformation of a frame at a position (3,) with a rotation (3, 3)."""
    T = np.eye(4)
    T[:3, 3] = position
    T[:3, :3] = np.reshape(rotation, (3, 3))
    return T


def _orthonormal(rotation: Array) -> Array:
    """Return the rotation matrix that is nearest to (3, 3), whose last digits are off."""
    u, _, v = np.linalg.svd(rotation)
    return np.asarray(u @ v)
