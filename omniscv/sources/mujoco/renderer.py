"""MuJoCo's renderer, in a thread of its own: OpenGL contexts belong to the thread that made them."""

import os
import sys
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.errors import SourceError
from omniscv.geometry import Array
from omniscv.sources.base import View
from omniscv.sources.mujoco.drawn import GRID, SOFT, choose

NEAR_M = 0.001
FAR_M = 10_000.0
"""Of what is rendered, at least: the renderer's depth is a float of 32 bits that is 0 at the far end, so that
a near plane this near costs no digits."""
DEPTH_ERROR = 1.2e-6
"""Of the renderer's depth, relative: its buffer and its matrices are float32."""
POSITION_ERROR = 2.0**-23
"""Of vertices and cameras, relative to the coordinates: likewise."""
_OF_A_GRID = 8.0
"""How much more the corners of the cells of an infinite plane may be off, by measurement."""
_STEEPEST = 1e-3  # cosine of the angle between a ray and the normal below which it is not told from 0
_FIRST_PX = 256
_PER_WRAP = 64  # pieces in which a slack tendon is drawn, at most
_LIT = "lit"
_DATA = "data"
_no_opengl: list[str] = []
"""Why no context could be made in this process: MuJoCo hangs where it is tried once more."""


class Renderer:
    """Renders a model's pictures, colours with samples, data without; SourceError without OpenGL."""

    def __init__(self, model: Any) -> None:
        self._updated: tuple[Any, bytes] | None = None  # what the scene shows, and from where
        self._headlights: list[Any] = []
        self._model = model
        self._mujoco = model.mujoco
        self._thread = ThreadPoolExecutor(1, "mujoco-gl")
        try:
            self._thread.submit(self._open).result()
        except BaseException:
            self._thread.shutdown()
            raise

    def colors(self, view: View) -> NDArray[np.uint8]:
        """Return (H, W, 3) RGB."""
        rgb, _ = self._thread.submit(self._render, view, _LIT).result()
        return np.ascontiguousarray(rgb[::-1])

    def geoms_and_depth(self, view: View) -> tuple[NDArray[np.int32], Array]:
        """Return (H, W) what each pixel shows, and its planar depth, metres, +inf for nothing.

        It is the index of a geom, or of what else is drawn behind all geoms, as ``Model.label_of`` has them;
        -1 for nothing.
        """
        rgb, z = self._thread.submit(self._render, view, _DATA).result()
        shown_by = np.full(self._scene.ngeom + 1, -1, np.int32)
        first_of = self._model.first_of
        for item in self._scene.geoms[: self._scene.ngeom]:
            kind = self._kinds.get(item.objtype)
            if item.segid >= 0 and kind is not None:
                shown_by[item.segid + 1] = first_of[kind] + item.objid
        codes = rgb[::-1] @ np.array([1, 1 << 8, 1 << 16])
        near = np.float32(NEAR_M)
        far = np.float32(self._model.far_m)
        # The renderer's own matrix, in its float32: with exact numbers depth is off by 0.4 mm.
        shift = np.float32(-0.5) * (-(far + near) / (far - near)) - np.float32(0.5)
        scale = np.float32(-0.5) * (-(np.float32(2) * far * near) / (far - near))
        z = z[::-1].astype(np.float64)
        with np.errstate(divide="ignore"):
            return shown_by[codes], np.where(z > 0, scale / (z + shift), np.inf)

    def close(self) -> None:
        """Free the contexts, in their thread."""
        self._thread.submit(self._free).result()
        self._thread.shutdown()

    def _open(self) -> None:
        if not _no_opengl:
            try:
                self._make_contexts()
                return
            except Exception as cause:  # of the libraries behind it, each with errors of its own
                _no_opengl.append(" ".join(str(cause).split()) or type(cause).__name__)
        advice = "set MUJOCO_GL=egl, or osmesa where libosmesa6 is installed; data by rays need none"
        raise SourceError(f"mujoco: expected OpenGL to render with, got: {_no_opengl[0][:100]}; {advice}")

    def _make_contexts(self) -> None:
        mujoco = self._mujoco
        m = self._model.m
        self._context = opengl_context(mujoco)(_FIRST_PX, _FIRST_PX)
        self._context.make_current()
        m.vis.quality.numslices = self._model.settings.numslices
        m.vis.quality.numstacks = self._model.settings.numslices // 2
        m.vis.global_.offwidth = _FIRST_PX
        m.vis.global_.offheight = _FIRST_PX
        self._contexts: dict[str, Any] = {}
        self._context_of(_LIT)  # where OpenGL is too old, it says so here
        self._scene = mujoco.MjvScene(m, maxgeom=m.ngeom + m.nflex + m.nskin + _PER_WRAP * m.nwrap + 1000)
        self._option = mujoco.MjvOption()
        choose(mujoco, self._option, self._model.groups, self._model.settings.data)
        self._kinds: dict[int, str] = {}  # by MuJoCo's number of a type of object
        for kind in ("geom", *SOFT):
            self._kinds[int(getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}"))] = kind

    def _context_of(self, kind: str) -> Any:
        """Return the context of colours, which has samples, or of data, which has none."""
        if kind not in self._contexts:
            mujoco = self._mujoco
            m = self._model.m
            samples = m.vis.quality.offsamples
            if kind == _DATA:
                m.vis.quality.offsamples = 0
            try:
                context = mujoco.MjrContext(m, mujoco.mjtFontScale.mjFONTSCALE_50.value)
            finally:
                m.vis.quality.offsamples = samples
            context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
            self._contexts[kind] = context
        return self._contexts[kind]

    def _free(self) -> None:
        for context in self._contexts.values():
            context.free()
        self._context.free()

    def _render(self, view: View, kind: str) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Return (H, W, 3) bytes and (H, W) of the depth buffer, as OpenGL has them: the lowest row first.

        The depth of colours is not read: it is 0.
        """
        mujoco = self._mujoco
        context = self._context_of(kind)
        size = (view.width, view.height)
        if context.offWidth < size[0] or context.offHeight < size[1]:
            width = max(view.width, context.offWidth)
            height = max(view.height, context.offHeight)
            mujoco.mjr_resizeOffscreen(width, height, context)
        # Before every picture: after a change of size, ids are garbage without it.
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, context)
        self._update_scene(view.pose.position)
        self._aim(view)
        for light in self._headlights:
            light.dir = view.pose.R_w_c[:, 2]
        self._set_effects(kind == _LIT)
        rectangle = mujoco.MjrRect(0, 0, *size)
        rgb = np.empty((*size[::-1], 3), np.uint8)
        z = np.zeros(size[::-1], np.float32)
        mujoco.mjr_render(rectangle, self._scene, context)
        mujoco.mjr_readPixels(rgb, None if kind == _LIT else z, rectangle, context)
        return rgb, z

    def _update_scene(self, center_w: Array) -> None:
        """Bring the scene to the model's state, as seen from a centre; not again for its other views."""
        key = (self._model.shown, center_w.tobytes())
        if self._model.shown is not None and key == self._updated:
            return
        self._updated = None
        mujoco = self._mujoco
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        m = self._model.m
        d = self._model.d
        with self._model.seen_from(center_w):
            mujoco.mjv_updateScene(m, d, self._option, None, mujoco.MjvCamera(), everything, self._scene)
        self._place_planes(center_w)
        self._headlights = []
        for light in self._scene.lights[: self._scene.nlight]:
            if light.headlight:
                self._set_headlight(light, center_w)
                self._headlights.append(light)
        self._updated = key

    def _aim(self, view: View) -> None:
        R_w_c = view.pose.R_w_c
        p = view.projection
        for camera in (self._scene.camera[0], self._scene.camera[1]):  # the renderer takes their mean
            camera.pos = view.pose.position
            camera.forward = R_w_c[:, 2]
            camera.up = -R_w_c[:, 1]
            camera.frustum_near = NEAR_M
            camera.frustum_far = self._model.far_m
            camera.frustum_center = NEAR_M * (view.width / 2 - p.cx) / p.fx
            camera.frustum_width = NEAR_M * view.width / 2 / p.fx
            camera.frustum_top = NEAR_M * p.cy / p.fy
            camera.frustum_bottom = -NEAR_M * (view.height - p.cy) / p.fy

    def _place_planes(self, center_w: Array) -> None:
        """Draw infinite planes where rays meet them; MuJoCo places them by the view that was drawn before."""
        planes = self._model.planes
        plane_of = {int(planes.geoms[plane]): int(plane) for plane in planes.endless}  # by geom
        if not plane_of:
            return
        for item in self._scene.geoms[: self._scene.ngeom]:
            if item.objtype == self._mujoco.mjtObj.mjOBJ_GEOM and item.objid in plane_of:
                item.pos = planes.position_w(self._model.d, plane_of[item.objid], center_w)

    def _set_effects(self, is_lit: bool) -> None:
        flags = self._scene.flags
        names = self._mujoco.mjtRndFlag
        for name in (names.mjRND_SHADOW, names.mjRND_REFLECTION, names.mjRND_SKYBOX, names.mjRND_HAZE):
            flags[name] = is_lit
        flags[names.mjRND_FOG] = is_lit and self._model.settings.fog
        flags[names.mjRND_SEGMENT] = not is_lit
        flags[names.mjRND_IDCOLOR] = not is_lit
        flags[names.mjRND_CULL_FACE] = False  # rays meet both sides of a mesh

    def _set_headlight(self, light: Any, center_w: Array) -> None:
        """Make the lamp on the camera one on which all views of one optical centre agree."""
        mode = self._model.settings.headlight
        light.pos = center_w
        if mode == "camera":
            return
        light.headlight = 0
        if mode == "center":  # a spot as wide as can be: the renderer draws no light of type point
            light.type = self._mujoco.mjtLightType.mjLIGHT_SPOT
            light.cutoff = 180
            light.exponent = 0
            light.attenuation = (1, 0, 0)
            return
        if mode == "ambient":
            light.ambient = light.ambient + 0.5 * light.diffuse
        else:
            light.ambient = 0 * light.ambient
        light.diffuse = 0 * light.diffuse
        light.specular = 0 * light.specular


def needs_egl() -> bool:
    """Return whether colours are rendered without a screen, and nobody has said how."""
    has_screen = sys.platform != "linux" or bool(os.environ.get("DISPLAY"))
    return not has_screen and os.environ.get("MUJOCO_GL", "").strip().lower() in ("", "egl")


def opengl_context(mujoco: Any) -> Any:
    """Return the class of an OpenGL context.

    MuJoCo chooses one when it is imported: GLFW's, which needs a screen, unless ``MUJOCO_GL`` is set. A
    program that has imported it before gets EGL's nevertheless.
    """
    if needs_egl():
        from mujoco.egl import GLContext

        return GLContext
    return mujoco.GLContext


def raster_error(model: Any, geom: NDArray[np.int32], depth: Array, view: View) -> Array:
    """Return (H, W) how far the renderer's planar depth may be from the exact surface along the ray, metres.

    It is that of float32, and on what is round that of its facets: with N around and M from pole to pole they
    lie up to ``sag = r (1 - cos(pi / N) cos(pi / 2M))`` inside. A ray that meets the surface at an angle goes
    ``1.5 sag / cos`` farther, where it touches it at most the chord behind that depth.

    Args:
        model: a :class:`omniscv.sources.mujoco.model.Model`.
        geom: (H, W) what each pixel shows, as of :meth:`Renderer.geoms_and_depth`.
        depth: (H, W) planar, metres.
        view: what was rendered.
    """
    lengths = view.ray_lengths()
    is_surface = np.isfinite(depth)
    distance = np.where(is_surface, depth, 0.0) * lengths
    cos = np.maximum(_cosines(depth, lengths, view), _STEEPEST)
    size = np.abs(view.pose.position).max() + distance
    planes = model.planes
    cell_m = np.zeros(len(model.label_of))  # of the grid in which an infinite plane is drawn
    half_m = np.where(np.isfinite(planes.half_m), planes.half_m, 0.0)
    cell_m[planes.geoms] = half_m.max(axis=1, initial=0) / (GRID / 4)
    size = np.where(cell_m[geom] > 0, _OF_A_GRID * (size + cell_m[geom]), size)
    error = DEPTH_ERROR * distance + POSITION_ERROR * size / cos
    slices = model.settings.numslices
    radius_of = _radii(model, geom)
    sag_of = radius_of * (1 - np.cos(np.pi / slices) * np.cos(np.pi / (2 * (slices // 2))))
    sag = sag_of[geom]
    radius = radius_of[geom]
    error += np.minimum(1.5 * sag / cos, np.sqrt(2 * radius * sag) + sag)
    return np.where(is_surface, error, 0.0)


def _radii(model: Any, geom: NDArray[np.int32]) -> Array:
    """Return by index the radius of what pixels show and is round, metres; 0 of all else."""
    kinds = model.mujoco.mjtGeom
    size_count = {  # how many of a geom's sizes are radii
        int(kinds.mjGEOM_ELLIPSOID): 3,
        int(kinds.mjGEOM_SPHERE): 1,
        int(kinds.mjGEOM_CAPSULE): 1,
        int(kinds.mjGEOM_CYLINDER): 1,
    }
    radii = np.zeros(len(model.label_of))
    for kind, radii_of_kind in (("tendon", model.m.tendon_width), ("flex", model.m.flex_radius)):
        first = model.first_of[kind]
        radii[first : first + len(radii_of_kind)] = radii_of_kind
    for index in np.unique(geom[(geom >= 0) & (geom < model.m.ngeom)]):
        count = size_count.get(int(model.m.geom_type[index]), 0)
        radii[index] = model.m.geom_size[index, :count].max(initial=0)
    return radii


def _cosines(depth: Array, lengths: Array, view: View) -> Array:
    """(H, W) cosines between rays and normals, by the steepest neighbour: on a plane 1 / z is linear."""
    with np.errstate(divide="ignore"):
        w = np.where(np.isfinite(depth), 1 / depth, 0.0)
    projection = view.projection
    slopes = []
    for axis, focal in ((1, projection.fx), (0, projection.fy)):
        step = np.diff(w, axis=axis) * focal
        none = np.zeros_like(np.take(step, [0], axis))
        first = np.insert(step, 0, 0, axis=axis)
        last = np.append(step, none, axis)
        slopes.append(np.where(np.abs(first) > np.abs(last), first, last))
    x = (np.arange(view.width) + 0.5 - projection.cx) / projection.fx
    y = (np.arange(view.height)[:, None] + 0.5 - projection.cy) / projection.fy
    n = np.stack([slopes[0], slopes[1], w - x * slopes[0] - y * slopes[1]])
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.nan_to_num(w / (np.linalg.norm(n, axis=0) * lengths)))
