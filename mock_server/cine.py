"""The cine camera of plugin 1.1.0: its settings, its replies, and the projection that all sensors share.

Written from the reference, section 2.3, which does not give the numbers of a new camera. Crop, focus, near
plane and physical exposure are stored and reported; they change no image.
"""

import copy
import json
import math
from typing import Any, NamedTuple

_DEFAULTS: dict[str, dict[str, Any]] = {
    "filmback": {
        "sensor_width_mm": 23.76, "sensor_height_mm": 13.365,
        "sensor_offset_x_mm": 0.0, "sensor_offset_y_mm": 0.0,
    },
    "lens": {
        "focal_length_mm": 35.0, "aperture_fstop": 2.8, "min_focal_length_mm": 1.0,
        "max_focal_length_mm": 1000.0, "min_fstop": 0.1, "max_fstop": 64.0,
        "minimum_focus_distance_mm": 15.0, "squeeze_factor": 1.0, "diaphragm_blade_count": 7,
    },
    "focus": {
        "mode": "manual", "manual_distance_cm": 100000.0, "smooth": False, "smoothing_speed": 8.0,
        "offset_cm": 0.0, "tracking_actor": "", "tracking_offset_cm": [0.0, 0.0, 0.0],
    },
    "crop": {
        "aspect_ratio": 0.0, "overscan": 0.0, "crop_overscan": False,
        "scale_resolution_with_overscan": False,
    },
    "exposure": {"iso": 100.0, "shutter_speed_reciprocal": 60.0, "apply_physical_exposure": False},
    "near_clip": {"override": False, "distance_cm": 10.0},
}  # fmt: skip
"""The sections of the reply to ``cine``, and their keys."""

_LENS = list(_DEFAULTS["lens"])
_COMMANDS = {
    "filmback": ("filmback", list(_DEFAULTS["filmback"])),
    "lens": ("lens", _LENS[:2]),
    "lens_settings": ("lens", _LENS[2:]),
    "focus": ("focus", ["manual_distance_cm"]),
    "focus_mode": ("focus", ["mode", "smooth", "smoothing_speed", "offset_cm"]),
    "focus_tracking": ("focus", ["tracking_actor", "tracking_offset_cm"]),
    "crop": ("crop", list(_DEFAULTS["crop"])),
    "near_clip": ("near_clip", list(_DEFAULTS["near_clip"])),
    "exposure": ("exposure", list(_DEFAULTS["exposure"])),
}
"""By the name of a command, the section and the keys that it sets."""

_WORDS = {str: "[str]", float: "[float]", bool: "[uint]", int: "[uint]", list: " ".join(["[float]"] * 3)}
_LIMITS = {
    "sensor_width_mm": (1e-3, math.inf), "sensor_height_mm": (1e-3, math.inf), "iso": (1.0, math.inf),
    "squeeze_factor": (1.0, 2.0), "diaphragm_blade_count": (4, 16),
}  # fmt: skip
_MODES = ("manual", "tracking", "disable", "none", "do_not_override")


def _template(name: str) -> str:
    """Return the end of a command's template: its name, and a placeholder for each value that it sets."""
    section, keys = _COMMANDS[name]
    words = [name]
    for key in keys:
        words.append(_WORDS[type(_DEFAULTS[section][key])])
    return " ".join(words)


TEMPLATES = {name: _template(name) for name in _COMMANDS}
"""By the name of a command, the end of its template."""


class Projection(NamedTuple):
    """Focal lengths across and down, and the principal point from the top-left corner; all px."""

    fx: float
    fy: float
    cx: float
    cy: float


class Cine:
    """The settings of one camera's cine model."""

    def __init__(self) -> None:
        self.enabled = False
        self._settings = copy.deepcopy(_DEFAULTS)

    def set(self, command: str, *values: Any) -> str | None:
        """Change settings by a ``command`` of ``TEMPLATES`` and its values, and switch the model on.

        Returns:
            The reply to a value that the plugin refuses; else None.
        """
        section, keys = _COMMANDS[command]
        settings = self._settings[section]
        if command == "focus_tracking":
            values = values[0], list(values[1:])
            settings["mode"] = "tracking"
        changes = dict(zip(keys, values, strict=True))
        for key, value in changes.items():
            if isinstance(settings[key], bool):
                changes[key] = bool(value)
            elif key in _LIMITS:
                changes[key] = _clamp(value, *_LIMITS[key])
        if command == "focus_mode":
            if (mode := changes["mode"].lower()) not in _MODES:
                return f"error Focus mode must be {', '.join(_MODES[:-1])}, or {_MODES[-1]}"
            changes["mode"] = mode
        if command == "lens":
            focal, stop = changes.values()
            focal = _clamp(focal, settings["min_focal_length_mm"], settings["max_focal_length_mm"])
            stop = max(0.1, _clamp(stop, settings["min_fstop"], settings["max_fstop"]))
            changes = dict(zip(keys, (focal, stop), strict=True))
        settings.update(changes)
        self.enabled = True
        return None

    def projection(self, width: int, height: int) -> Projection:
        """Return the projection of an image of ``width`` by ``height`` px.

        Its field of view is horizontal, also for a portrait.
        """
        sensor_width, sensor_height, offset_x, offset_y = self._settings["filmback"].values()
        lens = self._settings["lens"]
        focal = width * lens["focal_length_mm"] / (sensor_width * lens["squeeze_factor"])
        cx = width / 2 - width * offset_x / sensor_width
        cy = height / 2 + height * offset_y / sensor_height
        return Projection(focal, focal, cx, cy)

    def intrinsics(self, width: int, height: int) -> str:
        """Return the reply to ``cine/intrinsics``, of an image of ``width`` by ``height`` px."""
        fx, fy, cx, cy = self.projection(width, height)
        m00 = 2 * fx / width
        m11 = 2 * fy / height
        m20 = 2 * cx / width - 1
        m21 = 1 - 2 * cy / height
        return json.dumps({
            "width": width, "height": height, "fx": fx, "fy": fy, "cx": cx, "cy": cy,
            **_angles(m00, m11), "projection_offset": [m20, m21],
            "projection_matrix": [m00, 0, 0, 0, 0, m11, 0, 0, m20, m21, 0, 1, 0, 0, 10.0, 0],
        }, indent="\t")  # fmt: skip

    def model(self, width: int, height: int) -> str:
        """Return the reply to ``cine``, of an image of ``width`` by ``height`` px."""
        fx, fy = self.projection(width, height)[:2]
        angles = _angles(2 * fx / width, 2 * fy / height)
        return json.dumps({"enabled": self.enabled, **self._settings, **angles}, indent="\t")


def _clamp(value: Any, least: float, most: float) -> Any:
    return min(max(value, least), most)


def _angles(m00: float, m11: float) -> dict[str, float]:
    """Return the fields of view by the scales in x and y of the projection matrix."""
    return {"horizontal_fov_degrees": _angle_deg(m00), "vertical_fov_degrees": _angle_deg(m11)}


def _angle_deg(scale: float) -> float:
    return 2 * math.degrees(math.atan(1 / scale))
