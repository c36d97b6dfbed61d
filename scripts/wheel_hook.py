"""Build hook of wheels: each has the built kernels of one platform, and its tag; another one has none.

OMNISCV_WHEEL names the platform, as libraries are named, or is "any". Without it a wheel is for this machine,
if that has a library. A source distribution has the libraries that are committed.
"""

import os
import platform
import sys
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

TAGS = {
    "linux-x86_64": "py3-none-manylinux_2_17_x86_64",
    "linux-aarch64": "py3-none-manylinux_2_17_aarch64",
    "darwin-arm64": "py3-none-macosx_11_0_arm64",
    "win32-amd64": "py3-none-win_amd64",
    "any": "py3-none-any",
}


class WheelHook(BuildHookInterface[Any]):
    """Leaves out the libraries of other platforms, and sets the wheel's tag."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Set what hatchling builds, but for editable installations, which use the folder as it is."""
        if version == "editable":
            return
        built = {path.stem for path in Path(self.root, "omniscv", "kernels").glob("*.so")}
        choices = [name for name in TAGS if name in built or name == "any"]
        here = f"{sys.platform}-{platform.machine().lower()}"
        name = os.environ.get("OMNISCV_WHEEL") or (here if here in choices else "any")
        if name not in choices:
            raise ValueError(f"OMNISCV_WHEEL: expected one of {', '.join(choices)}, got {name!r}")
        build_data["tag"] = TAGS[name]
        # linux-x86_64-v3 and -v4 are of linux-x86_64, for newer processors.
        others = [library for library in built if not f"{library}-".startswith(f"{name}-")]
        self.build_config.target_config["exclude"] = [f"*/kernels/{library}.so" for library in others]
