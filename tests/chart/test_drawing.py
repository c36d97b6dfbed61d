"""What the charts share: the front, plain numbers, labels that cover nothing."""

import itertools

import pytest

from omniscv.chart import drawing
from omniscv.chart.drawing import Dot, Look


def test_the_front_holds_what_nothing_beats():
    dots = [Dot("a", "", x, y) for x, y in ((1, 9), (2, 5), (2, 7), (3, 6), (4, 1), (5, 1))]
    assert drawing.front(dots) == [dots[0], dots[1], dots[4]]


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.002, "0.002"), (0.5, "0.5"), (1, "1"), (20, "20"), (5000, "5,000"), (1e6, "1,000,000")],
)
def test_ticks_are_plain_numbers(value, text):
    assert drawing.number(value) == text


def test_labels_do_not_overlap_where_there_is_room():
    """Dots in pairs, nearer to each other than their labels are long."""
    ways = [
        Dot("a", f"{x} and {y}", x * (1 + 0.02 * twin), y)
        for x, y in itertools.product((1, 9, 80), (2, 30))
        for twin in (0, 1)
    ]
    _, (axes,) = drawing.figure(1, 4.0, "Of labels")
    looks = {"a": Look("#0072b2", "o", "")}
    drawing.dots(axes, ways, looks)
    drawing.label(axes.figure, [(axes, ways)], looks)
    boxes = [text.get_window_extent() for text in axes.texts]
    assert len(boxes) == len(ways)
    assert not any(a.overlaps(b) for a, b in itertools.combinations(boxes, 2))
    assert all(axes.bbox.containsx(b.x0) and axes.bbox.containsx(b.x1) for b in boxes)


def test_a_picture_has_the_same_bytes_every_time(tmp_path):
    def drawn(folder):
        folder.mkdir()
        figure, (axes,) = drawing.figure(1, 3.0, "The same")
        drawing.dots(
            axes,
            [Dot("a", "one", 1, 2, default=True), Dot("a", "two", 3, 1)],
            {"a": Look("#0072b2", "o", "-")},
        )
        return [path.read_bytes() for path in drawing.write([], figure, folder, "chart")]

    assert drawn(tmp_path / "first") == drawn(tmp_path / "second")
