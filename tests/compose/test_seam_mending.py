"""Faces that differ at their edges: what gains explain, what a membrane closes, and what neither touches."""

from contextlib import closing

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import gaussian_filter, uniform_filter
from scipy.spatial.transform import Rotation

import omniscv
from omniscv import cli, light
from omniscv.diagnostics.recorded_faces import examine_recording
from omniscv.geometry import Pose, cube_rotations
from omniscv.sources import View
from omniscv.sources.base import Capture, Request
from omniscv.sources.developing.cube import Cube
from omniscv.sources.developing.seams import close, estimate_gains, mend
from omniscv.sources.recording import RecordedSource, Recording
from omniscv.sources.recording.store import Store
from omniscv.sources.scene import open_scene

CENTER = (-0.5, 0.6, 1.2)
GAINS = np.array([0.8, 1.25, 1.0, 0.9, 1.1, 1.02])


def views(edge, turned=None, center=CENTER):
    """The six faces; one of them turned by a rotation vector, degrees."""
    for name, R_w_c in cube_rotations():
        turn = np.radians(turned[1]) if turned and turned[0] == name else np.zeros(3)
        yield View(Pose(center, Rotation.from_rotvec(turn).as_matrix() @ R_w_c), 90, edge, edge)


def faces(edge=128, smooth=2, turned=None, scene="four-wall", center=CENTER, mode="lit"):
    """Pictures of a room, (6, s, s, 3) uint8, averaged over the pixel as engines do; masks are not."""
    smooth = smooth if mode == "lit" else 1
    with open_scene(f"scene://{scene}?traces=0") as source:
        requests = [Request(view.scaled(smooth), mode) for view in views(edge, turned, center)]
        pictures = np.stack([capture.pixels for capture in source.capture(requests)]).astype(np.float64)
    return np.uint8(pictures.reshape(6, edge, smooth, edge, smooth, 3).mean(axis=(2, 4)) + 0.5)


def exposed(pictures, factors):
    lights = (light.decode(picture, "srgb") for picture in pictures)
    both = zip(lights, factors, strict=True)
    return np.stack([light.encode(np.float32(one * np.atleast_3d(factor)), "srgb") for one, factor in both])


def store(path, captured, transfer=None):
    """Write views, modes and their pixels into a recording."""
    with closing(Store(path, write=True)) as held:
        for view, mode, pixels in captured:
            held.add(Capture(Request(view, mode), view, pixels, {"transfer": transfer} if transfer else {}))


def cube(pixels):
    return Cube.of([*views(pixels.shape[1])], [*pixels])


@pytest.fixture(scope="module")
def room():
    return faces()


def test_one_bright_face_meets_the_others_half_way():
    """The known answer of a membrane: half the step on either side, and nothing a reach away."""
    pixels = np.full((6, 128, 128, 3), 100, np.uint8)
    pixels[2] += 12
    assert sorted(cube(pixels).steps().round(6)) == [0] * 8 + [12] * 4
    closed = close(cube(pixels))
    assert np.abs(cube(closed).steps()).max() < 0.5
    assert abs(int(closed[2, 64, 0, 0]) - 106) <= 1
    assert closed[2, 64, 64, 0] == 112
    report = mend([*views(128)], [*pixels], "close", "unknown").report
    assert report["mean_change"] < report["change_p99"] <= 6
    assert closed[0, 64, 64, 0] == 100


def test_gains_are_those_of_light(room):
    darkened = exposed(room, GAINS)
    found = estimate_gains(cube(darkened), "srgb")
    assert found.proven
    expected = np.exp(np.log(GAINS).mean()) / GAINS
    np.testing.assert_allclose(found.gains, expected, rtol=0.005)
    mended = mend([*views(128)], [*darkened], "gains", "srgb")
    common = exposed(room, [np.exp(np.log(GAINS).mean())] * 6)
    usable = (common < 250) & (darkened < 250)
    assert np.abs(np.stack(mended.pixels).astype(float) - common)[usable].mean() < 0.5
    assert mended.report["steps_after"]["median"] < mended.report["steps"]["median"]


