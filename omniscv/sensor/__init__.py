"""Light after composition: the effects of lens and sensor on an image."""

from omniscv.sensor.sensor import PRESETS, Sensor

__all__ = ["PRESETS", "Sensor"]
