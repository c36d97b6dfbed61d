"""Every ray is served by the view that sees it most centrally, wherever views look, however wide they are."""

import hypothesis.strategies as st
import numpy as np
from hypothesis import given
from scipy.spatial.transform import Rotation

from omniscv.depth.ray_lookup import look_up
from omniscv.geometry import Pose, cube_rotations
from omniscv.sources.base import View

CLOSE = 1e-9  # of half a view: nearer to each other than that, either may serve


@st.composite
def view_sets(draw):
    """Views of one size from one centre: faces of a cube, or any, some in the same direction or nearly."""
    if draw(st.booleans()):
        turn = Rotation.random(random_state=draw(st.integers(0, 999)))
        faces = draw(st.permutations([turn.as_matrix() @ R_w_c for _, R_w_c in cube_rotations()]))
        some = faces[: draw(st.integers(1, 6))] + faces[:1] * draw(st.integers(0, 1))
        return [View(Pose((0, 0, 0), R_w_c), 100.0, 64, 64) for R_w_c in some]
    width, height = draw(st.sampled_from(((64, 64), (64, 40), (30, 64))))
    turns = [Rotation.random(random_state=draw(st.integers(0, 999))) for _ in range(draw(st.integers(1, 6)))]
    turns += [turns[0] * Rotation.from_rotvec(draw(st.sampled_from(([0, 0, 0], [1e-7, 0, 0], [0, 0.3, 0]))))]
    fovs = [draw(st.sampled_from((30.0, 90.0, 120.0))) for _ in turns]
    return [
        View(Pose((0, 0, 0), turn.as_matrix()), fov, width, height)
        for turn, fov in zip(turns, fovs, strict=True)
    ]


@given(view_sets(), st.integers(0, 999))
def test_the_most_central_view_serves(views, seed):
    rng = np.random.default_rng(seed)
    start, end = rng.normal(size=(2, 3))
    near = [view.pose.R_w_c[:, 2] + 1e-3 * rng.normal(size=3) for view in views]
    rays = np.concatenate([np.linspace(start, end, 100), rng.normal(size=(100, 3)), near])
    found = look_up(rays, views)

    off = np.full((len(views), len(rays)), np.inf)
    pixel = np.zeros((len(views), len(rays), 2))
    for k, view in enumerate(views):
        x, y, z = view.pose.R_w_c.T @ rays.T
        seen = z > 0
        pixel[k, seen] = (view.focal_px * np.stack([x, y]) / z).T[seen]
        off[k, seen] = np.abs(pixel[k, seen] / (view.width / 2, view.height / 2)).max(axis=1)
    every = np.arange(len(rays))
    most = off.min(axis=0)
    np.testing.assert_array_equal(found.view[most < 1 - CLOSE] >= 0, True)
    np.testing.assert_array_equal(found.view[most > 1 + 2 * CLOSE], -1)
    served = found.view >= 0
    np.testing.assert_array_equal(np.flatnonzero(found.used), np.unique(found.view[served]))
    assert (off[found.view, every][served] <= most[served] + CLOSE).all()
    at = pixel[found.view, every][served] + (views[0].width / 2, views[0].height / 2)
    np.testing.assert_allclose(np.stack([found.x, found.y], 1)[served], at, atol=1e-5)  # float32


def test_of_two_views_alike_the_first_serves_whichever_ray_comes_before():
    faces = [View(Pose((0, 0, 0), R_w_c), 90.0, 8, 8) for _, R_w_c in cube_rotations()]
    between = (1.0, 1.0, 0.0)
    x, y = (look_up(np.array([ray, between]), faces).view for ray in np.eye(3)[:2])
    assert x[1] == y[1] == min(x[0], y[0])
