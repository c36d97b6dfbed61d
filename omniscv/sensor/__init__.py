"""Light after composition: what a lens and a sensor make of an image."""

from omniscv.sensor.sensor import PRESETS, SOURCES, Sensor

__all__ = ["PRESETS", "SOURCES", "Sensor"]
