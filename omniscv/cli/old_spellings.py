"""Options from before ``--set``: they work in this version, become ``--set``, and are not in the help."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from typer.core import TyperCommand


def _parameter(text: str, prefix: str = "") -> str:
    """Return ``NAME=VALUE`` for ``--set``: a list such as ``k=0.1,0.2`` gets its brackets."""
    name, equals, value = text.partition("=")
    is_list = "," in value and not value.lstrip().startswith(("[", "{"))
    return f"{prefix}{name}{equals}{f'[{value}]' if is_list else value}"


Renamed = Mapping[str, Callable[[str], str]]
"""By old option, the function from its value to that of ``--set``."""

OF_JOBS: Renamed = {
    "--fov": "camera.fov_deg={}".format,
    "--param": partial(_parameter, prefix="camera."),
    "--strategy": "strategy={}".format,
    "--viewpoints": "viewpoints={}".format,
    "--face-size": "face_size={}".format,
    "--filter": "filter={}".format,
    "--max-error": lambda text: f"max_error_px={text.removesuffix('px')}",
    "--normals": "normals={}".format,
    "--truth-scale": "truth_scale={}".format,
    "--timeout": "source_options.timeout_s={}".format,
    "--patience": "source_options.patience_s={}".format,
    "--freeze": "freeze={}".format,
    "--record": "record={}".format,
    "--image-format": "image_format={}".format,
}
OF_FIT: Renamed = {"--fov": "fov_deg={}".format, "--param": _parameter}
OF_FORMATS: Renamed = {"--option": str}


def as_settings(arguments: Sequence[str], renamed: Renamed) -> list[str]:
    """Return command-line arguments with ``--set KEY=VALUE`` in place of old options."""
    words, rest = list[str](), iter(arguments)
    for word in rest:
        option, equals, value = word.partition("=")
        if option in renamed:
            values = [value] if equals else [text for text in [next(rest, None)] if text is not None]
            words += ["--set", *map(renamed[option], values)]
        else:
            words.append(word)
    return words


def accepting(renamed: Renamed) -> type[TyperCommand]:
    """Return the class of a command that takes old options, too."""

    class Accepting(TyperCommand):
        def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
            return super().parse_args(ctx, as_settings(args, renamed))

    return Accepting
