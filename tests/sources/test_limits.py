"""Whatever a recorder took, 'check' calls sound; what it refused left the file as it was, byte for byte."""

from contextlib import suppress

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

import omniscv
from omniscv.errors import OmniscvError, RecordingNotWritableError
from omniscv.geometry import Pose
from omniscv.geometry.scene_geometry import ObjectBox, SceneGeometry
from omniscv.sources import Capabilities, Capture, ObjectTable, Request, SceneIdentity, Source, View
from omniscv.sources.recording.importing import import_pictures
from omniscv.sources.recording.inspection import verify

PIXELS = {
    "lit": np.zeros((2, 2, 3), np.uint8),
    "object_mask": np.ones((2, 2), np.uint16),
    "depth": np.ones((2, 2), np.float32),
}
TEXT = st.text(st.characters(exclude_categories=()), max_size=5) | st.just("\ud800") | st.just("x" * 200)
WHOLE = st.integers(-1, 300) | st.sampled_from([0xFFFF, 1 << 16, 1 << 70, 10**5000])
VALUE = st.recursive(
    st.none() | st.floats() | WHOLE | TEXT, lambda v: st.lists(v, max_size=2) | st.dictionaries(TEXT, v)
)
NAMES = st.sampled_from(["a", "b", "", "\0", "\ud800", "é" * 99])
PROVENANCE = st.dictionaries(TEXT, VALUE, max_size=2) | st.fixed_dictionaries({"scene": NAMES | WHOLE})
TABLE = st.builds(
    ObjectTable, st.dictionaries(NAMES, st.tuples(WHOLE, WHOLE, WHOLE), max_size=3), WHOLE, st.just({})
) | st.builds(ObjectTable, st.just({}), WHOLE, st.dictionaries(NAMES, WHOLE, max_size=3))
NUMBER = st.floats(-1e6, 1e6)


class Says(Source):
    """A source of whatever is drawn."""

    def __init__(self, draw):
        self.draw, self.name, self.table = draw, SceneIdentity(draw(NAMES), draw(NAMES)), draw(TABLE)

    capabilities = Capabilities()

    @property
    def scene_identity(self):
        return self.name

    def objects(self):
        return self.table

    def geometry(self):
        box = ObjectBox(np.array([self.draw(NUMBER)] * 3), np.eye(3), np.ones(3), "scene")
        return SceneGeometry(self.draw(st.dictionaries(NAMES, st.just(box), max_size=2)))

    def capture(self, requests):
        for request in requests:
            yield Capture(request, request.view, PIXELS[request.mode], self.draw(PROVENANCE))


@st.composite
def requests(draw):
    view = View(Pose.from_angles([draw(NUMBER)] * 3, draw(NUMBER)), draw(st.floats(0.01, 179.9)), 2, 2)
    mode = draw(st.sampled_from([*PIXELS]))
    stops = draw(st.none() | st.floats(-20, 20)) if mode == "lit" else None
    return Request(view, mode, stops=stops)


@settings(max_examples=30, deadline=None, suppress_health_check=[*HealthCheck])
@given(st.data())
def test_what_a_recorder_took_is_sound(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("sound") / "a.sqlite"
    for _ in range(2):
        with suppress(OmniscvError):
            source = omniscv.record(Says(data.draw), path)
            with source, suppress(OmniscvError):
                source.objects()
            with source:
                list(source.capture([data.draw(requests())]))
        if path.exists():
            assert verify(path).faults == []


def test_an_import_of_too_many_objects_leaves_the_recording_as_it_was(tmp_path):
    """Masks without a list: each of 40,000 colours becomes an object; two imports have more than 65,535."""
    codes = np.arange(1, 40_001).reshape(200, 200)
    for name, first in (("a", 0), ("b", 1 << 17)):
        (tmp_path / name / "mask").mkdir(parents=True)
        colors = np.uint8(np.stack([codes + first >> shift & 255 for shift in (16, 8, 0)], axis=-1))
        for face in ("front", "right", "back", "left", "up", "down"):
            Image.fromarray(colors).save(tmp_path / name / "mask" / f"{face}.png")
    file = tmp_path / "a.sqlite"
    import_pictures(tmp_path / "a", file, "faces")
    before = file.read_bytes()
    with pytest.raises(RecordingNotWritableError, match="expected at most 65535 objects, got more"):
        import_pictures(tmp_path / "b", file, "faces", position=(1, 0, 0))
    assert file.read_bytes() == before
    assert verify(file).ok