def test_light_that_is_added_is_no_gain(room):
    """Gloss and glare of one face: gains explain too little, and the membrane closes what it can."""
    glossy = room.astype(float)
    glossy[1, 60:200, :90] += 40
    glare = room.astype(float)
    glare += np.stack([0.2 * (uniform_filter(face, (80, 80, 0), mode="nearest") - face) for face in glare])
    for pictures in (glossy, glare):
        broken = np.clip(pictures, 0, 255).astype(np.uint8)
        found = estimate_gains(cube(broken), "srgb")
        assert not found.proven or np.abs(found.gains - 1).max() < 0.005
        refused = mend([*views(128)], [*broken], "gains", "srgb")
        assert "gains explain" in refused.report["refused"]
        assert all((a == b).all() for a, b in zip(refused.pixels, broken, strict=True))
        closed = mend([*views(128)], [*broken], "close", "srgb")
        assert closed.report["steps_after"]["p90"] < 0.6 * max(closed.report["steps"]["p90"], 1)
        error = [np.abs(np.stack(each).astype(float) - room).mean() for each in (broken, closed.pixels)]
        assert error[1] <= 1.05 * error[0]


def drawn(edge):
    """A corner of two walls that lies exactly on a vertical edge of the cube, and a floor without outlines
    on edges: faces (6, s, s, 3) uint8, and masks (6, s, s) of ids."""
    x = (np.arange(edge) + 0.5) * 2 / edge - 1
    rays = np.stack([*np.meshgrid(x, x), np.ones((edge, edge))], axis=-1)
    d = np.stack([rays @ R_w_c.T for _, R_w_c in cube_rotations()])
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    corner = (d[..., 0] > d[..., 1]).astype(int)  # at 45 degrees to the left of the front
    masks = np.where(d[..., 2] < -0.8, 3, 1 + corner)
    shade = np.array([0, 70, 130, 100])[masks] + 20 * d[..., 2]
    return np.repeat(np.uint8(shade + 0.5)[..., None], 3, axis=-1), masks.astype(np.uint16)


@pytest.mark.parametrize("scene", ["drawn", (1, 0.5, 1.2)])
def test_an_outline_along_an_edge_is_no_seam(scene):
    """Corners of walls lie on edges of these cubes: with masks they stay, and what light adds is closed."""
    if scene == "drawn":
        true, masks = drawn(256)
        shown = true.copy()
        shown[0] += 8
    else:
        true, masks = (
            faces(256, 1, scene="six-wall", center=scene, mode=mode) for mode in ("lit", "object_mask")
        )
        halo = [gaussian_filter(face.astype(float), (32, 32, 0), mode="nearest") for face in true]
        shown = np.uint8(0.95 * true + 0.05 * np.stack(halo) + 0.5)
    mended = (mend([*views(256)], [*shown], "close", "unknown", some) for some in ((), masks))
    blind, closed = (np.stack(each.pixels) for each in mended)
    before, without, after = (np.abs(each.astype(float) - true).mean() for each in (shown, blind, closed))
    assert without > 1.3 * before
    assert after <= 1.05 * before
    assert np.abs(Cube.of([*views(256)], [*closed], masks).steps()).max() < 0.5


def wide_views(edge, border):
    """The six faces with px beyond 90 degrees on every side."""
    size = edge + 2 * border
    return [View(view.pose, np.degrees(2 * np.arctan(size / edge)), size, size) for view in views(edge)]


def test_faces_with_overscan_fade_into_each_other():
    """One bright face: half of its step on the edge, none of it where the overlap ends."""
    pixels = np.full((6, 144, 144, 3), 100, np.uint8)
    pixels[0] += 12
    mended = mend(wide_views(128, 8), [*pixels], "close", "unknown")
    assert mended.report["faded_px"] == 8
    row = mended.pixels[0][72, :, 0].astype(int)
    x = (np.arange(144) + 0.5 - 72) / 64  # of the face, in half widths
    own = 1.125 - np.abs(x)
    other = np.maximum(1.125 - 1 / np.maximum(np.abs(x), 1e-9), 0)
    assert np.abs(row - (100 + 12 * own / (own + other))).max() <= 0.5 + 1e-3  # rounded
    assert mended.report["steps_after"]["worst"] < 1  # a row of the ramp
    agreeing = np.full((6, 144, 144, 3), 100, np.uint8)
    assert (np.stack(mend(wide_views(128, 8), [*agreeing], "close", "unknown").pixels) == 100).all()


