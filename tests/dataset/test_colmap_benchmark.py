"""COLMAP's own evaluation of reconstructions, unmodified, on the truth with planted errors of poses.

It is not in COLMAP's wheel: ``COLMAP_EVALUATION`` names its folder ``benchmark/reconstruction/evaluation``.
"""

import importlib
import os
import runpy
import sys
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from support.command_line import ROOT

from omniscv.job import read
from omniscv.make import make

EVALUATION = os.environ.get("COLMAP_EVALUATION", "")
pytestmark = pytest.mark.skipif(
    not EVALUATION, reason="COLMAP_EVALUATION: no path of COLMAP's benchmark/reconstruction/evaluation"
)
ANGLES_DEG = (1.0, 3.0, 10.0, 30.0)
EXACT_DEG = 2e-6
"""What an arc cosine of float64 near 1 resolves: the evaluation's angles between translations are such."""


@pytest.fixture(scope="module")
def scenes(tmp_path_factory):
    """Two scenes of the reference set, of an eighth of the size, as COLMAP's benchmark lists them."""
    sys.path[:0] = [str(ROOT / "scripts"), str(ROOT / "scripts/consumers"), str(Path(EVALUATION).parent)]
    folder = tmp_path_factory.mktemp("reference")
    described = runpy.run_path(str(ROOT / "scripts/reference_scenes.py"))["scenes"](folder, 8)
    for name, job in described:
        if name in ("still-four-wall", "varied-six-wall-1"):
            cameras = {"pinhole": job["cameras"]["pinhole"]}
            make(read({**job, "cameras": cameras, "out": str(folder / "scenes" / name)}, folder))
    utils = importlib.import_module("evaluation.utils")
    made = importlib.import_module("colmap_benchmark").dataset_class(utils)
    dataset = made(data_path=folder, categories=[], scenes=[], run_path=folder / "runs", run_name="run")
    return utils, dataset, dataset.list_scenes()


def models(info, angle_deg, planted=3):
    """The truth, and a copy of which one image is turned about its own centre."""
    truth = pycolmap.Reconstruction(str(info.sparse_gt_path))
    model = pycolmap.Reconstruction(str(info.sparse_gt_path))
    image = sorted(model.images.values(), key=lambda image: image.name)[planted]
    turn = pycolmap.Rotation3d(np.radians(angle_deg) * np.array([0.6, 0.0, 0.8]))
    frame = model.frames[image.frame_id]
    frame.rig_from_world = pycolmap.Rigid3d(turn, np.zeros(3)) * frame.rig_from_world
    return truth, model, image.name


def test_the_scenes_are_listed_with_their_pictures(scenes):
    _, _, infos = scenes
    assert [info.scene for info in infos] == ["still-four-wall", "varied-six-wall-1"]
    for info in infos:
        truth = pycolmap.Reconstruction(str(info.sparse_gt_path))
        assert info.num_images == truth.num_images() == 12
        assert all((info.image_path / image.name).is_file() for image in truth.images.values())


@pytest.mark.parametrize("angle_deg", ANGLES_DEG)
def test_a_planted_turn_is_found(scenes, angle_deg):
    utils, _, infos = scenes
    for info in infos:
        truth, model, name = models(info, angle_deg)
        _, turns = utils.compute_abs_errors(sparse_gt=truth, sparse=model)
        by_name = dict(zip((image.name for image in model.images.values()), turns, strict=True))
        assert by_name.pop(name) == pytest.approx(angle_deg, abs=1e-9)
        assert max(by_name.values()) < EXACT_DEG


def test_without_planted_errors_nothing_is_found(scenes):
    utils, dataset, infos = scenes
    for info in infos:
        truth, model, _ = models(info, 0.0)
        errors = utils.compute_grouped_rel_errors(
            sparse_gt=truth,
            sub_models=[model],
            image_name_to_component={image.name: 0 for image in truth.images.values()},
            min_proj_center_dist=dataset.position_accuracy_gt,
        )
        assert len(errors) == 12 * 11
        assert errors.max() < EXACT_DEG


@pytest.mark.parametrize("angle_deg", ANGLES_DEG)
def test_pairs_with_the_turned_image_have_its_error(scenes, angle_deg):
    utils, dataset, infos = scenes
    truth, model, _ = models(infos[0], angle_deg)
    errors = utils.compute_grouped_rel_errors(
        sparse_gt=truth,
        sub_models=[model],
        image_name_to_component={image.name: 0 for image in truth.images.values()},
        min_proj_center_dist=dataset.position_accuracy_gt,
    )
    wrong = errors[errors > EXACT_DEG]
    assert len(wrong) == 2 * 11
    assert wrong.max() == pytest.approx(angle_deg, abs=1e-9)
