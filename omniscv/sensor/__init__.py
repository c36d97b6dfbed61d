"""Light after composition: what a lens and a sensor make of an image."""

from omniscv.sensor.sensor import PRESETS, Sensor

__all__ = ["PRESETS", "Sensor"]
