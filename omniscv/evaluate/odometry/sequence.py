"""Images of a flight along a loop, by three cameras with one centre."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from omniscv.cameras import create
from omniscv.cameras.rig import Rig, RigCamera
from omniscv.compose.renderer import Renderer
from omniscv.dataset.pictures import write_pixels
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.trajectory import Trajectory
from omniscv.planning import RenderOptions
from omniscv.sources.base import Source

SECONDS = 28.0
"""Of the flight, as in the paper."""


def flight(count: int) -> Trajectory:
    """Return a closed loop of 6.7 m through the free middle of the mock's rooms.

    It is 1.35 to 1.65 m above the floor; the camera looks ahead, and pitches and rolls by up to 5 degrees.
    """
    turns = 2 * np.pi * np.arange(count) / count
    poses = [
        Pose.from_angles(
            (np.cos(a) - 0.4, 1.1 * np.sin(a), 1.5 + 0.15 * np.sin(2 * a)),
            yaw_deg=np.degrees(np.arctan2(1.1 * np.cos(a), -np.sin(a))),
            pitch_deg=5 * np.sin(3 * a),
            roll_deg=5 * np.cos(2 * a),
        )
        for a in turns
    ]
    return Trajectory(tuple(poses), tuple((SECONDS * np.arange(count) / count).tolist()))


def rig_of(width: int, edge: int) -> Rig:
    """Return a panorama and a fisheye that look ahead, and a camera below a hyperbolic mirror that looks up.

    Args:
        width: of the panorama, px.
        edge: of the square images of the two others, px.
    """
    return Rig(
        {
            "panorama": RigCamera(create("equirectangular", width, width // 2)),
            "fisheye": RigCamera(create("fisheye-equidistant", edge, edge, fov_deg=170.0)),
            "mirror": RigCamera.turned(create("catadioptric-hyperbolic", edge, edge), pitch_deg=90),
        }
    )


def render(
    rig: Rig, trajectory: Trajectory, source: Source, folder: Path, progress: Callable[[int], None]
) -> dict[str, list[Path]]:
    """Write the images of each camera of a rig as ``CAMERA/0000.png`` and so on; return them by camera.

    Args:
        rig: the cameras.
        trajectory: poses of the rig.
        source: of captures.
        folder: for the images.
        progress: called with the number of poses done.

    Raises:
        OmniscvError: of the source; ArgumentError: colours that are not bytes.
    """
    # With one size of faces, the cameras share captures. It exceeds the resolution of panorama and fisheye.
    options = RenderOptions(face_size=max(m.camera.width for m in rig.cameras.values()) // 2)
    renderer = Renderer(source)
    written: dict[str, list[Path]] = {name: [] for name in rig.cameras}
    for i, pose in enumerate(trajectory):
        cameras = [(mounted.camera, pose @ mounted.pose) for mounted in rig.cameras.values()]
        images = renderer.render_together(cameras, ("lit",), options)
        for name, image in zip(rig.cameras, images, strict=True):
            if image.lit is None or image.lit.dtype != np.uint8:
                raise ArgumentError("source: expected colours as bytes, got others; leave out lit=float32")
            written[name].append(write_pixels(folder / name / f"{i:04d}.png", image.lit))
        progress(i + 1)
    return written