@pytest.mark.parametrize("drift", [1.0, 0.0])
def test_gains_and_vignette_from_overscan(room_with_overscan, drift):
    """Exposure and Unreal's vignette before the tone: both are found, and the truth is had back.

    A vignette alone has no step at the edges.
    """
    wide, true = room_with_overscan
    x = (np.arange(144) + 0.5) / 72 - 1
    loss = (1 + 0.16 * (x[None] ** 2 + x[:, None] ** 2)) ** -2
    gains = 0.6 * GAINS**drift  # nothing clips
    dark = exposed(true, [gain * loss for gain in gains])
    mended = mend(wide, [*dark], "gains", "srgb")
    expected = np.exp(np.log(gains).mean()) / gains
    np.testing.assert_allclose(mended.report["gains"], expected, rtol=0.005)
    assert abs(mended.report["vignette"] - (1 - 1.32**-2)) < 0.01
    due = exposed(true, [np.exp(np.log(gains).mean())] * 6)
    usable = (due < 250) & (dark > 16)  # of rounded codes below, one level is a tenth of the light
    assert np.abs(np.stack(mended.pixels).astype(float) - due)[usable].mean() < 0.7
    unharmed = mend(wide, [*true], "gains", "srgb")
    assert "gains explain" in unharmed.report["refused"]


def test_places_of_a_recording_show_the_vignette_together(tmp_path):
    """Without overscan: no step, but a crease at each edge. The doctor says it, and gains take it out."""
    places = [(0.1, -0.7, 1.1), (0.6, 0.5, 1.5)]
    x = (np.arange(128) + 0.5) / 64 - 1
    camera = omniscv.cameras.create("equirectangular", 128, 64)
    pose = Pose.from_angles(places[0])
    found = {}
    images = {}
    for strength in (0.0, 0.16):
        path = tmp_path / f"{strength}.sqlite"
        loss = (1 + strength * (x[None] ** 2 + x[:, None] ** 2)) ** -2
        for at in places:
            lit = exposed(faces(128, 1, scene="six-wall", center=at), [loss] * 6)
            store(path, zip(views(128, center=at), ["lit"] * 6, lit, strict=True), "srgb")
        with RecordedSource(path) as source:
            found[strength] = {each.name: each for each in examine_recording(source)}["vignette"].value
            images[strength] = omniscv.render(camera, pose, source, seams="gains")
    assert found[0.0] == "none is proven"
    assert "refused" in images[0.0].provenance["seams"][0]
    assert found[0.16] in ("corners 42% darker than the middle", "corners 43% darker than the middle")
    assert np.abs(images[0.16].lit.astype(float) - images[0.0].lit).mean() < 0.5


@pytest.fixture(scope="module")
def room_with_overscan():
    with open_scene("scene://four-wall?traces=0") as source:
        poses = [Pose((0.5, 0, 1.4), each.pose.R_w_c) for each in wide_views(128, 8)]
        wide = [View(pose, wide_views(128, 8)[0].fov_deg, 144, 144) for pose in poses]
        return wide, np.stack([each.pixels for each in source.capture(Request(view, "lit") for view in wide)])


SLIP = "down", (0.24, 0, 0)


def test_a_turned_face_is_put_straight_in_every_mode(tmp_path):
    """The down face is turned by 0.24 degree: by 1.1 px in its middle. Its colours and masks both are."""
    straight, turned = ([*views(512, turn)] for turn in (None, SLIP))
    with open_scene("scene://four-wall?traces=0") as source:
        (true,) = source.capture([Request(straight[5], "lit")])
        mask, true_mask = source.capture([Request(each[5], "object_mask") for each in (turned, straight)])
    lit = zip(straight, ["lit"] * 6, faces(512, smooth=1, turned=SLIP), strict=True)
    store(tmp_path / "room.sqlite", [*lit, (straight[5], "object_mask", mask.pixels)])
    camera = omniscv.cameras.create("pinhole", 256, 256, fov_deg=87)
    pose = Pose(np.array(CENTER), straight[5].pose.R_w_c)
    x = (np.arange(256) + 0.5 - 128) / 128 * np.tan(np.radians(43.5))
    at = np.ix_(*[np.floor(256 * x + 256).astype(int)] * 2)
    color = {}
    wrong = {}
    with RecordedSource(tmp_path / "room.sqlite") as source:
        renderer = omniscv.Renderer(source)
        for straighten in (False, False, True):  # what is made twice of the same captures is kept
            options = omniscv.RenderOptions(filter="nearest", straighten=straighten)
            image = renderer.render(camera, pose, ("lit", "object_mask"), options)
            color[straighten] = np.abs(image.lit.astype(float) - true.pixels[at]).mean()
            wrong[straighten] = (image["object_mask"] != true_mask.pixels[at]).any(axis=-1).mean()
    assert color[True] < 0.8 * color[False]  # the rest is anti-aliasing, which the truth has not
    assert wrong[True] < 0.7 * wrong[False]  # the nearest pixel of a mask is up to half a pixel off


