"""Read exports with other programs, and compare what they find with the truth; see scripts/test-consumers."""

import sys
from itertools import pairwise
from pathlib import Path

import gtsam
import numpy as np
import pycolmap
import supervision
import yaml
from evo.core import metrics, sync
from evo.core.trajectory import PoseTrajectory3D
from evo.tools import file_interface
from kiss_icp.config import load_config
from kiss_icp.kiss_icp import KissICP
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from PIL import Image
from pycocotools import mask as cocomask
from pycocotools.coco import COCO
from rosbags import highlevel
from scipy import ndimage

FOLDER = Path(sys.argv[1])
failed = []


def judge(name, found, most, unit):
    """Print a figure, and remember whether it is within its bound."""
    print(f"{name}: {found:.3g} {unit} (at most {most:g})")
    if not found <= most:
        failed.append(name)


def off(reference, estimate, scale=False):
    """The root mean square of the distances after alignment, and the length of the path, metres."""
    estimate.align(reference, correct_scale=scale)
    error = metrics.APE(metrics.PoseRelation.translation_part)
    error.process_data((reference, estimate))
    return error.get_statistic(metrics.StatisticsType.rmse), reference.path_length


def table(path):
    """Stamps and numbers of a table of EuRoC's."""
    rows = [line.split(",") for line in path.read_text().splitlines()[1:]]
    return np.array([int(row[0]) for row in rows]), np.array([[float(x) for x in row[1:]] for row in rows])


def scans():
    """KISS-ICP, with the seconds of the points and without."""
    root = FOLDER / "scan/exports/kitti_lidar"
    calib = dict(line.split(": ") for line in (root / "calib.txt").read_text().splitlines())
    rows = [np.array(calib["Tr"].split(), float), *np.loadtxt(root / "poses.txt")]
    Tr, *poses = [np.vstack([row.reshape(3, 4), [0, 0, 0, 1]]) for row in rows]
    truth = [np.linalg.inv(Tr) @ pose @ Tr for pose in poses]
    times, shares = np.loadtxt(root / "times.txt"), []
    for deskew in (True, False):
        config = load_config(None)
        config.data.deskew, config.data.max_range, config.data.min_range = deskew, 20.0, 0.3
        config.mapping.voxel_size = 0.1
        odometry, found = KissICP(config), []
        for i in range(len(truth)):
            points = np.fromfile(root / f"velodyne/{i:06d}.bin", np.float32).reshape(-1, 4)[::4, :3]
            seconds = np.fromfile(root / f"seconds/{i:06d}.bin", np.float32)[::4].astype(float)
            odometry.register_frame(points.astype(float), 10 * seconds if deskew else np.zeros(0))
            found.append(odometry.last_pose.copy())
        last, errors = len(truth) - 1, []
        for late in (0, 1):  # its poses are of a scan's beginning, or of its end: the next one's beginning
            reference = PoseTrajectory3D(poses_se3=truth[late : last + late], timestamps=times[:last])
            estimate = PoseTrajectory3D(
                poses_se3=[np.copy(pose) for pose in found[:last]], timestamps=times[:last]
            )
            rms, length = off(reference, estimate)
            errors.append(100 * rms / length)
        shares.append(min(errors))
    judge("KISS-ICP, deskewed", shares[0], 0.5, "% of the path")
    judge("KISS-ICP, deskewed against not deskewed", shares[0] / shares[1], 1, "of its error")


def bags():
    """rosbags and mcap read every message."""
    bag, count = FOLDER / "scan/exports/rosbag2/bag", 0
    with highlevel.AnyReader([bag]) as reader:
        for connection, _, data in reader.messages():
            reader.deserialize(data, connection.msgtype)
            count += 1
    with next(bag.glob("*.mcap")).open("rb") as file:
        decoded = sum(
            1 for _ in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        )
    judge("messages that rosbags and mcap read differently", abs(count - decoded), 0, f"of {count}")


def trajectories():
    """evo reads EuRoC, TUM and KITTI, and joins all rows."""
    poses = FOLDER / "eyes/exports/poses"
    euroc = file_interface.read_euroc_csv_trajectory(str(poses / "left.euroc"))
    tum = file_interface.read_tum_trajectory_file(str(poses / "left.tum"))
    kitti = file_interface.read_kitti_poses_file(str(poses / "left.kitti"))
    one, other = sync.associate_trajectories(euroc, tum)
    judge("rows that evo does not join", euroc.num_poses - one.num_poses, 0, f"of {euroc.num_poses}")
    judge("evo, TUM against EuRoC", off(one, other)[0], 1e-9, "m")
    relative = PoseTrajectory3D(poses_se3=kitti.poses_se3, timestamps=euroc.timestamps)
    judge("evo, KITTI against EuRoC", off(euroc, relative)[0], 1e-9, "m")


