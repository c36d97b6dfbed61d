"""Colours, labels and depth of a MuJoCo model show one world: what its renderer draws, rays meet."""

import numpy as np
import pytest

from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.instant import Instant
from omniscv.sources import Request, View, codecs
from omniscv.sources.mujoco import from_model
from omniscv.sources.mujoco.drawn import FLAGS

mujoco = pytest.importorskip("mujoco", reason="needs the extra mujoco")


AHEAD = View(Pose.from_angles((0, 0, 0)), 70, 120, 120)
GLOW = "<material name='glow' emission='1' rgba='1 1 1 1'/>"


def model(world, assets="", more=""):
    text = f"<mujoco><asset>{GLOW}{assets}</asset><worldbody>{world}</worldbody>{more}</mujoco>"
    return mujoco.MjModel.from_xml_string(text)


def pictures(source, view=AHEAD, modes=("object_mask", "depth", "lit")):
    captures = source.capture(Request(view, mode, source.state) for mode in modes)
    return {capture.mode: capture for capture in captures}


def test_the_table_has_every_flag_of_the_renderer():
    flags = {flag.name.removeprefix("mjVIS_") for flag in mujoco.mjtVisFlag.__members__.values()}
    assert FLAGS.keys() == flags - {"mjNVISFLAG"}


BALL = "<body pos='2 0 0'><freejoint/><geom name='ball' size='.2'/><site name='s' pos='0 .4 0'/>{}</body>"
FIXED = "<site name='w' pos='2 -.5 .5'/>"
ROPE = "<tendon><spatial name='rope' width='.04'><site site='w'/><site site='s'/></spatial></tendon>"
CLOTH = (
    "<flexcomp name='cloth' type='grid' count='4 4 1' spacing='.1 .1 .1' dim='2' radius='.01' pos='2 .2 .5'"
    " euler='0 60 0'/>"
)
CABLE = (
    "<flexcomp name='cable' type='grid' count='5 1 1' spacing='.1 .1 .1' dim='1' radius='.03' pos='2 0 -.5'"
    " euler='0 0 90'/>"
)
HINGE = "<body pos='2 .6 0'><joint axis='0 1 0' type='hinge'/><geom size='.1'/></body>"
RESTING = "<geom name='table' type='box' size='.5 .5 .1' pos='2 0 -.29'/>"
EXTRAS = {
    "tendon": (BALL.format("") + FIXED, ROPE, {"rope"}),
    "rangefinder": (
        BALL.format("") + "<site name='w' pos='1 -.5 .5' zaxis='1 .5 -.5'/>",
        "<sensor><rangefinder site='w'/></sensor>",
        set(),
    ),
    "actuator": (
        BALL.format("") + HINGE.replace("joint ", "joint name='j' "),
        "<actuator><motor joint='j'/></actuator>",
        set(),
    ),
    "contact": (BALL.format("") + RESTING, "", set()),
    "camera": (BALL.format("<camera name='c' pos='0 0 .4'/>"), "", set()),
    "cloth": (BALL.format("") + CLOTH, "", {"cloth"}),
    "cable": (BALL.format("") + CABLE, "", {"cable"}),
}


@pytest.mark.parametrize("data", ["rays", "raster"])
@pytest.mark.parametrize("name", EXTRAS)
def test_what_is_drawn_has_a_label_and_a_depth_and_nothing_else_is_drawn(name, data):
    """Geoms are drawn black before black: what is seen in colours are other things."""
    world, more, soft = EXTRAS[name]
    made = model(world.replace("<geom ", "<geom rgba='0 0 0 1' "), more=more)
    if name in ("cloth", "cable") and data == "rays":
        with pytest.raises(ArgumentError, match="data=raster"):
            from_model(made, data=data)
        return
    for kind in ("tendon", "flex"):
        getattr(made, f"{kind}_rgba")[:, :3] = 1
    with from_model(made, data=data, headlight="ambient") as source:
        table = source.objects()
        seen = pictures(source)
    mask = seen["object_mask"].pixels
    depth = seen["depth"].pixels
    bright = seen["lit"].pixels.max(axis=-1) > 60
    labels = [table.label(each) for each in soft & set(table.names())]
    assert bright.any() == bool(labels) == bool(soft and data == "raster")
    shown = np.isin(mask, labels)
    assert (bright == shown).mean() > 0.99  # outlines are blended in colours
    assert np.isfinite(depth[shown]).all()
    assert (np.isfinite(depth) == (mask > 0)).all()


