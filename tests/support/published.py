"""Writers of published layouts of frames with poses: they share no formula with the importer."""

import json

import cv2
import numpy as np
import OpenImageIO
from scipy.spatial.transform import Rotation

from omniscv.geometry import Pose
from omniscv.sources import Lens, View
from support.pictured import AT, SCENE, THERE, face, panorama, put, seen

EDGE = 64
TURNED = Pose.from_angles(AT, 30, 10, 5)
RIGS = [TURNED, Pose.from_angles(THERE, -100)]
THREE = [Pose.from_angles(AT, 0, 10, 5), TURNED, Pose.from_angles(THERE)]


def matrix(R, t):
    return np.vstack([np.column_stack([R, t]), [0, 0, 0, 1]])


def scaled(values, per_m):
    return np.uint16(np.round(values * per_m))


def tartanair(folder, poses):
    """Floats in the bytes of a PNG, ids of classes; bodies (ahead, right, down) in axes north, east, down."""
    ned = np.array([1.0, -1.0, -1.0])
    lines = {}
    for word in ("front", "right", "back", "left", "top", "bottom"):
        for i, pose in enumerate(poses):
            view = face(pose, {"top": "up", "bottom": "down"}.get(word, word), EDGE)
            lit, planar, labels = seen(view)
            put(folder / f"image_lcam_{word}/{i:06}_lcam_{word}.png", lit)
            put(folder / f"seg_lcam_{word}/{i:06}_lcam_{word}_seg.png", np.uint8(labels + 40))
            depth = folder / f"depth_lcam_{word}/{i:06}_lcam_{word}_depth.png"
            depth.parent.mkdir(exist_ok=True)
            assert cv2.imwrite(str(depth), planar.view(np.uint8).reshape(EDGE, EDGE, 4))
            turn = Rotation.from_matrix(ned[:, None] * view.pose.R_w_c[:, [2, 0, 1]]).as_quat()
            line = " ".join(f"{v:.9f}" for v in (*pose.position * ned, *turn))
            lines.setdefault(word, []).append(f"{line}\n")
        (folder / f"pose_lcam_{word}.txt").write_text("".join(lines[word]))
    names = {name: 41 + i for i, name in enumerate(SCENE.objects)}
    (folder.parent / "seg_label_map.json").write_text(json.dumps({"name_map": names}))


def tartanground(folder, poses):
    """As TartanAir V2, and a file of metadata."""
    tartanair(folder, poses)
    (folder / "P0000_metadata.json").write_text("{}")


def ob3d(folder, poses):
    """Depth along the ray in three channels; poses are world to camera."""
    (folder / "cameras").mkdir(parents=True)
    (folder / "depths").mkdir()
    for i, pose in enumerate(poses):
        lit, distance, _ = panorama(pose)
        put(folder / f"images/{i:05}_rgb.png", lit)
        buffer = OpenImageIO.ImageBuf(np.repeat(distance[..., None].astype(np.float32), 3, axis=-1))
        assert buffer.write(str(folder / f"depths/{i:05}_depth.exr"), "float")
        outer = {"rotation": pose.R_w_c.T.tolist(), "translation": (-pose.R_w_c.T @ pose.position).tolist()}
        (folder / f"cameras/{i:05}_cam.json").write_text(json.dumps([{"extrinsics": outer}]))


def structured3d(folder, poses):
    (pose,) = poses
    full = folder / "2D_rendering/485/panorama/full"
    lit, distance, labels = panorama(pose)
    layers = {"rgb_rawlight": lit, "depth": scaled(distance, 1000), "semantic": np.uint8(labels)}
    for name, pixels in (layers | {"instance": np.uint16(labels)}).items():
        put(full / f"{name}.png", pixels)
    (full.parent / "camera_xyz.txt").write_text(" ".join(str(1000 * v) for v in pose.position))


def two_d_three_ds(folder, poses):
    """Depth in 1/512 m (65535: none), labels as base 256 in RGB; poses are world to camera."""
    (pose,) = poses
    name = "camera_0_office_1_frame_equirectangular_domain"
    lit, distance, labels = panorama(pose)
    depth = scaled(np.where(np.isfinite(distance), distance, 65535 / 512), 512)
    ids = np.dstack([0 * labels, labels >> 8, labels & 255]).astype(np.uint8)
    for kind, pixels in (("rgb", lit), ("depth", depth), ("semantic", ids)):
        put(folder / f"pano/{kind}/{name}_{kind}.png", pixels)
    rows = np.column_stack([pose.R_w_c.T, -pose.R_w_c.T @ pose.position]).tolist()
    (folder / "pano/pose").mkdir()
    (folder / f"pano/pose/{name}_pose.json").write_text(
        json.dumps({"camera_location": pose.position.tolist(), "camera_rt_matrix": rows})
    )
    (folder.parent / "assets").mkdir()
    labels = json.dumps(["<UNK>", *sorted(SCENE.objects)])
    (folder.parent / "assets" / "semantic_labels.json").write_text(labels)


def replica(folder, views):
    K = {"w": EDGE, "h": EDGE, "fx": 32.0, "fy": 32.0, "cx": 31.5, "cy": 31.5, "scale": 6553.5}
    for i, view in enumerate(views):
        put(folder / f"results/frame{i:06d}.png", seen(view)[0])
        put(folder / f"results/depth{i:06d}.png", scaled(seen(view)[1], 6553.5))
    (folder.parent / "cam_params.json").write_text(json.dumps({"camera": K}))
    rows = [matrix(view.pose.R_w_c, view.pose.position) for view in views]
    np.savetxt(folder / "traj.txt", np.reshape(rows, (-1, 16)))


