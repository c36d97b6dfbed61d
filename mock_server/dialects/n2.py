"""Dialect N2: plugin 1.0.1 of branch 5.2 since 2026-03, after its refactoring."""

from __future__ import annotations

import re
from typing import Any

from mock_server.dialects.common import Row, ok
from mock_server.dialects.modern import BAD_ARGUMENT, Modern
from mock_server.protocol import Command
from mock_server.world import Camera, SceneObject

_LIT_SOURCES = ("ftc_hdr", "fc_hdr", "sc_hdr", "scna_hdr", "ldr",
                "base", "color_depth", "scene_depth", "device_depth", "normal")  # fmt: skip
_CHOICES = {
    "lit_source": ("lit source", _LIT_SOURCES),
    "reflection": ("reflection method", ("none", "lumen", "screen_space")),
    "illumination": ("global illumination method", ("none", "lumen", "screen_space", "plugin")),
    "exposure_method": ("exposure method", ("histogram", "basic", "manual")),
}
_NUMBERS = {
    "exposure_bias": "[float]",
    "auto_speed": "[float] [float]",
    "auto_brightness": "[float] [float]",
    "physical_exposure": "[uint]",
    "motion_blur": "[float] [float] [float] [uint]",
    "focal": "[float] [float]",
}


class N2(Modern):
    """UTF-8, at most 32 requests a frame, batches that hold, other error texts, capture controls."""

    version = "1.0.1"
    unknown = "error No handler found for URI '{}'"
    no_object = "error Cannot find object"
    request = re.compile(rb"(\d+):(.*)")
    has_unix = True
    encoding = "utf-8"
    requests_per_frame = 32

    def parse(self, payload: bytes) -> tuple[int, str] | None:
        parsed = super().parse(payload)
        return parsed and (max(0, parsed[0]), parsed[1])

    def match(self, each: Command, text: str) -> tuple[Any, ...] | None:
        """The first word must be the template's."""
        if text.split(" ")[0] != each.template.split(" ")[0]:
            return None
        return each.match(text)

    def status(self) -> str:
        return re.sub(r"FOV: .*", f"FOV: {self.settings.fov_deg:.1f}", super().status()).rstrip("\n")

    def class_name(self, o: SceneObject) -> str:
        return "StaticMeshActor"

    def rows(self) -> list[Row]:
        alias = "error Unrecognised alias '{}'"
        rows = [row for row in super().rows() if row[0] != "vrun [str]"]
        return [("vrun [str]", "Runs an alias", alias.format), *rows]

    def run_rows(self) -> list[Row]:
        return [
            ("vcmd [str]", "Runs a console command of one word", ok),
            *(row for row in super().run_rows() if not row[0].startswith("vbatch")),
            ("vbatch [uint]", "Holds that many requests, and answers them in one frame", self._hold),
        ]

    def camera_rows(self) -> list[Row]:
        at = "vset /camera/[uint]"
        choices: list[Row] = [
            (f"{at}/{key} [str]", f"Sets the {what}", self.with_camera(_choose(what, words), BAD_ARGUMENT))
            for key, (what, words) in _CHOICES.items()
        ]
        settings: list[Row] = [
            (f"{at}/{key} {form}", f"Sets {key}", self.with_camera(ok, BAD_ARGUMENT))
            for key, form in _NUMBERS.items()
        ]
        return [*super().camera_rows(), *choices, *settings]

    def _hold(self, count: int) -> str:
        self.held = count
        return "ok"


def _choose(what: str, words: tuple[str, ...]) -> Any:
    def handler(_: Camera, word: str) -> str:
        if word.lower() in words:
            return "ok"
        options = ", ".join(words[:-1]) + f" and {words[-1]}"
        return f"error Can not support {what} {word}, available options are {options}"

    return handler
