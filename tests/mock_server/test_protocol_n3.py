"""Dialect N3, plugin 1.1.0: texts as the reference's supplement gives them, and the official client on it."""

import json
import re

import numpy as np
import pytest
from support.expected_views import npy, png

# Section 2.1 of the supplement: U is [uint], S [str], F [float]; the four templates of editors are left out.
GROUPS = {
    "vget /camera/U/": """location rotation fov size cine cine/enabled cine/intrinsics
        lit=S depth=S normal=S object_mask=S seg=S optical_flow=S""",
    "vset /camera/U/": """location=F=F=F rotation=F=F=F moveto=F=F=F fov=F size=U=U ortho_width=F
        projection_type=S lit_source=S reflection=S illumination=S exposure_method=S exposure_bias=F
        auto_speed=F=F auto_brightness=F=F physical_exposure=U motion_blur=F=F=F=U focal=F=F
        cine/enabled=U cine/filmback=F=F=F=F cine/lens=F=F cine/lens_settings=F=F=F=F=F=F=U cine/focus=F
        cine/focus_mode=S=U=F=F cine/focus_tracking=S=F=F=F cine/crop=F=F=U=U cine/near_clip=U=F
        cine/exposure=F=F=U""",
    "": """vget=/cameras vset=/cameras/spawn vget=/screenshot=S vget=/viewmode vset=/viewmode=S vget=/objects
        vset=/objects/spawn=S vset=/objects/spawn=S=S vset=/objects/spawn=S=F=F=F
        vset=/objects/spawn=S=S=F=F=F vset=/objects/spawn_cube
        vset=/objects/spawn_cube=S vset=/objects/spawn_cube=F=F=F
        vset=/objects/spawn_cube=S=F=F=F vget=/scene/name vget=/level/name vget=/persistent_level/id
        vget=/persistent_level/level_script_actor/id vcmd=S""",
    "vget /object/S/": """location rotation scale color mobility bounds vertex_location uclass_name bones
        bones=S bones=S=S""",
    "vset /object/S/": "location=F=F=F rotation=F=F=F scale=F=F=F color=U=U=U show hide destroy name=S",
    "vset /action/": """game/pause game/resume game/level=S input/enable input/disable eyes_distance=F
        keyboard=S=F""",
    "vget /action/": "game/is_paused",
    "vget /unrealcv/": "commands help status version echo=S",
}
SHARED = [f"vget /camera/[uint]/{m}_shared" for m in ("lit", "depth", "normal", "object_mask", "seg")]


def expected_templates():
    words = {"U": "[uint]", "S": "[str]", "F": "[float]"}
    ends = [(start + end).replace("=", " ") for start, text in GROUPS.items() for end in text.split()]
    for verb, least, most in (("vrun", 1, 6), ("vexec", 2, 7), ("vbp", 2, 11), ("vreflect", 2, 12)):
        ends += [verb + " S" * count for count in range(least, most + 1)]
    return [re.sub(r"(?<=[ /])[USF](?=[ /]|$)", lambda found: words[found[0]], end) for end in ends]


@pytest.fixture
def raw(start, open_raw):
    client = open_raw(start(dialect="N3", size=(40, 30), depth="float32"))
    assert client.text("vset /cameras/spawn") == "FusionCameraActor_0"
    return client


def test_the_list_is_the_plugins(start, open_raw, raw):
    lines = raw.text("vget /unrealcv/commands").split("\n")
    assert lines == sorted(expected_templates())
    assert len(lines) + len(SHARED) + 4 == 133
    assert raw.text("vget /unrealcv/help").split("\n")[::2].count("vget /unrealcv/commands") == 1
    refusing = open_raw(start(shared_memory="refusing"))
    assert set(refusing.text("vget /unrealcv/commands").split("\n")) - set(lines) == set(SHARED)
    no = "error Windows shared memory transport is only available on Windows"
    assert refusing.text("vget /camera/0/lit_shared") == no
    assert refusing.text("vget /camera/99/lit_shared") == "error Invalid sensor id"


def test_all_sensors_of_a_cine_camera_have_its_projection(raw):
    """Off-centre: depth and colours are those of the rays that the intrinsics give."""
    for command in ("rotation 0 30 0", "cine/filmback 36 27 4 -3", "cine/lens 18 2.8"):
        assert raw.text(f"vset /camera/1/{command}") == "ok"
    assert raw.text("vget /camera/1/cine/enabled") == "1"
    k = json.loads(raw.text("vget /camera/1/cine/intrinsics"))
    m = np.reshape(k["projection_matrix"], (4, 4))
    assert (k["fx"], k["fy"]) == pytest.approx((m[0, 0] * 20, m[1, 1] * 15))
    assert (k["cx"], k["cy"]) == pytest.approx(((1 + m[2, 0]) * 20, (1 - m[2, 1]) * 15))
    assert k["fx"] == pytest.approx(20 / np.tan(np.radians(k["horizontal_fov_degrees"]) / 2))
    assert (k["cx"], k["cy"]) != (20, 15)
    from mock_server import load_scene

    v, u = np.mgrid[:30, :40] + 0.5
    x, y = (u - k["cx"]) / k["fx"], (v - k["cy"]) / k["fy"]
    turn = np.radians(30)
    ahead = np.array([np.cos(turn), -np.sin(turn), 0])
    right = np.array([-np.sin(turn), -np.cos(turn), 0])
    rays = ahead + x[..., None] * right + y[..., None] * (0, 0, -1)
    hits = load_scene("four-wall").trace((0, 0, 1.5), rays / np.linalg.norm(rays, axis=-1, keepdims=True))
    depth = 100 * hits.distance / np.linalg.norm(rays, axis=-1)
    np.testing.assert_allclose(npy(raw.ask("vget /camera/1/depth npy")), depth, rtol=1e-5)
    lit = png(raw.ask("vget /camera/1/lit png"))[..., :3]
    assert np.abs(lit - 255 * hits.color).max() <= 0.5 + 1e-6
    assert raw.text("vset /camera/1/cine/enabled 0") == "ok"
    assert raw.text("vget /camera/1/cine/enabled") == "0"
    assert np.abs(png(raw.ask("vget /camera/1/lit png"))[..., :3] - 255 * hits.color).max() > 1
    of_model = json.loads(raw.text("vget /camera/1/cine/intrinsics"))  # not of the image
    assert of_model["fx"] == k["fx"]


def test_exposure_that_is_set_while_the_cine_model_is_on_is_lost(raw):
    lit = lambda: png(raw.ask("vget /camera/1/lit png")).astype(float)[..., :3].mean()  # noqa: E731
    raw.text("vset /camera/1/cine/enabled 1")
    before = lit()
    assert raw.text("vset /camera/1/exposure_bias -1") == "ok"
    assert lit() == before
    raw.text("vset /camera/1/cine/enabled 0")
    raw.text("vset /camera/1/exposure_bias -1")
    raw.text("vset /camera/1/cine/enabled 1")
    assert lit() == pytest.approx(before / 2, rel=0.02)  # rounded to 8 bits
