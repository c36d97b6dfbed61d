"""What commands do to objects, alike in all dialects."""

from __future__ import annotations

from mock_server.world import SceneObject


def color(o: SceneObject) -> str:
    """The colour in the mask, as it was set."""
    return "(R={},G={},B={},A=255)".format(*o.color)


def paint(o: SceneObject, r: int, g: int, b: int) -> str:
    """Sets the colour; the engine keeps 8 bits of each number."""
    o.color = (r % 256, g % 256, b % 256)
    return "ok"


def show(o: SceneObject) -> str:
    """Shows an object."""
    o.hidden = False
    return "ok"


def hide(o: SceneObject) -> str:
    """Hides an object from every mode."""
    o.hidden = True
    return "ok"


def move(o: SceneObject, x: float, y: float, z: float) -> str:
    """Puts an object elsewhere, cm."""
    o.location = (x, y, z)
    return "ok"


def turn(o: SceneObject, pitch: float, yaw: float, roll: float) -> str:
    """Turns an object, degrees."""
    o.rotation = (pitch, yaw, roll)
    return "ok"