def test_what_only_the_renderer_shows_is_hidden_by_name_and_not_moved():
    with from_model(model(EXTRAS["tendon"][0], more=ROPE), data="raster") as source:
        assert source.variable("objects")["rope"] == {"shown": 1}
        assert "rope" not in source.geometry().boxes
        with source.without(["rope"]) as hidden:
            mask = pictures(hidden, modes=("object_mask",))["object_mask"].pixels
            assert not (mask == source.objects().label("rope")).any()
        with pytest.raises(
            ArgumentError, match="expected bodies and geoms, which can be moved, got tendon 'rope'"
        ):
            source.at(Instant({"rope": Pose.from_angles((0, 0, 0))}))


@pytest.mark.parametrize("geom", [None, "1 1 1 0", "1 0 0 1", "1 0 0 .5"], ids=str)
@pytest.mark.parametrize("material", [0, 1])
def test_rays_meet_the_geoms_that_are_drawn_whoever_says_that_they_are_transparent(geom, material):
    """MuJoCo's rays ask the material, its renderer the geom, unless that has the default colour."""
    own = "" if geom is None else f"rgba='{geom}'"
    box = f"<geom name='box' type='box' size='.3 .3 .3' pos='2 0 0' material='m' {own}/>"
    made = model(box, f"<material name='m' emission='1' rgba='0 1 0 {material}'/>")
    for data in ("rays", "raster"):
        with from_model(made, data=data) as source:
            seen = pictures(source)
            names = source.objects().names()
        drawn = bool(seen["lit"].pixels.any())
        assert drawn == bool((seen["object_mask"].pixels > 0).any()) == ("box" in names)
        assert drawn == (material > 0 if geom is None else not geom.endswith(" 0"))


PLANES = {
    "endless": ("size='0 0 .1'", ""),
    "tiled": ("size='0 0 .1'", "texture='t' texrepeat='.1 .3' texuniform='true'"),
    "strip": ("size='0 3 .1'", ""),
    "tilted": ("size='0 0 .1' euler='8 20 30'", ""),
    "finite": ("size='6 5 .1'", ""),
}
EYES = {"low": (0.3, 0, 1.5), "high": (0.2, 0.1, 30), "far": (170.3, -300, 12), "below": (0, 0, -1)}
TEXTURE = "<texture name='t' type='2d' builtin='flat' rgb1='1 1 1' width='8' height='8'/>"


@pytest.mark.parametrize("eye", EYES.values(), ids=EYES)
@pytest.mark.parametrize("plane", PLANES)
def test_a_plane_ends_where_it_is_drawn_to_end_in_colours_labels_and_depth(plane, eye):
    """MuJoCo's rays against its renderer, whose colours are black where no plane is."""
    size, texture = PLANES[plane]
    assets = f"{TEXTURE}<material name='m' emission='1' rgba='1 1 1 1' {texture}/>"
    ball = "<geom name='ball' size='.2' pos='1 0 .2' material='glow'/>"
    made = model(f"<geom name='floor' type='plane' {size} material='m'/>{ball}", assets)
    view = View(Pose.from_angles(eye, 40, -10), 90, 60, 240)
    with from_model(made, data="rays") as rays, from_model(made, data="raster") as raster:
        exact = pictures(rays, view)
        drawn = pictures(raster, view)
        label = rays.objects().label("floor")
    mask = exact["object_mask"].pixels
    assert (mask == drawn["object_mask"].pixels).mean() > 0.9995
    assert ((exact["lit"].pixels.max(axis=-1) > 100) == (mask > 0)).mean() > 0.995  # edges are blended
    assert np.array_equal(exact["lit"].pixels, drawn["lit"].pixels)
    assert (mask == label).any() == (eye[2] > 0 and (eye[0] < 100 or plane not in ("finite", "strip")))
    both = (mask > 0) & (mask == drawn["object_mask"].pixels)
    off = np.abs(exact["depth"].pixels[both] - drawn["depth"].pixels[both])
    assert (off <= codecs.error_of(drawn["depth"])[both]).all()
    assert np.isinf(exact["depth"].pixels[mask == 0]).all()


def test_a_ray_that_passes_the_end_of_a_plane_meets_what_is_behind_it():
    wall = "<geom name='wall' type='box' size='1 900 900' pos='900 0 0'/>"
    made = model(f"<geom name='floor' type='plane' size='0 0 .1'/>{wall}")
    made.stat.extent = 2.0  # of the compiled model it is 900 m
    with from_model(made) as source:
        ends = np.array([[100.0, 0, -1.5], [899, 0, -5]])
        directions = ends / np.linalg.norm(ends, axis=1, keepdims=True)
        hits = source.trace(np.array([0, 0, 1.5]), directions)
        names = [source.objects().names()[label - 1] for label in hits.label]
    assert names == ["floor", "wall"]
    np.testing.assert_allclose(hits.distance, [100 / directions[0, 0], 899 / directions[1, 0]])


