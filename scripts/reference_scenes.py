"""The twenty scenes of the reference set: rooms, yards, varied and moving worlds, meshes, a physics engine.

Each is a dataset of its own, ``scenes/NAME``, so that a benchmark takes it as one scene.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

STEPS = 12
PERIOD_S = 0.1
STILL = ("four-wall", "six-wall", "open", "fence", "courtyard")
VARIED = {"four-wall": 5, "six-wall": 4}
"""Rooms, and how many of their draws are scenes."""
MESHES = 3
PHYSICS = 2
MODES = ("lit", "object_mask", "depth", "normals")
TURNED = {"turn_deg": [-40, 40], "shown": 0.8}
"""What is drawn of each object that is no wall: none is moved into the way of a camera."""


def scenes(folder: Path, share: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the name of each scene and its job.

    Args:
        folder: where files of worlds are written, below ``worlds``.
        share: the divisor of the sizes of pictures.
    """
    job = _job(share)
    for room in STILL:
        yield f"still-{room}", {**job, "source": f"scene://{room}"}
    for room, count in VARIED.items():
        for seed in range(count):
            vary = {"seed": seed, "per": "world", "objects": {"[!L]*": TURNED}}
            yield f"varied-{room}-{seed}", {**job, "source": f"scene://{room}", "vary": vary}
    times = {"rate": 1 / PERIOD_S, "count": STEPS}
    yield "moving-workshop", {**job, "source": "scene://workshop", "times": times}
    (folder / "worlds").mkdir(parents=True, exist_ok=True)
    for seed in range(MESHES):
        path = folder / "worlds" / f"mesh-{seed}.glb"
        path.write_bytes(mesh_room(seed))
        yield f"mesh-{seed}", {**job, "source": f"mesh://{path.absolute()}?up=z"}
    for seed in range(PHYSICS):
        path = folder / "worlds" / f"physics-{seed}.xml"
        path.write_text(physics(seed), encoding="utf-8")
        # Colours of MuJoCo depend on the machine's OpenGL.
        modes = [mode for mode in MODES if mode != "lit"]
        source = f"mujoco://{path.absolute()}"
        yield f"physics-{seed}", {**job, "source": source, "modes": modes, "export": []}


def _job(share: int) -> dict[str, Any]:
    """Return what the jobs of all scenes have in common."""
    square = {"width": 320 // share, "height": 320 // share}
    focal = 160 / share
    return {
        "cameras": {
            "panorama": {"model": "equirectangular", "width": 512 // share, "height": 256 // share},
            "fisheye-185": {"model": "fisheye-equidistant", **square, "fov_deg": 185},
            "fisheye-220": {"model": "fisheye-equidistant", **square, "fov_deg": 220},
            "cube": {"model": "cube-map", "width": 768 // share, "height": 128 // share},
            "pinhole": {"model": "pinhole", **square, "fx": focal, "fy": focal},
        },
        "poses": poses(),
        "modes": list(MODES),
        "truth": {"boxes": True},
        "export": [{"format": "colmap", "cameras": ["pinhole"], "points": 0.05}],
    }


def poses() -> list[dict[str, Any]]:
    """Return poses on an ellipse around the origin that look along it, up and down in turn."""
    turns = np.arange(STEPS) / STEPS * 2 * np.pi
    on_path = []
    for turn in turns.tolist():
        position = np.round(
            [0.7 * np.cos(turn), 0.5 * np.sin(turn), 1.5 + 0.1 * np.sin(2 * turn)], 3
        ).tolist()
        yaw_deg = round(float(np.degrees(turn)) + 90, 3)
        pitch_deg = round(float(10 * np.sin(3 * turn)), 3)
        on_path.append({"position": position, "yaw_deg": yaw_deg, "pitch_deg": pitch_deg})
    return on_path


def mesh_room(seed: int) -> bytes:
    """Return a room with furniture as GLB, Z up: boxes and balls with colours of their corners."""
    import trimesh

    rng = np.random.default_rng(seed)
    scene = trimesh.Scene()
    walls = trimesh.creation.box(extents=(6, 5, 3))
    walls.invert()  # seen from inside
    for _ in range(3):
        walls = walls.subdivide()
    walls.apply_translation((0, 0, 1.5))
    _paint(walls, rng)
    scene.add_geometry(walls, node_name="Room", geom_name="Room")
    for number in range(8):
        if number % 2:
            thing = trimesh.creation.icosphere(subdivisions=3, radius=float(rng.uniform(0.15, 0.4)))
        else:
            thing = trimesh.creation.box(extents=rng.uniform(0.3, 0.9, 3))
        angle = 2 * np.pi * (number + rng.uniform(0.2, 0.8)) / 8
        thing.apply_translation((2.2 * np.cos(angle), 1.8 * np.sin(angle), rng.uniform(0.3, 1.6)))
        _paint(thing, rng)
        scene.add_geometry(thing, node_name=f"Thing_{number}", geom_name=f"Thing_{number}")
    return bytes(scene.export(file_type="glb"))


def _paint(mesh: Any, rng: np.random.Generator) -> None:
    """Give the corners of a mesh colours that differ a little."""
    base = rng.uniform(60, 200, 3)
    shades = base + rng.uniform(-40, 40, (len(mesh.vertices), 3))
    opaque = np.full((len(mesh.vertices), 1), 255.0)
    mesh.visual.vertex_colors = np.hstack([shades, opaque]).astype(np.uint8)


def physics(seed: int) -> str:
    """Return a MuJoCo model: a floor, four walls, and bodies of several forms."""
    rng = np.random.default_rng(seed)
    bodies = []
    for number, form in enumerate(("box", "sphere", "cylinder", "capsule", "ellipsoid") * 2):
        angle = 2 * np.pi * (number + rng.uniform(0.2, 0.8)) / 10
        x, y, z = 2.2 * np.cos(angle), 2.0 * np.sin(angle), rng.uniform(0.4, 1.8)
        size = " ".join(f"{value:.3f}" for value in rng.uniform(0.15, 0.4, 3))
        geom = f"<geom type='{form}' size='{size}'/>"
        bodies.append(f"<body name='{form}_{number}' pos='{x:.3f} {y:.3f} {z:.3f}'>{geom}</body>")
    for name, position, size in (
        ("North", "0 3 1.5", "3 .05 1.5"),
        ("South", "0 -3 1.5", "3 .05 1.5"),
        ("East", "3 0 1.5", ".05 3 1.5"),
        ("West", "-3 0 1.5", ".05 3 1.5"),
    ):
        bodies.append(f"<body name='{name}' pos='{position}'><geom type='box' size='{size}'/></body>")
    floor = "<geom name='floor' type='plane' size='3 3 .1'/>"
    return f"<mujoco><worldbody>{floor}{''.join(bodies)}</worldbody></mujoco>"