@pytest.fixture(scope="module")
def uneven(tmp_path_factory, room):
    path = tmp_path_factory.mktemp("uneven") / "room.sqlite"
    with Recording(open_scene("scene://four-wall"), path) as recording:
        truth = [Request(view, mode) for view in views(128) for mode in ("depth", "object_mask")]
        list(recording.capture(truth))
    store(path, zip(views(128), ["lit"] * 6, exposed(room, GAINS), strict=True))
    return path


def test_an_image_is_mended_in_colour_alone(uneven):
    camera = omniscv.cameras.create("equirectangular", 128, 64)
    pose = Pose.from_angles(CENTER, yaw_deg=45)
    modes = ("lit", "depth", "object_mask")
    with RecordedSource(uneven) as source:
        kept = omniscv.render(camera, pose, source, modes)
        mended = omniscv.render(camera, pose, source, modes, seams="close")
        narrow = omniscv.cameras.create("pinhole", 64, 64, fov_deg=60)
        front = omniscv.render(narrow, Pose.from_angles(CENTER), source, seams="close")
    for layer in ("depth", "labels", "object_mask", "depth_error"):
        np.testing.assert_array_equal(kept[layer], mended[layer])
    change = np.abs(kept.lit.astype(int) - mended.lit).max(axis=-1)
    assert mended["relit"][change > 0].all()
    assert change[mended["relit"]].mean() > 1
    (report,) = mended.provenance["seams"]
    assert report["steps_after"]["median"] < 0.5 < report["steps"]["median"]
    with RecordedSource(uneven) as source:
        alone = omniscv.render(camera, pose, source, seams="close")
    np.testing.assert_array_equal(alone.lit, mended.lit)  # the recording's masks count, asked for or not
    # A camera that sees one face gets the colours of the whole cube.
    np.testing.assert_allclose(front.lit[32, 32].astype(float), mended.lit[32, 80].astype(float), atol=12)
    assert front["relit"].any()


def test_faces_of_several_places_are_not_mended():
    """Front and back are those of another instant: their texture is 3 px away, along every edge."""
    one = faces(512, smooth=1, scene="waves")
    moved = one.copy()
    for face in (0, 2):
        moved[face] = np.roll(one[face], (3, 3), axis=(0, 1))
    for method in ("gains", "close"):
        mended = mend([*views(512)], [*moved], method, "srgb")
        assert "texture that moves by 3" in mended.report["refused"]
        assert (np.stack(mended.pixels) == moved).all()
    assert "texture" not in mend([*views(512)], [*one], "close", "srgb").report.get("refused", "")


def test_a_face_that_two_edges_do_not_show_has_no_gain(room):
    darkened = exposed(room, GAINS)
    for side in range(3):
        np.rot90(darkened[5], side)[:2] = 2
    assert not estimate_gains(cube(darkened), "srgb").proven
    assert "gains explain" in mend([*views(128)], [*darkened], "gains", "srgb").report["refused"]


def test_what_is_outside_the_field_of_view_and_what_is_no_cube_stays():
    camera = omniscv.cameras.create("fisheye-equidistant", 48, 48, fov_deg=170)
    pose = Pose.from_angles(CENTER)
    narrow = omniscv.cameras.create("pinhole", 32, 32, fov_deg=60)
    with open_scene("scene://four-wall?traces=0") as source:
        round_ = omniscv.render(camera, pose, source, seams="gains")
        image, kept = (omniscv.render(narrow, pose, source, seams=seams) for seams in ("close", "keep"))
    assert not round_.valid.all()
    assert not round_["relit"][~round_.valid].any()
    np.testing.assert_array_equal(image.lit, kept.lit)
    assert image.provenance["seams"] == [{"refused": "expected six 8-bit faces of a cube"}]


def test_the_doctor_examines_recordings(uneven, capsys, tmp_path):
    with RecordedSource(uneven) as source:
        found = {finding.name: finding for finding in examine_recording(source)}
    assert found["seams"].verdict == "bad"
    assert "differs by up to 1.5" in found["exposure"].value  # 1.25 / 0.8 = 1.56
    assert cli.run(["doctor", str(uneven), "--picture", str(tmp_path / "worst.png")]) == 1
    assert "seams: close" in capsys.readouterr().out
    rows = np.asarray(Image.open(tmp_path / "worst.png")).astype(float).mean(axis=-1)
    changes = np.abs(np.diff(rows, axis=0)).mean(axis=1)
    assert rows.shape == (128, 128)
    assert changes[63] > 3 * max(changes[62], changes[64])  # the edge, in the middle
    assert cli.run(["doctor", "mock://four-wall", "--picture", str(tmp_path / "no.png")]) == 2
    assert "expected a recording" in capsys.readouterr().err
