"""Models of MuJoCo by others: robosuite's arena with two arms (MIT), dm_control's humanoid (Apache-2).

Only their XML and meshes are needed. robosuite pins an old NumPy, so its package stands beside the
environment, without what it depends on::

    python -m pip install --no-deps --target .venv-mujoco robosuite==1.5.2 dm_control==1.0.50
"""

from pathlib import Path

import numpy as np

PACKAGES = Path(__file__).parents[2] / ".venv-mujoco"
ROOM = Path(__file__).parents[1] / "sources" / "mujoco" / "four-wall.xml"
ROBOSUITE = PACKAGES / "robosuite" / "models" / "assets"
HUMANOID = PACKAGES / "dm_control" / "suite" / "humanoid.xml"
POSED = {"panda": (0, 0.3, 0, -1.9, 0, 2.2, 0.8), "sawyer": (0, -0.9, 0, 1.7, 0, 0.8, 0)}
"""Joint angles of the arms, radians: above the table."""


def workspace():
    """Return the specification of robosuite's table with a Panda and a Sawyer, and their joint angles."""
    import mujoco

    world = mujoco.MjSpec.from_file(str(ROBOSUITE / "arenas" / "table_arena.xml"))
    for name, x in (("panda", -0.56), ("sawyer", 0.75)):
        robot = mujoco.MjSpec.from_file(str(ROBOSUITE / "robots" / name / "robot.xml"))
        half_turn = (1, 0, 0, 0) if x < 0 else (0, 0, 0, 1)
        frame = world.worldbody.add_frame(pos=(x, 0, 0.8), quat=half_turn)
        world.attach(robot, prefix=f"{name}/", frame=frame)
    return world


def posed_workspace():
    """Return the compiled workspace and its data, the arms above the table."""
    import mujoco

    model = workspace().compile()
    data = mujoco.MjData(model)
    data.qpos[:] = [angle for name in POSED for angle in POSED[name]]
    mujoco.mj_forward(model, data)
    return model, data


def models():
    """Return by name functions that open a model, with data by ``rays`` or ``raster``."""
    import mujoco

    from omniscv.sources.mujoco import from_model

    def of(path, name, **options):
        load = mujoco.MjModel.from_xml_path
        return lambda data: from_model(load(str(path)), name=name, data=data, **options)

    found = {"primitives": of(ROOM, "primitives")}
    if PACKAGES.exists():
        posed = posed_workspace()
        found["workspace"] = lambda data: from_model(*posed, name="workspace", data=data, groups="12")
        found["humanoid"] = of(HUMANOID, "humanoid", time=0.4)
    return found


def drawn_position(source, rng):
    """Return a point in the middle of a model from which nothing is nearer than 0.15 m, and something is."""
    boxes = [box for box in source.geometry().boxes.values() if box.size.max() < 3]
    while True:
        around = boxes[rng.integers(len(boxes))]
        point = around.center_w + rng.normal(size=3) * (0.4, 0.4, 0.3) * (1 + around.size.max())
        aimed = rng.normal(size=(300, 3))
        met = source.trace(point, aimed / np.linalg.norm(aimed, axis=1, keepdims=True)).distance
        if point[2] > 0.1 and 0.15 < met.min() < 3 and np.isfinite(met).mean() > 0.4:
            return point
