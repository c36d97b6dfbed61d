"""A camera of any model as JSON (or YAML): what ``camera.to_dict()`` gives, by our pixel rule."""

import json
from collections.abc import Mapping

from omniscv.calibration.common import mapping, only_camera
from omniscv.cameras import Camera, from_dict


def read_json(text: str) -> dict[str, Camera]:
    """Return the camera, named ``cam0``, that ``camera.to_dict()`` described.

    Raises:
        ArgumentError: no JSON or YAML, or as :func:`omniscv.cameras.from_dict`.
    """
    return {"cam0": from_dict(mapping(text))}


def write_json(cameras: Mapping[str, Camera]) -> str:
    """Return the JSON of one camera; its name is not carried.

    Raises:
        ArgumentError: not exactly one camera.
    """
    _, camera = only_camera(cameras, "our JSON")
    return json.dumps(camera.to_dict(), indent=1)
