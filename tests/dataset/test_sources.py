"""Datasets of every kind of source, plugins of today and of before among them: they pass the deep check."""

import json
from dataclasses import replace

import numpy as np
import pytest
from support.command_line import ROOT
from support.datasets import job_file

import omniscv
from omniscv import dataset
from omniscv.job import load
from omniscv.make import make
from omniscv.make.source import open_source

RECORDING = ROOT / "captures" / "four-wall.sqlite"


@pytest.mark.parametrize(
    "source",
    ["mock://four-wall?dialect=N2&size=64x64", "mock://four-wall?dialect=0.3.10&size=64x64", str(RECORDING)],
)
def test_a_dataset_of_each_source_has_no_faults(source, tmp_path):
    job = load(job_file(tmp_path, source=json.dumps(source)))
    with open_source(job) as opened:
        modes = tuple(mode for mode in job.modes if mode in opened.capabilities.modes)
    poses = tuple(omniscv.Pose.from_angles((0.0, 0.0, 1.5), yaw) for yaw in (0, 30))
    options = omniscv.RenderOptions("cube")
    job = replace(job, modes=modes, poses=poses, times=None, places=None, options=options)
    make(job)
    assert dataset.check(job.out, deep=True) == []
    frames = dataset.open(job.out)
    assert len(frames) == 4
    with omniscv.open_source("scene://four-wall") as scene:
        names = scene.objects().names()
    for frame in frames:
        assert set(names) <= set(frame.instances)
        floor = frame.layer("labels") == frame.instances["Layout_Floor"]
        height = 1.5 + (frame.camera.unproject().directions @ frame.pose.R_w_c.T)[..., 2] * frame.layer(
            "depth"
        )
        assert floor.mean() > 0.1
        assert np.median(np.abs(height[floor & ~frame.layer("label_edge")])) < 0.02
