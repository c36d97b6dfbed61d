"""Images that PyTorch samples, against those that omniscv composes of the same captures."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from support.datasets import CLASSES

import mock_server
import omniscv
from omniscv.errors import ArgumentError, MissingCaptureError
from omniscv.sources import Capabilities, Capture, ObjectTable, Source, SourceWrapper
from omniscv.storage import bounded
from omniscv.torch import Faces

# As devices do, kernels divide by 0 and take nothing of it; their interpreter warns.
pytestmark = pytest.mark.filterwarnings("ignore:.*encountered in:RuntimeWarning:triton")

CENTER = (0.1, -0.2, 1.4)
MODES = ("lit", "object_mask", "depth", "normals")
CENTRAL = [name for name in omniscv.cameras.names() if omniscv.cameras.model(name).central]
BORDERS = [(45, 0, 0), (0, 0, 0), (90, 45, 0), (0, 90, 0), (20, -90, 10), (45, 35.264389682754654, 0)]
"""Rays through the middle run along edges and corners of faces, and to the poles."""


class Square(SourceWrapper):
    """A source whose pictures are square, of 90 degrees: faces have no border, and need a gutter."""

    capabilities = Capabilities(modes=frozenset(MODES), can_set_fov=False, fov_deg=90.0)


class Noise(Source):
    """Faces of black and white pixels: no two pixels could differ more."""

    capabilities = Capabilities()

    def capture(self, requests):
        for request in requests:
            seed = int(1e6 * np.abs(request.view.pose.R_w_c @ (1, 2, 3)).sum())
            shape = request.view.height, request.view.width, 3
            bits = np.random.default_rng(seed).integers(0, 2, shape, dtype=np.uint8)
            yield Capture(request, request.view, 255 * bits)

    def objects(self):
        return ObjectTable({})


def turns(count=2):
    """Orientations along borders, and random ones."""
    drawn = Rotation.random(count, random_state=1).as_matrix()
    return [*(omniscv.Pose.from_angles((0, 0, 0), *angles).R_w_c for angles in BORDERS), *drawn]


def check(faces, source, camera, R_w_c, modes, **options):
    """Compare a batch with what is rendered one by one; return the largest difference of colours."""
    batch = faces.render(camera, R_w_c)
    worst = 0
    for i, R in enumerate(R_w_c):
        pose = omniscv.Pose(np.array(faces.position), R)
        nearest = omniscv.render(camera, pose, source, modes, strategy="cube", filter="nearest", **options)
        if "object_mask" in modes:
            np.testing.assert_array_equal(batch["labels"][i].numpy(), nearest.labels)
            depth = batch["depth"][i, 0].numpy()
            bound = nearest.depth_error
            assert (np.abs(depth - nearest.depth) <= bound / 32)[np.isfinite(bound)].all()  # it is rounded
            normals = np.moveaxis(batch["normals"][i].numpy(), 0, -1)
            np.testing.assert_allclose(normals, nearest.normals, atol=2e-7)  # a rounding of float32
        blended = omniscv.render(camera, pose, source, strategy="cube", filter="bilinear", **options)
        off = np.abs(np.moveaxis(batch["lit"][i].numpy(), 0, -1).astype(int) - blended.lit)
        worst = max(worst, off.max())
    return worst


@pytest.fixture(scope="module", params=[("cpu",), ()], ids=["processor", "triton"])
def kernels(request):
    """Whether the processor's kernels sample, or those for devices, which Triton interprets."""
    with pytest.MonkeyPatch.context() as patch:
        if not request.param:
            pytest.importorskip("triton")
            from omniscv.torch import kernels

            for options in (kernels.OPTIONS, kernels.OF_LOOK_UP):
                patch.setitem(options, "SIZE", 4096)  # its interpreter takes its time for each program
        patch.setattr("omniscv.torch.faces._ON_PROCESSOR", request.param)
        yield bool(request.param)


@pytest.fixture(scope="module")
def wide(kernels):
    """A source, and its faces with a border."""
    with omniscv.open_source("scene://four-wall") as source:
        yield source, Faces(source, CENTER, MODES, face_size=40)


@pytest.mark.parametrize("name", CENTRAL)
def test_every_central_camera(name, wide):
    source, faces = wide
    camera = omniscv.cameras.model(name).example(33)
    assert check(faces, source, camera, turns()[::3], MODES, face_size=40) <= 1


def test_borders_and_poles(wide):
    source, faces = wide
    camera = omniscv.cameras.create("pinhole", width=33, height=33, fov_deg=90)
    assert check(faces, source, camera, turns(), MODES, face_size=40) <= 1


def test_faces_without_a_border(kernels):
    camera = omniscv.cameras.create("equirectangular", width=48, height=24)
    with Square(omniscv.open_source("scene://four-wall")) as source:
        faces = Faces(source, CENTER, MODES, face_size=32)
        assert check(faces, source, camera, turns(), MODES, face_size=32) <= 1


