"""Cameras of a job that are 'of' cameras of the scene: their poses and lenses in an open source."""

from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import replace

from omniscv.arguments import one_of, shown
from omniscv.cameras import Camera, create
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.trajectory import Poses
from omniscv.job import Job
from omniscv.make.instants import instants_of
from omniscv.sources.base import Source, View


def with_own_cameras(job: Job, source: Source) -> Job:
    """Return a job whose cameras have the poses, and where they have no lens the views, of the scene's.

    Args:
        job: with what is drawn for it in the open source; one whose poses are known already stays as it is.
        source: its open source.

    Raises:
        ArgumentError: the scene has no cameras, or none of a name.
    """
    if not job.own_cameras or job.own_poses:
        return job
    poses: dict[str, list[Pose]] = {name: [] for name in job.own_cameras}
    cameras: dict[str, Camera] = dict(job.cameras)
    for number, instant in enumerate(instants_of(job)):
        with source.at(instant) if instant.state else nullcontext(source) as still:
            views = still.own_views()
        for name, own in job.own_cameras.items():
            view = _view(f"cameras.{name}.of", own.name, views, source)
            poses[name].append(view.pose)
            if number == 0 and not own.has_lens:
                size = {"width": view.width, "height": view.height}
                cameras[name] = create("pinhole", **size, fov_deg=view.fov_deg)
    own_poses = {}
    for name, of_camera in poses.items():
        own_poses[name] = Poses.of(of_camera)
    are_all_own = own_poses.keys() == cameras.keys()
    shared_poses = next(iter(own_poses.values())) if are_all_own else job.poses
    return replace(job, cameras=cameras, own_poses=own_poses, poses=shared_poses)


def _view(key: str, name: str, views: Mapping[str, View], source: Source) -> View:
    """Return one of a scene's views; ArgumentError naming the key of a job without it."""
    if views:
        return views[one_of(key, name, views)]
    dialect = source.capabilities.dialect
    what = "a recording" if source.recorded_views() is not None else f"{dialect or 'a source'} without any"
    wanted = f"expected {shown(name)} of a scene with cameras of its own, such as a MuJoCo model's"
    raise ArgumentError(f"{key}: {wanted}, got {what}; leave 'of' out, and write 'poses'")
