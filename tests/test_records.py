"""Records: fields are checked where they are declared, from Python and from files alike."""

import pytest

from omniscv.arguments import number, whole_number
from omniscv.errors import ArgumentError
from omniscv.records import checked, listed, nested, optional, read, record


@record
class Lens:
    """A lens."""

    focal: float = checked(number, above=0)
    kind: str = checked(lambda name, value: str(value), default="equidistant", key="as")


@record
class Camera:
    """A camera with lenses."""

    lenses: tuple[Lens, ...] = checked(listed(nested(Lens)))
    count: int | None = checked(optional(whole_number), default=None)

    def __post_init__(self) -> None:
        if self.count is not None and self.count != len(self.lenses):
            raise ArgumentError(f"count: expected {len(self.lenses)}, got {self.count}")


def test_values_are_converted():
    camera = read(Camera, {"lenses": [{"focal": "2", "as": "stereographic"}], "count": 1})
    assert camera == Camera((Lens(2.0, "stereographic"),), 1)
    assert isinstance(camera.lenses[0].focal, float)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (3, "camera: expected a mapping with lenses, count, got 3"),
        ({"lens": []}, "camera: unknown key 'lens'; known keys: lenses, count; did you mean lenses?"),
        ({"count": 1}, "camera: missing key 'lenses'; known keys: lenses, count"),
        ({"lenses": {}}, "camera.lenses: expected a list, got {}"),
        ({"lenses": [{"focal": 0}]}, "camera.lenses[0].focal: expected a finite number > 0, got 0"),
        (
            {"lenses": [{"focal": 1, "kind": 2}]},
            "camera.lenses[0]: unknown key 'kind'; known keys: focal, as",
        ),
        ({"lenses": [], "count": 0}, "camera.count: expected a whole number >= 1, got 0"),
        ({"lenses": [], "count": 2}, "camera.count: expected 0, got 2"),
    ],
)
def test_wrong_values_name_the_place_in_the_file(value, message):
    with pytest.raises(ArgumentError) as raised:
        read(Camera, value, "camera")
    assert str(raised.value) == message


def test_python_and_files_are_checked_alike():
    with pytest.raises(ArgumentError, match="focal: expected a finite number > 0, got -1"):
        Lens(-1)
