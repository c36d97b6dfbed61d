"""HorizonNet, CFL and Structured3D, read back by the checks and readers that people use, written out."""

import json

import numpy as np
import pytest
from PIL import Image
from support.rooms import L_SHAPE, PLAIN, frame, plain_frame, room_of_plan, scene_of_plan

from omniscv import Pose, cameras
from omniscv.dataset import exporting
from omniscv.errors import ArgumentError
from omniscv.frame.classes import ClassTable, SemanticClass
from omniscv.truth import project_layout
from omniscv.truth.metrics import map_scores

PANORAMA = cameras.create("equirectangular", 1024, 512)
SMALL = cameras.create("equirectangular", 128, 64)
LEVEL = Pose.from_angles((0, 0, 1.5))

KNOWN_CORNERS = """159.670 199.103
159.670 319.752
351.330 199.103
351.330 319.752
671.670 199.103
671.670 319.752
863.330 199.103
863.330 319.752
"""


def write(name, frames, out, **options):
    return exporting.get(name).export(frames, out, options)


# -- HorizonNet -----------------------------------------------------------------------------------------


def test_the_known_room_has_the_known_lines(tmp_path):
    files = write("horizonnet", [plain_frame(tmp_path, "a", PANORAMA, LEVEL)], tmp_path / "out")
    assert [path.relative_to(tmp_path / "out").as_posix() for path in files] == [
        "img/a.png",
        "label_cor/a.txt",
    ]
    assert files[1].read_text() == KNOWN_CORNERS


def test_horizonnet_refuses_tilted_cameras_and_other_rooms(tmp_path):
    leaning = plain_frame(tmp_path, "b", SMALL, Pose.from_angles((0, 0, 1.5), pitch_deg=4))
    with pytest.raises(ArgumentError, match="b: expected an upright camera, got pitch 4"):
        write("horizonnet", [leaning], tmp_path / "out")
    record = project_layout(room_of_plan(PLAIN), SMALL, LEVEL)
    record["corners"][6]["world"][2] = 3.3
    with pytest.raises(ArgumentError, match="c: layout: expected a room of upright walls"):
        write("horizonnet", [frame(tmp_path, "c", SMALL, LEVEL, record)], tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("kind", "lit"), [("png", np.uint8), ("jpg", np.uint8), ("png", np.float32)])
def test_colours_come_as_wanted_from_whatever_the_frame_has(tmp_path, kind, lit):
    colours = np.arange(64 * 128 * 3, dtype=np.uint32).reshape(64, 128, 3) // 97
    record = project_layout(room_of_plan(PLAIN), SMALL, LEVEL)
    shade = (colours % 256).astype(np.uint8)
    light = np.where(
        shade <= 10, shade / 255 / 12.92, ((shade / 255 + 0.055) / 1.055) ** 2.4
    )  # IEC 61966-2-1
    layers = {"lit": shade if lit is np.uint8 else light.astype(np.float32)}
    seen = frame(tmp_path, "a", SMALL, LEVEL, record, layers)
    (path, _) = write("horizonnet", [seen], tmp_path / "out", image_format=kind)
    assert path.name == f"a.{kind}"
    found = np.asarray(Image.open(path)).astype(int)
    assert np.abs(found - shade).mean() <= (0 if kind == "png" else 4)


# -- CFL ------------------------------------------------------------------------------------------------


def test_cfl_pairs_its_files_by_order_and_scores_the_reference(tmp_path):
    frames = [plain_frame(tmp_path, key, PANORAMA, LEVEL) for key in ("a", "b")]
    write("cfl", frames, tmp_path / "out")
    names = {folder: sorted(path.name for path in (tmp_path / "out" / folder).glob("*.jpg"))
             for folder in ("RGB", "EM_gt", "CM_gt")}  # fmt: skip
    assert names == {
        "RGB": ["a.jpg", "b.jpg"],
        "EM_gt": ["a_EM.jpg", "b_EM.jpg"],
        "CM_gt": ["a_CM.jpg", "b_CM.jpg"],
    }
    for folder, recall in (("EM_gt", 0.728), ("CM_gt", 0.522)):
        picture = np.asarray(Image.open(tmp_path / "out" / folder / names[folder][0]))
        assert (picture.shape, picture.dtype) == ((512, 1024), np.uint8)
        scores = map_scores(np.asarray(Image.fromarray(picture).resize((256, 128))) / 255, picture)
        assert scores.precision == 1
        assert scores.recall == pytest.approx(recall, abs=0.01)  # of JPEG