def preintegration():
    """GTSAM, from the stamp of each image of the example to the next."""
    root, worst = FOLDER / "eyes/exports/euroc/mav0", 0.0
    stamps, measured = table(root / "imu0/data.csv")
    _, states = table(root / "state_groundtruth_estimate0/data.csv")
    images = range(stamps[0], stamps[-1] + 1, 100_000_000)  # those of the example
    bias = gtsam.imuBias.ConstantBias()
    for start, end in pairwise(images):
        i, j = np.searchsorted(stamps, [start, end])
        found = gtsam.PreintegratedImuMeasurements(gtsam.PreintegrationParams.MakeSharedU(9.81), bias)
        for k in range(i, j):
            middle = (measured[k] + measured[k + 1]) / 2
            found.integrateMeasurement(middle[3:], middle[:3], (stamps[k + 1] - stamps[k]) / 1e9)
        position, turn, velocity = states[i, :3], gtsam.Rot3.Quaternion(*states[i, 3:7]), states[i, 7:10]
        reached = found.predict(gtsam.NavState(turn, gtsam.Point3(*position), velocity), bias).position()
        worst = max(worst, np.linalg.norm(reached - states[j, :3]) / ((end - start) / 1e9))
    judge("GTSAM, preintegrated", 1e3 * worst, 1, "mm a second")


def motion():
    """Structure from motion by COLMAP, with our intrinsics."""
    root, work = FOLDER / "eyes/exports/colmap", FOLDER / "colmap"
    work.mkdir()
    model = pycolmap.Reconstruction(str(root / "sparse/0"))
    truth = {image.name: image.cam_from_world().inverse().matrix() for image in model.images.values()}
    (camera,) = model.cameras.values()
    reading, mapping = pycolmap.ImageReaderOptions(), pycolmap.IncrementalPipelineOptions()
    reading.camera_model, reading.camera_params = camera.model.name, ",".join(map(str, camera.params))
    mapping.ba_refine_focal_length = mapping.ba_refine_extra_params = False
    database, images = work / "database.db", root / "images"
    single = pycolmap.CameraMode.SINGLE
    pycolmap.extract_features(database, images, camera_mode=single, reader_options=reading)
    pycolmap.match_exhaustive(database)
    models = pycolmap.incremental_mapping(database, images, work, mapping)
    found = max(models.values(), key=lambda each: each.num_reg_images())
    poses = {i.name: i.cam_from_world().inverse().matrix() for i in found.images.values() if i.has_pose}
    judge("images that COLMAP does not place", len(truth) - len(poses), 0, f"of {len(truth)}")
    names, last = sorted(poses), [[0, 0, 0, 1]]
    pair = (
        PoseTrajectory3D(
            poses_se3=[np.vstack([of[n], last]) for n in names], timestamps=np.arange(len(names))
        )
        for of in (truth, poses)
    )
    rms, length = off(*pair, scale=True)
    judge("COLMAP, structure from motion", 100 * rms / length, 0.3, "% of the path")


def things():
    """Masks and boxes that pycocotools and supervision read, against the layer of labels."""
    root, off, whole, seen = FOLDER / "things", [0, 0.0], {}, {}
    coco = COCO(root / "exports/coco/annotations.json")
    for image in coco.loadImgs(coco.getImgIds()):
        labels = np.array(Image.open(root / f"{image['key']}.labels.png"))
        for each in coco.loadAnns(coco.getAnnIds(image["id"])):
            mask, code = labels == each["instance_id"], coco.annToRLE(each)
            off[0] += np.sum(mask != coco.annToMask(each)) + abs(mask.sum() - cocomask.area(code))
            rows, columns = np.nonzero(mask)
            box = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
            corners = np.array(each["bbox"]) + np.pad(each["bbox"][:2], (2, 0))
            off[1] = max(off[1], np.abs(corners - box).max())
            name = coco.cats[each["category_id"]]["name"]
            whole.setdefault(image["key"], []).append((name, np.array(box), mask))
    judge("pixels of masks that pycocotools has otherwise", off[0], 0, "px")
    judge("boxes that pycocotools has otherwise", off[1], 0, "px")
    for task in ("detect", "segment"):
        data = root / "exports" / task / "data.yaml"
        for split in {"train", "test"} & yaml.safe_load(data.read_text()).keys():
            folders = (str(data.parent / kind / split) for kind in ("images", "labels"))
            read = supervision.DetectionDataset.from_yolo(*folders, str(data), force_masks=task == "segment")
            for path, _, found in read:
                names = [read.classes[number] for number in found.class_id]
                seen[task, Path(path).stem] = names, found.xyxy, found.mask
    worst, wrong = 0.0, 0
    for key, objects in whole.items():
        if not key.startswith("fisheye"):
            continue
        (names, boxes, _), (same, _, masks) = seen["detect", key], seen["segment", key]
        wrong += abs(len(objects) - len(names)) + abs(len(objects) - len(same))
        for name, box, mask in objects:
            mine = [np.abs(boxes[i] - box).max() for i in range(len(names)) if names[i] == name]
            worst = max(worst, min(mine, default=np.inf))
            parts, _ = ndimage.label(mask, np.ones((3, 3)))
            largest = ndimage.binary_fill_holes(parts == np.argmax(np.bincount(parts[mask])))
            mine = [np.sum(masks[i] != largest) for i in range(len(same)) if same[i] == name]
            wrong += min(mine, default=mask.sum())
    judge("boxes that supervision has otherwise", worst, 1e-3, "px")
    judge("rows, and pixels of masks, that supervision has otherwise", wrong, 0, "px")


for part in (things, trajectories, bags, preintegration, scans, motion):
    part()
sys.exit(f"beyond their bounds: {', '.join(failed)}" if failed else 0)
