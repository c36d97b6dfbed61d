"""What MuJoCo's renderer draws of a model, and which of it rays meet and labels name.

So colours, labels and depth show one world.

:data:`FLAGS` says it of each of the renderer's switches (``mjtVisFlag``), :data:`PARTS` of what has none.
"""

from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from omniscv.errors import ArgumentError
from omniscv.geometry import Array

Shown = Literal["always", "raster", "never"]
"""When something is drawn; what is drawn has a label and a depth. ``raster``: where ids and depth come from
the renderer, too (``data=raster``)."""

FLAGS: dict[str, Shown] = {
    "CONVEXHULL": "never",  # rays meet the mesh itself
    "TEXTURE": "always",
    "JOINT": "never",
    "CAMERA": "never",
    "ACTUATOR": "never",
    "ACTIVATION": "never",
    "LIGHT": "never",
    "TENDON": "raster",
    "RANGEFINDER": "never",
    "CONSTRAINT": "never",
    "INERTIA": "never",
    "SCLINERTIA": "never",
    "PERTFORCE": "never",
    "PERTOBJ": "never",
    "CONTACTPOINT": "never",
    "ISLAND": "never",
    "CONTACTFORCE": "never",
    "CONTACTSPLIT": "never",
    "TRANSPARENT": "never",
    "AUTOCONNECT": "never",
    "COM": "never",
    "SELECT": "never",
    "STATIC": "always",  # geoms of bodies that do not move
    "SKIN": "raster",
    "FLEXVERT": "never",
    "FLEXEDGE": "raster",
    "FLEXFACE": "never",
    "FLEXSKIN": "raster",
    "BODYBVH": "never",
    "MESHBVH": "never",
    "SDFITER": "never",
}
"""By the name of the flag, without ``mjVIS_``. A model with skins or flexes needs ``raster``."""

PARTS: dict[str, Shown] = {
    "geoms": "always",  # of the groups that are shown, but for planes from behind
    "sites": "never",
    "frames": "never",
    "labels": "never",
}
"""What the renderer draws without a flag."""

SOFT = ("tendon", "flex", "skin")
"""Kinds of objects that only the renderer shows: the model's arrays begin with these words."""
HIDDEN = 5
"""The group in which they are hidden: MuJoCo draws transparent tendons in pictures of ids."""

GRID = 200  # cells of an infinite plane, each way: MuJoCo's mjMAXPLANEGRID
_BEYOND_FAR = 2.1  # of the far plane: how wide MuJoCo makes an infinite plane
_RGBA_OF_MATERIAL = np.array((0.5, 0.5, 0.5, 1.0), np.float32)
"""A geom of this colour, which is the default, has its material's in the renderer."""


def choose(mujoco: Any, option: Any, groups: NDArray[np.uint8], data: str) -> None:
    """Set what is drawn, as :data:`FLAGS` and :data:`PARTS` say.

    Args:
        mujoco: the package.
        option: an ``MjvOption``, which is changed.
        groups: (6,) of geoms, 1 for those that are shown.
        data: ``rays`` or ``raster``, as of the settings.
    """
    drawn = ("always", "raster") if data == "raster" else ("always",)
    option.flags[:] = 0
    for name, shown in FLAGS.items():
        flag = getattr(mujoco.mjtVisFlag, f"mjVIS_{name}", None)  # an older MuJoCo may lack it
        if flag is not None and shown in drawn:
            option.flags[flag] = 1
    option.geomgroup[:] = groups
    option.sitegroup[:] = 0
    option.frame = mujoco.mjtFrame.mjFRAME_NONE.value
    option.label = mujoco.mjtLabel.mjLABEL_NONE.value


def opacity(m: Any) -> Array:
    """Return (ngeom,) the opacity with which geoms are drawn: their own, or their material's."""
    own = m.geom_rgba[:, 3]
    if not m.nmat:
        return np.asarray(own)
    has_own = (m.geom_rgba != _RGBA_OF_MATERIAL).any(axis=1) | (m.geom_matid < 0)
    return np.asarray(np.where(has_own, own, m.mat_rgba[m.geom_matid, 3]))