def test_cfl_takes_every_camera_and_its_options(tmp_path):
    names = "equirectangular", "noncentral-conical-mirror", "orthographic", "pinhole"
    frames = [plain_frame(tmp_path, name, cameras.model(name).example(64), LEVEL) for name in names]
    options = {"image_format": "png", "visibility": "all", "layout": {"maps": {"corner_sigma": 0.02}}}
    files = write("cfl", frames, tmp_path / "out", **options)
    assert len(files) == 3 * len(frames)
    drawn = [np.asarray(Image.open(path)).any() for path in files if "EM_gt" in path.parts]
    seen = [any(edge["pieces"] for edge in frame.layout["edges"]) for frame in frames]
    assert drawn == seen  # parallel rays see a piece of one wall
    assert sum(seen) >= len(frames) - 1
    original = write("cfl", frames[:1], tmp_path / "o", recipe="original", image_format="png")
    assert not np.array_equal(np.asarray(Image.open(original[1])), np.asarray(Image.open(files[1])))


# -- Structured3D ---------------------------------------------------------------------------------------


def panorama_of(folder, key, scene, plan, pose, camera=SMALL, **more):
    """A frame with what a perfect panorama of a scene shows."""
    rays = camera.unproject()
    hits = scene.trace(pose.position, rays.directions @ pose.R_w_c.T)
    layers = {"depth": hits.distance.astype(np.float32), "labels": hits.label}
    names = {name: scene.label(name) for name in scene.objects}
    return frame(
        folder, key, camera, pose, project_layout(room_of_plan(plan), camera, pose), layers, names, **more
    )


def points_of(folder):
    """(H, W, 3) mm: RoomFormer's reader of panoramas, with its half pixel put right."""
    depth = np.asarray(Image.open(folder / "full" / "depth.png")).astype(float)
    camera_xyz = np.loadtxt(folder / "camera_xyz.txt")
    height, width = depth.shape
    beta = np.radians(360 * (np.arange(width) + 0.5) / width - 180)
    alpha = np.radians(90 - 180 * (np.arange(height) + 0.5) / height)[:, None]
    away = np.stack(
        np.broadcast_arrays(np.cos(alpha) * np.sin(beta), np.cos(alpha) * np.cos(beta), np.sin(alpha)), -1
    )
    return depth[..., None] * away + camera_xyz


@pytest.mark.parametrize("yaw_deg", [0, 40])
def test_points_of_panoramas_lie_on_the_planes_of_their_scene(tmp_path, yaw_deg):
    scene = scene_of_plan(L_SHAPE)
    poses = [Pose.from_angles(at, yaw_deg=yaw_deg) for at in ((0.5, -0.5, 1.5), (3, -1, 1.2))]
    frames = [panorama_of(tmp_path, key, scene, L_SHAPE, pose) for key, pose in zip("ab", poses, strict=True)]
    files = write("structured3d", frames, tmp_path / "out")
    assert all(path.is_file() for path in files)
    top = tmp_path / "out" / "scene_00000"
    planes = json.loads((top / "annotation_3d.json").read_text())["planes"]
    normals, offsets = np.array([p["normal"] for p in planes]), np.array([p["offset"] for p in planes])
    kinds = np.array([p["type"] for p in planes])
    for number in ("0", "1"):
        folder = top / "2D_rendering" / number / "panorama"
        points = points_of(folder)
        off = np.abs(points @ normals.T + offsets)
        assert off.min(axis=-1).max() <= 1.0
        names = {1: "wall", 2: "floor", 22: "ceiling"}
        semantic = np.asarray(Image.open(folder / "full" / "semantic.png"))
        clear = np.sort(off, axis=-1)[..., 1] > 2
        found = kinds[off.argmin(axis=-1)]
        assert all(names[i] == kind for i, kind in zip(semantic[clear], found[clear], strict=True))
        inward = points @ normals.T + offsets  # a plane's normal points to the empty side
        assert inward[..., kinds == "floor"].min() >= -1
        assert inward[..., kinds == "ceiling"].min() >= -1
    assert (top / "2D_rendering" / "0" / "panorama" / "layout.txt").read_text().count("\n") == 12
    listed = (tmp_path / "out" / "README.txt").read_text()
    assert "0 a\n1 b\n" in listed
    assert "along +y" in listed