def test_finer_truth_of_instance_ids_in_a_recording(tmp_path, kernels):
    camera = omniscv.cameras.create("fisheye-equidistant", width=40, height=40, fov_deg=200)
    options = {"face_size": 24, "truth_scale": 2}
    with omniscv.record(omniscv.open_source("scene://four-wall?masks=ids"), tmp_path / "a.sqlite") as source:
        Faces(source, CENTER, MODES, **options)
    with omniscv.open_source(tmp_path / "a.sqlite") as source:
        faces = Faces(source, CENTER, MODES, truth_scale=2)
        assert check(faces, source, camera, turns(), MODES, **options) <= 1


def test_colors_that_differ_most(kernels):
    camera = omniscv.cameras.create("equirectangular", width=96, height=48)
    faces = Faces(Noise(), CENTER, face_size=24)
    assert check(faces, Noise(), camera, turns(), ("lit",), face_size=24) == (0 if kernels else 1)
    assert 40 < faces.render(camera, turns())["lit"].double().std() < 127


def test_what_is_seen_is_what_exact_tracing_finds(wide):
    _, faces = wide
    camera = omniscv.cameras.create("equirectangular", width=64, height=32)
    scene = mock_server.load_scene("four-wall")
    R_w_c = omniscv.Pose.from_angles((0, 0, 0), 37, -20, 8).R_w_c
    hits = scene.trace(CENTER, camera.unproject().directions @ R_w_c.T)
    image = faces.render(camera, R_w_c)
    assert np.mean(image["labels"][0].numpy() == hits.label) > 0.96  # faces of 40 px
    assert np.median(np.abs(image["depth"][0, 0].numpy() / hits.distance - 1)) < 0.01


def test_shapes_types_and_pixels_outside(wide):
    _, faces = wide
    camera = omniscv.cameras.create("fisheye-equidistant", width=20, height=20, fov_deg=180)
    found = faces.render(camera, turns(3)[-3:])
    kinds = {"lit": ((3,), torch.uint8), "labels": ((), torch.int64)}
    kinds |= {"depth": ((1,), torch.float32), "normals": ((3,), torch.float32)}
    assert {name: (tuple(each.shape[1:-2]), each.dtype) for name, each in found.items()} == kinds
    assert {(len(each), *each.shape[-2:]) for each in found.values()} == {(3, 20, 20)}
    outside = torch.from_numpy(~camera.valid())
    assert all((each[..., outside] == 0).all() for each in found.values())
    assert (found["depth"][..., ~outside] > 0).all()


def test_a_batch_is_its_images():
    camera = omniscv.cameras.create("equirectangular", width=400, height=200)  # two are looked up one by one
    faces = Faces(Noise(), CENTER, face_size=16)
    batch = faces.render(camera, turns(0)[:2])["lit"]
    for i, R in enumerate(turns(0)[:2]):
        assert torch.equal(faces.render(camera, R)["lit"][0], batch[i])


def test_orientations_may_be_tensors(wide):
    _, faces = wide
    camera = omniscv.cameras.create("equirectangular", width=16, height=8)
    for kind in (torch.float64, torch.float32):
        given = torch.tensor(np.array(turns()), dtype=kind)
        expected = faces.render(camera, given.double().numpy())
        assert torch.equal(faces.render(camera, given)["depth"], expected["depth"])


def test_classes():
    camera = omniscv.cameras.create("equirectangular", width=32, height=16)
    rules = bounded.parse_yaml(CLASSES)
    with omniscv.open_source("scene://four-wall") as source:
        faces = Faces(source, CENTER, ("object_mask",), face_size=24, classes=rules)
        names = source.objects().names()
    found = faces.render(camera, np.eye(3))
    pairs = set(zip(found["labels"].ravel().tolist(), found["classes"].ravel().tolist(), strict=True))
    expected = {"Layout_Floor": 2, "Layout_Ceiling": 22, "Chair_1": 5}
    assert {name: dict(pairs)[1 + names.index(name)] for name in expected} == expected
    assert len(pairs) == len(dict(pairs))


def test_wrong_arguments(wide, recording):
    source, faces = wide
    camera = omniscv.cameras.create("equirectangular", width=8, height=4)
    ring = omniscv.cameras.create("noncentral-panorama", width=8, height=4, radius=0.5)
    with pytest.raises(ArgumentError, match="face_size: expected a whole number of pixels for a source"):
        Faces(source, CENTER)
    with pytest.raises(ArgumentError, match="device: expected one with float64"):
        Faces(source, CENTER, face_size=8, device="mps")
    with pytest.raises(ArgumentError, match="single optical centre, got noncentral-panorama"):
        faces.render(ring, np.eye(3))
    with pytest.raises(ArgumentError, match="R_w_c: expected a right-handed"):
        faces.render(camera, 2 * np.eye(3))
    for wrong in (np.zeros((0, 3, 3)), np.zeros(3), "turned", np.full((3, 3), np.nan)):
        with pytest.raises(ArgumentError, match="R_w_c: expected"):
            faces.render(camera, wrong)
    with omniscv.open_source(recording) as recorded, pytest.raises(MissingCaptureError):
        Faces(recorded, (9, 9, 9))