def met_opacity(m: Any) -> Array:
    """Return (ngeom,) the opacity that rays ask for: the material's, where there is one. They pass what has
    none."""
    own = m.geom_rgba[:, 3]
    if not m.nmat:
        return np.asarray(own)
    return np.asarray(np.where(m.geom_matid >= 0, m.mat_rgba[m.geom_matid, 3], own))


def soft_objects(mujoco: Any, m: Any) -> list[tuple[str, int, str]]:
    """Return kind, number and name of what only the renderer shows of a model.

    These are spatial tendons, flexes and skins of the groups that a viewer shows. Transparent ones are put
    into a group that is not.

    Args:
        mujoco: the package.
        m: an ``MjModel``.
    """
    viewer = mujoco.MjvOption()
    objects = []
    for kind in SOFT:
        groups = getattr(m, f"{kind}_group")
        for i in range(len(groups)):
            if _soft_opacity(m, kind, i) == 0:
                groups[i] = HIDDEN
            is_drawn = kind != "tendon" or m.wrap_type[m.tendon_adr[i]] != mujoco.mjtWrap.mjWRAP_JOINT
            if is_drawn and getattr(viewer, f"{kind}group")[np.clip(groups[i], 0, HIDDEN)]:
                objects.append((kind, i, _name(mujoco, m, kind, i) or f"{kind} {i}"))
    return objects


def _name(mujoco: Any, m: Any, kind: str, i: int) -> str | None:
    name = mujoco.mj_id2name(m, getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), i)
    return None if name is None else str(name)


def _soft_opacity(m: Any, kind: str, i: int) -> float:
    material = getattr(m, f"{kind}_matid")[i]
    rgba = getattr(m, f"{kind}_rgba")[i]
    has_own = material < 0 or (rgba != _RGBA_OF_MATERIAL).any()
    return float(rgba[3] if has_own else m.mat_rgba[material, 3])