def test_the_annotation_joins_planes_lines_and_junctions(tmp_path):
    scenes = [(L_SHAPE, (0.5, -0.5, 1.5)), (PLAIN, (0, 0, 1.5)), (L_SHAPE, (3, -1, 1.2))]
    frames = [
        plain_frame(tmp_path, f"f{i}", SMALL, Pose.from_angles(at), plan)
        for i, (plan, at) in enumerate(scenes)
    ]
    write("structured3d", frames, tmp_path / "out")
    found = json.loads((tmp_path / "out" / "scene_00000" / "annotation_3d.json").read_text())
    on_plane, on_line = np.array(found["planeLineMatrix"]), np.array(found["lineJunctionMatrix"])
    counts = [len(found[kind]) for kind in ("planes", "lines", "junctions")]
    assert counts == [6 + 2 + 4 + 2, 18 + 12, 12 + 8]
    assert on_plane.shape == tuple(counts[:2])
    assert on_line.shape == tuple(counts[1:])
    assert (on_line.sum(axis=1) == 2).all()
    assert (on_plane.sum(axis=0) == 2).all()
    junctions = np.array([each["coordinate"] for each in found["junctions"]])
    for line, ends in zip(found["lines"], on_line.astype(bool), strict=True):
        away = np.cross(junctions[ends] - line["point"], line["direction"])
        assert np.abs(away).max() <= 1e-6
    for plane, lines in zip(found["planes"], on_plane.astype(bool), strict=True):
        mine = junctions[on_line[lines].any(axis=0)]
        assert np.abs(mine @ plane["normal"] + plane["offset"]).max() <= 0.1
    for kind in ("junctions", "lines", "planes", "semantics"):
        assert [each["ID"] for each in found[kind]] == list(range(len(found[kind])))
    assert [each["planeID"] for each in found["semantics"]] == [list(range(8)), list(range(8, 14))]
    assert {"cuboids", "manhattan"} <= found.keys()
    listed = (tmp_path / "out" / "README.txt").read_text().splitlines()
    assert listed[-3:] == ["0 f0", "1 f1", "2 f2"]


def test_layers_are_written_as_the_form_has_them(tmp_path):
    scene = scene_of_plan(PLAIN)
    seen = panorama_of(tmp_path, "a", scene, PLAIN, LEVEL)
    depth = seen.layer("depth").copy()
    depth[0, :3], depth[1, :3] = (np.inf, 0, 65.5349), (66, 70, 1e9)
    labels = seen.layer("labels").copy()
    labels[5, 5], labels[6, 6] = 77, 0
    names = {**seen.instances, "Chair": 77}
    classes = ClassTable({"chair": SemanticClass(5, "chair")}, {"Chair": "chair"}, "nyu40")
    layers = {"depth": depth, "labels": labels}
    seen = frame(tmp_path, "b", SMALL, LEVEL, seen.layout, layers, names, classes)
    write("structured3d", [seen], tmp_path / "out")
    full = tmp_path / "out" / "scene_00000" / "2D_rendering" / "0" / "panorama" / "full"
    millimetres = np.asarray(Image.open(full / "depth.png"))
    assert millimetres.dtype == np.uint16
    assert millimetres[0, :3].tolist() == [0, 0, 65535]
    assert millimetres[1, :3].tolist() == [0, 0, 0]
    assert np.abs(millimetres[2:] - 1000.0 * depth[2:]).max() <= 0.5 + 1e-3
    instance, semantic = (np.asarray(Image.open(full / f"{each}.png")) for each in ("instance", "semantic"))
    assert (instance.dtype, semantic.dtype) == (np.uint16, np.uint8)
    assert (instance[5, 5], semantic[5, 5]) == (77, 5)
    assert (instance[6, 6], semantic[6, 6]) == (65535, 0)
    assert (np.delete(instance.ravel(), 5 * 128 + 5) == 65535).all()


def test_structured3d_refuses_several_headings(tmp_path):
    frames = [
        plain_frame(tmp_path, key, SMALL, Pose.from_angles((0, 0, 1.5), yaw_deg=yaw))
        for key, yaw in (("a", 0), ("b", 10))
    ]
    with pytest.raises(ArgumentError, match=r"b: expected panoramas of one heading.*got yaws 0, 10"):
        write("structured3d", frames, tmp_path / "out")