def scannet(folder, views):
    """Depth has its own size; a pose that was lost is infinite."""
    (folder / "intrinsic").mkdir(parents=True)
    (folder / "pose").mkdir()
    K = np.eye(4)
    K[:2, :3] = [[32, 0, 31.5], [0, 32, 31.5]]
    np.savetxt(folder / "intrinsic/intrinsic_color.txt", K)
    for i, view in enumerate([views[0], *views]):
        put(folder / f"color/{i}.png", seen(view)[0])
        put(folder / f"depth/{i}.png", scaled(seen(view)[1][1::2, 1::2], 1000))
        pose = matrix(view.pose.R_w_c, view.pose.position) if i else np.full((4, 4), -np.inf)
        np.savetxt(folder / f"pose/{i}.txt", pose)


def kitti(folder, views):
    """Poses of camera 0; camera 2 is 6 cm to its right."""
    K = np.array([[32, 0, 31.5], [0, 32, 31.5], [0, 0, 1]])
    right = np.array([0.06, 0, 0])
    for i, view in enumerate(views):
        put(folder / f"image_2/{i:06d}.png", seen(view)[0])
    rows = [np.column_stack([v.pose.R_w_c, v.pose.position - v.pose.R_w_c @ right]).ravel() for v in views]
    np.savetxt(folder / "poses.txt", rows)
    P0 = np.column_stack([K, np.zeros(3)])
    P2 = np.column_stack([K, -K @ right])
    lines = [f"{name}: " + " ".join(map(str, P.ravel())) for name, P in (("P0", P0), ("P2", P2))]
    (folder / "calib.txt").write_text("\n".join(lines) + "\n")


def icl_nuim(folder, views):
    """POV-Ray's left-handed axes: x right, y up, z ahead."""
    W = np.array([[0, 0, 1], [-1, 0, 0], [0, 1, 0]])
    C = np.diag([1, -1, 1])
    lines = []
    for i, view in enumerate(views):
        put(folder / f"rgb/{i}.png", seen(view)[0])
        put(folder / f"depth/{i}.png", scaled(seen(view)[1], 5000))
        own = Pose(W.T @ view.pose.position, W.T @ view.pose.R_w_c @ C)
        lines.append(f"{i} " + " ".join(map(str, [*own.position, *own.quaternion()])))
    (folder / "livingRoom0.gt.freiburg").write_text("\n".join(lines))


def tum(folder, views, word="freiburg3"):
    """Stamps that never coincide, and a picture without a pose."""
    lines = {"rgb": [f"# file: 'rgbd_dataset_{word}_x.bag'"], "depth": ["#"], "groundtruth": ["#"]}
    for i, view in enumerate(views):
        put(folder / f"rgb/{i}.png", seen(view)[0])
        put(folder / f"depth/{i}.png", scaled(seen(view)[1], 5000))
        lines["rgb"].append(f"{i}.000 rgb/{i}.png")
        lines["depth"].append(f"{i}.013 depth/{i}.png")
        pose = [*view.pose.position, *view.pose.quaternion()]
        lines["groundtruth"].append(f"{i}.007 " + " ".join(map(str, pose)))
    lines["rgb"].append("9 rgb/0.png")
    for name, rows in lines.items():
        (folder / f"{name}.txt").write_text("\n".join(rows) + "\n")


def views(poses, f=(1.0, 1.0), c=(0.5, 0.5), size=(EDGE, EDGE)):
    """Views of a lens with pixel centres at +.5, relative to a width of 2 and to the size."""
    fov_deg = 2 * np.degrees(np.arctan(1 / f[0]))
    lens = Lens(f[1] / f[0], c[0] - 0.5, c[1] - 0.5)
    return [View(pose, fov_deg, *size, None if lens == Lens() else lens) for pose in poses]


ICL = {"f": (481.2 / 320, 480 / 320), "size": (80, 60)}
TUM = {"f": (535.4 / 320, 539.2 / 320), "c": (320.6 / 640, 248.1 / 480), "size": (80, 60)}
"""ROS's centres are whole numbers."""
PANORAMAS = {
    "tartanair": (tartanair, RIGS, "12 of lit", ("lit", "object_mask", "depth")),
    "tartanground": (tartanground, RIGS, "of lit", ("lit", "object_mask")),
    "ob3d": (ob3d, RIGS, "2 of lit, 2 of depth", ("lit", "depth")),
    "structured3d": (
        structured3d,
        [Pose.from_angles(AT, -90)],
        "1 semantic.png are not taken",
        ("lit", "depth"),
    ),
    "2d3ds": (two_d_three_ds, [Pose.from_angles(AT, 40, 5, -3)], "of depth", ("lit", "object_mask", "depth")),
}
FLAT = {
    "replica": (replica, views(THREE), "3 of lit, 3 of depth", 6553.5),
    "scannet": (scannet, views(THREE), "1 frames left out", None),
    "kitti": (kitti, views(THREE), "3 of lit", None),
    "icl-nuim": (icl_nuim, views(THREE, **ICL), "3 of depth", 5000),
    "tum": (tum, views(THREE, **TUM), "1 pictures left out: no pose within 0.02 s", 5000),
}
"""By name the writer, what it writes, what is said of it, and modes, or the unit of depth."""
