"""What needs PyTorch is collected where it is found; scripts/test-torch makes an environment that has it.

The folder is no ``torch``: beside the tests' own packages that name would be found where PyTorch is not.
"""

import os
from importlib.util import find_spec

import pytest
from support.datasets import made

import omniscv

os.environ["TRITON_INTERPRET"] = "1"  # its kernels run on a processor; read when they are imported

collect_ignore_glob = [] if find_spec("torch") else ["test_[!m]*.py"]

MODES = ("lit", "object_mask", "depth", "normals")
CENTERS = ((0, 0, 1.5), (0.8, -0.5, 1.2))


@pytest.fixture(scope="session")
def recording(tmp_path_factory):
    """The room's six faces around two centres."""
    path = tmp_path_factory.mktemp("recording") / "room.sqlite"
    camera = omniscv.cameras.create("equirectangular", width=8, height=4)
    with omniscv.record(omniscv.open_source("scene://four-wall"), path) as source:
        for center in CENTERS:
            pose = omniscv.Pose.from_angles(center)
            omniscv.render(camera, pose, source, MODES, strategy="cube", face_size=48)
    return path


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """A dataset of two cameras at three poses, with boxes, packed as shards of two samples of each camera."""
    out = made(tmp_path_factory.mktemp("dataset"), more="truth: {boxes: true}\n")
    for camera in ("pano", "lens"):
        shards = out.parent / camera
        omniscv.dataset.export(out, "webdataset", shards, cameras=[camera], max_count=1)
    return out
