"""The cine camera of plugin 1.1.0: its state, its replies, and the projection that all sensors share.

Written from the reference, section 2.3, which does not give the numbers of a new camera. Crop, focus, near
plane and physical exposure are kept and reported, and change no image.
"""

import json
import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

_MODES = ("manual", "tracking", "disable", "none", "do_not_override")


class Projection(NamedTuple):
    """Focal lengths across and down, and the principal point from the top-left corner; all px."""

    fx: float
    fy: float
    cx: float
    cy: float


@dataclass
class Cine:
    """The settings of one camera's cine model; every setter but ``enable(0)`` switches it on.

    Pixels are square; if ``stretched`` the picture shows the whole height of the filmback, whatever its size.
    """

    enabled: bool = False
    stretched: bool = False
    filmback: list[float] = field(
        default_factory=lambda: [23.76, 13.365, 0.0, 0.0]
    )  # width, height, offsets, mm
    lens: list[float] = field(default_factory=lambda: [35.0, 2.8])  # focal length, mm; aperture
    limits: list[float] = field(default_factory=lambda: [1.0, 1000.0, 0.1, 64.0, 15.0])
    squeeze: float = 1.0
    blades: int = 7
    focus: dict[str, Any] = field(
        default_factory=lambda: {
            "mode": "manual", "manual_distance_cm": 100000.0, "smooth": False, "smoothing_speed": 8.0,
            "offset_cm": 0.0, "tracking_actor": "", "tracking_offset_cm": [0.0, 0.0, 0.0],
        }
    )  # fmt: skip
    crop: list[float] = field(default_factory=lambda: [0.0, 0.0, 0, 0])
    near_clip: list[float] = field(default_factory=lambda: [0, 10.0])
    exposure: list[float] = field(default_factory=lambda: [100.0, 60.0, 0])

    def enable(self, on: int) -> None:
        """Switch it on or off."""
        self.enabled = bool(on)

    def set_filmback(self, width: float, height: float, x: float, y: float) -> None:
        """Set the sensor's size and offsets, mm."""
        self.enabled, self.filmback = True, [max(width, 1e-3), max(height, 1e-3), x, y]

    def set_lens(self, focal: float, aperture: float) -> None:
        """Set focal length, mm, and aperture, within their limits."""
        least, most, widest, smallest, _ = self.limits
        stop = max(0.1, min(max(aperture, widest), smallest))
        self.enabled, self.lens = True, [min(max(focal, least), most), stop]

    def set_lens_settings(self, *values: float) -> None:
        """Set the limits, squeeze factor and blades."""
        self.enabled, self.limits = True, list(values[:5])
        self.squeeze, self.blades = min(max(values[5], 1.0), 2.0), int(min(max(values[6], 4), 16))

    def set_focus(self, distance: float) -> None:
        """Set the manual focus distance, cm."""
        self.enabled, self.focus["manual_distance_cm"] = True, distance

    def set_focus_mode(self, mode: str, smooth: int, speed: float, offset: float) -> str | None:
        """Set how it focuses."""
        if mode.lower() not in _MODES:
            return f"error Focus mode must be {', '.join(_MODES[:-1])}, or {_MODES[-1]}"
        self.enabled = True
        self.focus |= {
            "mode": mode.lower(),
            "smooth": bool(smooth),
            "smoothing_speed": speed,
            "offset_cm": offset,
        }
        return None

    def set_tracking(self, actor: str, *offset: float) -> None:
        """Focus on an actor."""
        self.enabled = True
        self.focus |= {"mode": "tracking", "tracking_actor": actor, "tracking_offset_cm": list(offset)}

    def set_crop(self, *values: float) -> None:
        """Set aspect ratio, overscan, and whether it crops and scales."""
        self.enabled, self.crop = True, list(values)

    def set_near_clip(self, override: int, distance: float) -> None:
        """Set the near plane, cm."""
        self.enabled, self.near_clip = True, [override, distance]

    def set_exposure(self, iso: float, shutter: float, apply: int) -> None:
        """Set the physical exposure."""
        self.enabled, self.exposure = True, [max(iso, 1.0), shutter, apply]

    def projection(self, width: int, height: int) -> Projection:
        """Return the projection of an image, whose field of view is horizontal, also for a portrait."""
        sensor, tall, x, y = self.filmback
        focal = width * self.lens[0] / (sensor * self.squeeze)
        down = height * self.lens[0] / tall if self.stretched else focal
        return Projection(focal, down, width / 2 - width * x / sensor, height / 2 + height * y / tall)

    def intrinsics(self, width: int, height: int) -> str:
        """Return the reply to ``cine/intrinsics``."""
        fx, fy, cx, cy = self.projection(width, height)
        m00, m11, m20, m21 = 2 * fx / width, 2 * fy / height, 2 * cx / width - 1, 1 - 2 * cy / height
        return _pretty({
            "width": width, "height": height, "fx": fx, "fy": fy, "cx": cx, "cy": cy,
            **_angles(m00, m11), "projection_offset": [m20, m21],
            "projection_matrix": [m00, 0, 0, 0, 0, m11, 0, 0, m20, m21, 0, 1, 0, 0, 10.0, 0],
        })  # fmt: skip

    def model(self, width: int, height: int) -> str:
        """Return the reply to ``cine``."""
        fx, fy = self.projection(width, height)[:2]
        lens = [*self.lens, *self.limits, self.squeeze, self.blades]
        return _pretty({
            "enabled": self.enabled,
            "filmback": dict(zip(_FILMBACK, self.filmback, strict=True)),
            "lens": dict(zip(_LENS, lens, strict=True)),
            "focus": self.focus,
            "crop": dict(zip(_CROP, [*self.crop[:2], *map(bool, self.crop[2:])], strict=True)),
            "exposure": dict(zip(_EXPOSURE, [*self.exposure[:2], bool(self.exposure[2])], strict=True)),
            "near_clip": {"override": bool(self.near_clip[0]), "distance_cm": self.near_clip[1]},
            **_angles(2 * fx / width, 2 * fy / height),
        })  # fmt: skip


_FILMBACK = ("sensor_width_mm", "sensor_height_mm", "sensor_offset_x_mm", "sensor_offset_y_mm")
_LENS = (
    "focal_length_mm", "aperture_fstop", "min_focal_length_mm", "max_focal_length_mm", "min_fstop",
    "max_fstop", "minimum_focus_distance_mm", "squeeze_factor", "diaphragm_blade_count",
)  # fmt: skip
_CROP = ("aspect_ratio", "overscan", "crop_overscan", "scale_resolution_with_overscan")
_EXPOSURE = ("iso", "shutter_speed_reciprocal", "apply_physical_exposure")


def _angles(m00: float, m11: float) -> dict[str, float]:
    h, v = (2 * math.degrees(math.atan(1 / scale)) for scale in (m00, m11))
    return {"horizontal_fov_degrees": h, "vertical_fov_degrees": v}


def _pretty(reply: dict[str, Any]) -> str:
    """Return JSON of many lines, as the engine writes it."""
    return json.dumps(reply, indent="\t")
