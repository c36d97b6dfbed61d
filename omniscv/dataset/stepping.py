"""Episodes: datasets of programs that step a world by themselves, as robots and policies do.

Each step is rendered when it is added. Its state and action are in the truth ``episode`` of its frames, which
the export ``lerobot`` makes columns of. The times of a dataset go on from one episode to the next, since a
camera is in one place at a time; the export counts from the first step of each.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike

from omniscv.arguments import number, stem
from omniscv.cameras import Camera
from omniscv.cameras.rig import Rig, RigCamera
from omniscv.compose.renderer import Renderer, options_of
from omniscv.dataset.manifest import Manifest, any_text
from omniscv.dataset.writer import Writer
from omniscv.errors import ArgumentError, ExistingDatasetError
from omniscv.frame import Frame
from omniscv.geometry import Pose
from omniscv.geometry.trajectory import nanoseconds
from omniscv.render_options import RenderKeywords, RenderOptions
from omniscv.sources.base import Source

EPISODE = "episode"
"""The truth of a frame that says its episode, its step and what is done, and has the state and the action."""
MODES = ("lit", "object_mask", "depth")


@contextmanager
def episodes(
    out: str | Path,
    rig: Rig | Camera | Mapping[str, Camera],
    *,
    fps: float = 30.0,
    task: str = "",
    modes: tuple[str, ...] = MODES,
    **options: Unpack[RenderKeywords],
) -> Iterator["Episodes"]:
    """Begin a dataset of episodes; its list of frames is written when the context ends without an error.

    Args:
        out: the folder, by path or URL.
        rig: the cameras: those of a rig move together, those of a mapping by name each for itself; one camera
            is named ``camera``.
        fps: steps a second.
        task: what is done.
        modes: what is rendered.
        options: of :func:`omniscv.render`.

    Raises:
        ArgumentError: a wrong option, or an episode that is not ended.
        ExistingDatasetError: there is a dataset in the folder.
    """
    cameras = _mounted(rig)
    begun = Manifest(cameras={name: mounted.camera for name, mounted in cameras.items()})
    try:
        writer = Writer(out, begun=begun)
    except ExistingDatasetError as error:
        raise error.advised("remove it, or begin the episodes elsewhere") from None
    with writer:
        made = Episodes(
            writer=writer,
            cameras=cameras,
            is_rig=not isinstance(rig, Mapping),
            fps=number("fps", fps, above=0),
            task=any_text("task", task),
            modes=modes,
            options=options_of(options),
        )
        yield made
        if made.steps:
            raise ArgumentError("episodes: expected end() after the last step of an episode, got none")


class Episodes:
    """Adds steps to a dataset of episodes: see :func:`episodes`.

    Attributes:
        ended: how many episodes are complete.
        steps: how many steps the running one has.
    """

    def __init__(
        self,
        *,
        writer: Writer,
        cameras: Mapping[str, RigCamera],
        is_rig: bool,
        fps: float,
        task: str,
        modes: tuple[str, ...],
        options: RenderOptions,
    ) -> None:
        """Take what :func:`episodes` does.

        Args:
            writer: of the dataset, open.
            cameras: by name, in the frame of their rig.
            is_rig: whether one pose is that of all.
            fps: steps a second.
            task: what is done.
            modes: what is rendered.
            options: how it is rendered.
        """
        self.ended = 0
        self.steps = 0
        self._steps_before = 0  # of the episodes that are complete
        self._writer = writer
        self._cameras = dict(cameras)
        self._is_rig = is_rig
        self._fps = fps
        self._task = task
        self._modes = modes
        self._options = options
        self._renderer: Renderer | None = None

    def add(
        self,
        source: Source,
        pose: Pose | Mapping[str, Pose],
        *,
        state: ArrayLike | None = None,
        action: ArrayLike | None = None,
    ) -> None:
        """Render a step of an episode as the source shows it now, and write its frames.

        Args:
            source: of captures, such as :func:`omniscv.sources.mujoco.from_model` gives it.
            pose: of the rig, or of each camera by its name; world frame.
            state: (S,) what the robot feels; all steps have one, or none.
            action: (A,) what it does next; likewise.

        Raises:
            ArgumentError: a camera without a pose, or a state or an action that is no vector of numbers.
        """
        if self._renderer is None:
            self._renderer = Renderer(source)
        elif self._renderer.source is not source:
            self._renderer = self._renderer.of(source)
        record = {"index": self.ended, "step": self.steps, "task": self._task}
        for name, value in (("state", state), ("action", action)):
            if value is not None:
                record |= _recorded(name, value)
        poses = self._poses(pose)
        views = [(mounted.camera, poses[name]) for name, mounted in self._cameras.items()]
        images = self._renderer.render_together(views, self._modes, self._options)
        for name, image in zip(self._cameras, images, strict=True):
            frame = Frame(
                key=f"{name}-{self.ended:04d}-{self.steps:05d}",
                camera_name=name,
                camera=image.camera,
                pose=image.pose,
                time_ns=nanoseconds((self._steps_before + self.steps) / self._fps),
                place=f"episode-{self.ended:04d}",
                scene=str(image.provenance.get("scene", "")),
            )
            self._writer.write(*self._writer.with_ids(frame, image), {"truth": {EPISODE: record}})
        self.steps += 1

    def end(self) -> None:
        """End the running episode; ArgumentError for one without steps."""
        if not self.steps:
            raise ArgumentError("episodes: expected steps before end(), got none")
        self.ended += 1
        self._steps_before += self.steps
        self.steps = 0

    def _poses(self, pose: Pose | Mapping[str, Pose]) -> dict[str, Pose]:
        """Return the pose of each camera."""
        if isinstance(pose, Pose):
            if not self._is_rig:
                raise ArgumentError(f"pose: expected one of each of {', '.join(self._cameras)}, got one")
            return {name: pose @ mounted.pose for name, mounted in self._cameras.items()}
        if pose.keys() != self._cameras.keys():
            listed = ", ".join(pose) or "none"
            raise ArgumentError(f"pose: expected one of each of {', '.join(self._cameras)}, got {listed}")
        return dict(pose)


def _mounted(rig: Rig | Camera | Mapping[str, Camera]) -> dict[str, RigCamera]:
    """Return cameras by name, and where they are in their rig."""
    if isinstance(rig, Rig):
        for name, mounted in rig.cameras.items():
            if mounted.time_offset:
                offset = f"{mounted.time_offset:g} s for {name}"
                raise ArgumentError(
                    f"rig: expected cameras without time offsets, got {offset}: a step is one instant"
                )
        return dict(rig.cameras)
    if isinstance(rig, Camera):
        return {"camera": RigCamera(rig)}
    return {stem("camera", name): RigCamera(camera) for name, camera in rig.items()}


def _recorded(name: str, value: ArrayLike) -> dict[str, Any]:
    """Return a state or an action as plain values: float32 and whole numbers keep their type."""
    vector = np.atleast_1d(np.asarray(value))
    if vector.ndim != 1 or vector.dtype.kind not in "fiu" or not np.isfinite(vector).all():
        raise ArgumentError(
            f"{name}: expected a vector of finite numbers, got {vector.dtype} of {vector.shape}"
        )
    return {name: vector.tolist(), f"{name}_dtype": vector.dtype.name}
