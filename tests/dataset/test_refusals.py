"""What formats and jobs of datasets refuse: options, cameras and keys, each in one line."""

from dataclasses import replace

import pytest
from support.datasets import job_file

from omniscv import cameras, dataset
from omniscv.errors import ArgumentError
from omniscv.job import load
from omniscv.make import make


@pytest.mark.parametrize(
    ("format", "options", "says"),
    [
        ("cfl", {"recipe": "canny"}, "recipe: expected one of exact, original; got 'canny'"),
        ("cfl", {"recipe": "original", "edge_sigma": 0.1}, "without others; got edge_sigma"),
        ("cfl", {"corner_sigma": 0}, "corner_sigma: expected a finite number > 0"),
        ("coco", {"seam": "cut"}, "seam: expected one of whole, split"),
        ("flow", {"gap": 0}, "gap: expected a whole number >= 1"),
        ("flow", {"tolerance": {"abs": 1}}, "tolerance: unknown key 'abs'; known keys: abs_m, rel"),
        ("nerfstudio", {"depth": True}, "unknown key 'depth'; known keys: max_relative_error"),
        ("ply", {"voxel": 0}, "voxel: expected a finite number > 0"),
    ],
)
def test_wrong_options(format, options, says):
    with pytest.raises(ArgumentError) as failed:
        dataset.get(format).read_options(options)
    assert says in str(failed.value)


REFUSED = {
    "colmap": ("noncentral-panorama", "scaramuzza", "cylindrical", "noncentral-spherical-mirror"),
    "euroc": ("equirectangular", "lidar"),
    "horizonnet": ("fisheye-equidistant",),
    "kitti_lidar": ("equirectangular", "rolling-shutter"),
    "kalibr": ("equirectangular", "cylindrical", "noncentral-conical-mirror"),
    "nerfstudio": ("noncentral-panorama", "scaramuzza", "cylindrical", "catadioptric-parabolic"),
    "poses": ("noncentral-panorama",),
    "structured3d": ("pinhole",),
}
CARRIED = {
    "cfl": cameras.names(),
    "colmap": ("equirectangular", "fisheye-equidistant", "kannala-brandt", "pinhole", "extended-unified"),
    "euroc": ("pinhole", "kannala-brandt"),
    "horizonnet": ("equirectangular",),
    "kitti_lidar": ("lidar",),
    "kalibr": ("pinhole",),
    "nerfstudio": ("equirectangular", "fisheye-equidistant", "kannala-brandt", "pinhole"),
    "poses": ("equirectangular",),
}


@pytest.mark.parametrize("format", sorted({*REFUSED, *CARRIED}))
def test_cameras_that_formats_carry(format):
    for name in REFUSED.get(format, ()):
        assert name in dataset.get(format).refuses(cameras.model(name).example(32))
    for name in CARRIED.get(format, ()):
        assert dataset.get(format).refuses(cameras.model(name).example(32)) is None, name


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ("export: [cocoa]", "export: format: expected one of"),
        ("export: [webdataset, webdataset]", "got 'webdataset' twice"),
        ("export: [{format: hf, out: ../x}]", "out: expected the name of a folder"),
        ("export: {webdataset: true}", "export: expected a list"),
        (
            "export: [{format: hf, cameras: [left]}]",
            "--camera, or 'cameras' in a job: expected one of pano, lens; got 'left'",
        ),
        ("export: [colmap, horizonnet]", "cannot carry camera 'lens'"),
        ("export: [{format: horizonnet, cameras: [pano]}]", "horizonnet: expected frames with layout"),
        ("truth: {boxen: true}", "truth: unknown key 'boxen'; known keys: poses, layout"),
        ("truth: {flow: {wrap: around}}", "wrap: expected one of shortest, classic"),
        ("truth: {tolerance: {abs_m: -1}}", "truth.tolerance.abs_m: expected a finite number >= 0"),
        ("layout: {source: guess}", "layout.source: expected one of scene, fitted"),
        ("media: {exif: true}", "media: unknown key 'exif'; known keys: xmp, north"),
        ("shard: {format: webdataset}", "unknown key 'shard'; known keys: source, poses"),
    ],
)
def test_jobs_are_refused_before_the_source_is_opened(more, says, tmp_path):
    """Opening this one would be another error."""
    with pytest.raises(ArgumentError) as failed:
        make(load(job_file(tmp_path, source="scene://nowhere", more=more + "\n")))
    assert says in str(failed.value)
    assert len(str(failed.value)) <= 1000
    assert not (tmp_path / "dataset").exists()


def test_classes_and_truths_need_their_modes(tmp_path):
    job = load(job_file(tmp_path, source="scene://nowhere"))
    with pytest.raises(ArgumentError, match="classes: expected modes with object_mask, got lit; add them"):
        make(replace(job, modes=("lit",)))
