"""The key ``of`` of a job's cameras: they are where a camera of the scene itself is (docs/job.md)."""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from omniscv.arguments import shown, text
from omniscv.cameras import Camera
from omniscv.cameras.rolling_shutter import readout_of
from omniscv.errors import ArgumentError

_PLACEHOLDER = {"model": "pinhole", "width": 640, "height": 480, "fov_deg": 90.0}
_ANYWHERE = {"position": [0.0, 0.0, 0.0]}


class OwnCamera(NamedTuple):
    """Which camera of the scene a job's camera follows.

    Attributes:
        name: in the scene.
        has_lens: whether the job's camera has its own lens and size; else the source gives those of the
            scene's camera, and the job's is a placeholder until then.
    """

    name: str
    has_lens: bool


def split_own_cameras(values: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, OwnCamera]]:
    """Return the keys of a job without ``of`` in its cameras, and what that said, by camera.

    A job all of whose cameras follow the scene's has no poses of its own; until its source is open, they are
    somewhere.

    Raises:
        ArgumentError: no name, or poses that no camera takes.
    """
    described = values.get("cameras")
    own: dict[str, OwnCamera] = {}
    if not isinstance(described, Mapping):
        return dict(values), own
    cameras = dict(described)
    for camera, keys in described.items():
        if not isinstance(keys, Mapping) or "of" not in keys:
            continue
        lens = dict(keys)
        name = lens.pop("of")
        has_lens = lens != {"model": "pinhole"}
        own[camera] = OwnCamera(text(f"cameras.{camera}.of", name), has_lens)
        cameras[camera] = lens if has_lens else _PLACEHOLDER
    values = {**values, "cameras": cameras}
    if own and own.keys() == cameras.keys() and values.get("rig") is None:
        if values.get("poses") is not None:
            wanted = "expected none, as every camera is 'of' one of the scene, which has a pose"
            raise ArgumentError(
                f"poses: {wanted}, got {shown(values['poses'])}; write a job's file without them"
            )
        values["poses"] = [_ANYWHERE]
    return values, own


def check_own_cameras(
    own: Iterable[str], cameras: Mapping[str, Camera], exposure_s: float, draws_per_place: bool
) -> None:
    """Refuse what the scene's cameras, whose poses are known at the times of images alone, cannot do.

    Args:
        own: names of the job's cameras that follow the scene's.
        cameras: all cameras of the job.
        exposure_s: for which the shutter is open, seconds.
        draws_per_place: whether what is drawn depends on the places of poses.

    Raises:
        ArgumentError: an exposure, a camera that takes time to read, or draws for each place.
    """
    for name in own:
        if exposure_s:
            wanted = f"expected 0 for {name!r}, which is 'of' a camera of the scene"
            raise ArgumentError(f"exposure.seconds: {wanted}, got {exposure_s:g}")
        if name in cameras and (readout := readout_of(cameras[name])):
            wanted = "expected a camera that takes its image at once, with 'of'"
            raise ArgumentError(f"cameras.{name}: {wanted}, got a readout of {readout:g} s")
        if draws_per_place:
            wanted = f"expected frame or world for {name!r}, whose place depends on what is drawn"
            raise ArgumentError(f"vary.per: {wanted}, got place")