class Planes(NamedTuple):
    """The planes of a model. They are met and drawn from their front alone, and where they are infinite as
    far as the renderer draws them: a rectangle around the place of the optical centre in them.

    That place is rounded to half the rectangle, so that all views from one place, and from places beside it,
    have the same rectangle.

    Attributes:
        geoms: (P,) indices.
        half_m: (P, 2) metres from the middle of the rectangle to its edges; +inf along an axis that ends in
            the model.
        step_m: (P, 2) what its middle is a multiple of.
    """

    geoms: NDArray[np.int64]
    half_m: Array
    step_m: Array

    @classmethod
    def of(cls, mujoco: Any, m: Any) -> "Planes":
        """Return the planes of ``m``, an ``MjModel`` of the package ``mujoco``."""
        geoms = np.flatnonzero(m.geom_type == int(mujoco.mjtGeom.mjGEOM_PLANE))
        far_m = m.vis.map.zfar * m.stat.extent
        tile_m = np.full((len(geoms), 2), _BEYOND_FAR * far_m / (GRID - 2))
        material = m.geom_matid[geoms]
        repeats = m.mat_texrepeat[material] if m.nmat else np.zeros((len(geoms), 2))
        textured = (material[:, None] >= 0) & (repeats > 0)
        tile_m[textured] = 2 / repeats[textured]
        half_m = _BEYOND_FAR * far_m / 2 + tile_m
        period_m = 2 * tile_m  # after which a texture repeats
        step_m = period_m * np.maximum(1, np.round(half_m / 2 / period_m))
        endless = m.geom_size[geoms, :2] <= 0
        return cls(geoms, np.where(endless, half_m, np.inf), np.where(endless, step_m, np.inf))

    @property
    def endless(self) -> NDArray[np.int64]:
        """Indices into :attr:`geoms` of planes that are infinite along an axis."""
        return np.flatnonzero(np.isfinite(self.half_m).any(axis=1))

    def seen_from_behind(self, d: Any, center_w: Array) -> NDArray[np.int64]:
        """Return the geoms of the planes whose back an optical centre sees.

        ``center_w`` is (3,) metres, world frame; ``d`` is the ``MjData``.
        """
        toward = center_w - d.geom_xpos[self.geoms]
        facing = (toward * d.geom_xmat[self.geoms][:, 2::3]).sum(axis=1)
        return np.asarray(self.geoms[facing < 0])

    def middle(self, d: Any, plane: int, center_w: Array) -> Array:
        """Return (2,) the middle of a plane's rectangle along its axes, metres, seen from a centre.

        Args:
            d: the ``MjData``.
            plane: index into :attr:`geoms`.
            center_w: (3,) the optical centre, metres, world frame.
        """
        local = self._local(d, plane, center_w)
        endless = np.isfinite(self.step_m[plane])
        step_m = np.where(endless, self.step_m[plane], 1.0)
        return np.where(endless, step_m * np.round(local / step_m), 0.0)

    def position_w(self, d: Any, plane: int, center_w: Array) -> Array:
        """Return (3,) where the renderer draws a plane, metres, seen from an optical centre.

        Args:
            d: the ``MjData``.
            plane: index into :attr:`geoms`.
            center_w: (3,) the optical centre, metres, world frame.
        """
        geom = self.geoms[plane]
        axes_w = d.geom_xmat[geom].reshape(3, 3)[:, :2]
        return np.asarray(d.geom_xpos[geom] + axes_w @ self.middle(d, plane, center_w))

    def beyond(self, d: Any, plane: int, center_w: Array, points_w: Array) -> NDArray[np.bool_]:
        """Return (N,) whether points of a plane lie beyond its rectangle, seen from an optical centre.

        Args:
            d: the ``MjData``.
            plane: index into :attr:`geoms`.
            center_w: (3,) the optical centre, metres, world frame.
            points_w: (N, 3) the points, likewise.
        """
        away = np.abs(self._local(d, plane, points_w) - self.middle(d, plane, center_w))
        return np.asarray((away > self.half_m[plane]).any(axis=-1))

    def _local(self, d: Any, plane: int, points_w: Array) -> Array:
        """Return (..., 2) points along a plane's axes."""
        geom = self.geoms[plane]
        return np.asarray((points_w - d.geom_xpos[geom]) @ d.geom_xmat[geom].reshape(3, 3)[:, :2])


_CHECKED_FIRST = ("geom_pos", "body_pos", "geom_quat", "body_quat", "qpos0")


def check_finite(mujoco: Any, m: Any, d: Any) -> None:
    """Raise ArgumentError for a model, or its state, with NaN or infinite numbers.

    MuJoCo leaves out what has them.

    Args:
        mujoco: the package.
        m: an ``MjModel``.
        d: its ``MjData``.
    """
    for name in dict.fromkeys((*_CHECKED_FIRST, *dir(m))):
        if name.startswith("_"):
            continue
        values = getattr(m, name)
        if not isinstance(values, np.ndarray) or values.dtype.kind != "f" or np.isfinite(values).all():
            continue
        row = int(np.argwhere(~np.isfinite(values.reshape(len(values), -1)).all(axis=1))[0, 0])
        kind = name.partition("_")[0]
        owner = ""
        if kind in ("geom", "body"):
            owner = f" of {kind} {_name(mujoco, m, kind, row) or row}"
        raise ArgumentError(
            f"expected finite numbers in a model, got {values[row].tolist()} in {name}{owner}"
        )
    check_state(d)


def check_state(d: Any) -> None:
    """Raise ArgumentError for a state, an ``MjData``, with NaN or infinite numbers."""
    for name in ("qpos", "qvel", "act", "mocap_pos", "mocap_quat"):
        values = getattr(d, name)
        if not np.isfinite(values).all():
            raise ArgumentError(
                f"expected finite numbers in a state, got {values.ravel()[:8].tolist()} in {name}"
            )