def test_a_picture_does_not_depend_on_the_one_before():
    made = model("<geom type='plane' size='0 0 .1' material='glow'/>")
    views = [View(Pose.from_angles((x, 0, 10), 30), 90, 40, 160) for x in (0.0, 7.7, 40.0)]
    with from_model(made) as one, from_model(made) as other:
        forth = [pictures(one, view, ("lit",))["lit"].pixels for view in views]
        back = [pictures(other, view, ("lit",))["lit"].pixels for view in reversed(views)]
    assert all(np.array_equal(a, b) for a, b in zip(forth, reversed(back), strict=True))


@pytest.mark.parametrize(
    ("world", "where"),
    [
        ("<body name='cup' pos='nan 0 0'><geom size='.1'/></body>", "nan.* in body_pos of body cup"),
        ("<geom name='cup' size='.1' pos='0 inf 0'/>", "inf.* in geom_pos of geom cup"),
    ],
    ids=["nan", "inf"],
)
def test_a_model_with_a_number_that_is_none_is_refused(world, where):
    with pytest.raises(ArgumentError, match=f"expected finite numbers in a model, got .*{where}$"):
        from_model(model(world))


def test_a_state_with_a_number_that_is_none_is_refused():
    made = model(BALL.format(""))
    data = mujoco.MjData(made)
    data.qpos[0] = np.nan
    with pytest.raises(ArgumentError, match=r"expected finite numbers in a state, got .* in qpos"):
        from_model(made, data)


def test_physics_that_diverge_are_refused():
    """MuJoCo warns in a file, and begins anew from the first state."""
    made = model("<body><joint name='j' type='slide' stiffness='1e7'/><geom size='.1' mass='1e-3'/></body>")
    made.qpos_spring[:] = 1.0
    made.opt.integrator = int(mujoco.mjtIntegrator.mjINT_EULER)
    made.dof_damping[:] = -1e3
    with (
        from_model(made, time=1.0) as source,
        pytest.raises(ArgumentError, match=r"time: .* physics stay finite"),
    ):
        source.poses()


TRACK = [[0, 1.0, 0, 0, 1, 0, 0, 0], [1, 2.0, 0, 0, 1, 0, 0, 0]]


@pytest.mark.parametrize(
    "options",
    [{}, {"qpos": TRACK}, {"time": 0.5}, {"qpos": TRACK[0][1:]}],
    ids=["plain", "track", "time", "qpos"],
)
def test_a_state_that_is_given_is_shown_whatever_the_options_say(options):
    made = model(BALL.format(""))
    data = mujoco.MjData(made)
    data.qpos[:3] = 0.3, 0.4, 0.5
    with from_model(made, **options) as source, source.with_state(data) as given:
        np.testing.assert_array_equal(given.poses()["body 1"].position, data.qpos[:3])
        assert given.trace(np.array([0.3, 0.4, 5]), np.array([[0, 0, -1.0]])).distance[0] == pytest.approx(
            4.3
        )
        if options.get("qpos") == TRACK:
            with (
                given.at(Instant(time=0.5)) as later,
                pytest.raises(ArgumentError, match="time: expected none"),
            ):
                later.poses()
        else:
            with given.at(Instant(time=0.1)) as later:
                assert later.poses()["body 1"].position[2] == pytest.approx(0.5 - 9.81 / 2 * 0.1 * 0.102)


@pytest.mark.parametrize("options", [{"keyframe": 0}, {"qpos": TRACK}], ids=["keyframe", "qpos"])
def test_a_state_beside_data_is_refused(options):
    made = model(BALL.format(""), more="<keyframe><key qpos='1 2 3 1 0 0 0'/></keyframe>")
    with pytest.raises(ArgumentError, match="expected none beside data, whose state is shown"):
        from_model(made, mujoco.MjData(made), **options)


def test_an_option_is_given_once(tmp_path):
    from omniscv import open_source

    (tmp_path / "one.xml").write_text("<mujoco><worldbody><geom size='.1'/></worldbody></mujoco>")
    with pytest.raises(ArgumentError, match=r"time: expected it once.*got 1.0 and 2"):
        open_source(f"mujoco://{tmp_path}/one.xml?time=1", time=2)
    with pytest.raises(ArgumentError, match="expected time once, got it twice"):
        open_source(f"mujoco://{tmp_path}/one.xml?time=1&time=2")
