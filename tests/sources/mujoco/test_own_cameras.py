"""The cameras inside a model: their pictures are those of MuJoCo's own renderer."""

import re

import numpy as np
import pytest
import yaml

import omniscv
from omniscv.cameras import create
from omniscv.errors import ArgumentError
from omniscv.geometry.instant import Instant
from omniscv.job import load

mujoco = pytest.importorskip("mujoco", reason="needs the extra mujoco")

from omniscv.sources.mujoco import from_model  # noqa: E402

CAMERA = "<camera name='wrist' pos='0 -.3 .1' euler='70 5 0' {}/>"
ARM = """
<mujoco><option gravity='0 0 -9.81'/><worldbody>
<geom name='floor' type='plane' size='5 5 .1' rgba='.2 .6 .3 1'/>
<geom name='box' type='box' size='.2 .3 .2' pos='.3 1.5 .2' rgba='.8 .2 .1 1'/>
<geom name='ball' size='.15' pos='-.4 1.2 .5'/>
<body name='hand' pos='0 0 1'><joint type='slide' axis='0 0 1'/><geom size='.05' contype='0'/>{}</body>
</worldbody></mujoco>"""
LENSES = {
    "fovy": "fovy='50' resolution='160 120'",
    "focal": "sensorsize='.02 .015' focal='.02 .02' resolution='160 120'",
}


def rendered(model, data):
    """Depth and geoms by MuJoCo's renderer from its own camera, planar metres, and -1 for none."""
    with mujoco.Renderer(model, 120, 160) as renderer:
        renderer.update_scene(data, camera="wrist")
        renderer.enable_depth_rendering()
        depth = renderer.render().copy()
        renderer.disable_depth_rendering()
        renderer.enable_segmentation_rendering()
        return depth, renderer.render()[..., 0].copy()


def assert_same(image, ray_lengths, model, depth, geoms):
    """Labels and depth are those of MuJoCo's renderer, where the image is sure."""
    names = image.objects.names()
    labels = np.zeros(1 + model.ngeom, int)
    for number in range(model.ngeom):
        name = model.geom(number).name or "hand/sphere0"
        if name in names:
            labels[1 + number] = 1 + names.index(name)
    sure = ~image.label_edge & np.isfinite(image.depth)
    assert sure.mean() > 0.5
    assert (image.labels == labels[1 + geoms])[sure].mean() > 0.99
    assert np.median(np.abs(image.depth / ray_lengths - depth)[sure] / depth[sure]) < 2e-3


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)
def test_a_view_of_the_models_camera_is_what_mujoco_renders_of_it_and_moves_with_it(lens):
    model = mujoco.MjModel.from_xml_string(ARM.format(CAMERA.format(lens)))
    data = mujoco.MjData(model)
    with from_model(model, by="geom") as source:
        with source.at(Instant(time=0.2)) as later:
            fallen = later.own_views()["wrist"].pose.position - source.own_views()["wrist"].pose.position
        np.testing.assert_allclose(fallen, (0, 0, -9.81 / 2 * 0.2 * 0.202), atol=1e-9)
        for time in (0.0, 0.2):
            while data.time < time - 1e-9:
                mujoco.mj_step(model, data)
            mujoco.mj_forward(model, data)
            with source.with_state(data) as now:
                view = now.own_views()["wrist"]
                camera = create("pinhole", view.width, view.height, fov_deg=view.fov_deg)
                image = omniscv.render(camera, view.pose, now, ("object_mask", "depth"), face_size=512)
            depth, geoms = rendered(model, data)
            assert_same(image, view.ray_lengths(), model, depth, geoms)


def test_an_address_with_a_camera_is_refused_with_what_a_job_has_in_its_place(tmp_path):
    file = tmp_path / "arm.xml"
    file.write_text(ARM.format(CAMERA.format(LENSES["fovy"])))
    with pytest.raises(
        ArgumentError, match="expected no camera in the address, got 'wrist'; write poses"
    ) as refused:
        omniscv.open_source(f"mujoco://{file}?camera=wrist")
    poses, cameras = re.search(
        r"write poses: (.*) and cameras: (.*); or, where it moves", refused.value.message
    ).groups()
    job = load(
        {"source": f"mujoco://{file}", "poses": yaml.safe_load(poses), "cameras": yaml.safe_load(cameras)}
    )
    with from_model(mujoco.MjModel.from_xml_path(str(file))) as source:
        view = source.own_views()["wrist"]
    np.testing.assert_allclose(job.poses[0].R_w_c, view.pose.R_w_c, atol=1e-7)
    np.testing.assert_allclose(job.poses[0].position, view.pose.position, atol=1e-5)
    assert job.cameras["wrist"].width == 160
    with pytest.raises(ArgumentError, match="camera: expected one of wrist; got 'wirst'; did you mean wrist"):
        omniscv.open_source(f"mujoco://{file}?camera=wirst")
