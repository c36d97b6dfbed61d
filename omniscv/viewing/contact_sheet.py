"""One picture of many images, for a person to look at: colour, masks and depth side by side."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from omniscv.compose.image import OmniImage
from omniscv.sources.base import ObjectTable

_MODELS_PER_ROW = 3
_WIDTH_IN = 19.0
_DPI = 140
_GAP = 0.12
_INK, _PAPER, _OUTSIDE = "#1c2330", "#ffffff", "#e6e9ee"


def contact_sheet(images: Mapping[str, OmniImage], objects: ObjectTable, path: Path, title: str) -> Path:
    """Draw images in lit, object_mask and depth, three models a row, wide ones first.

    Args:
        images: caption to image; each has all three modes.
        objects: for the legend of the masks.
        path: the PNG to write.
        title: printed on top.

    Returns:
        ``path``.
    """
    rows = _rows(images)
    farthest = _farthest(images.values())
    heights = [max(image.camera.height / image.camera.width for _, image in row) for row in rows]
    cell_in = _WIDTH_IN / _MODELS_PER_ROW / 3
    height_in = sum(heights) * cell_in + 0.42 * len(rows) + 2.3
    figure = Figure(figsize=(_WIDTH_IN, height_in), dpi=_DPI, facecolor=_PAPER)
    figure.text(0.012, 1 - 0.42 / (height_in), title, size=19, weight="bold", color=_INK, va="center")
    grid = figure.add_gridspec(
        len(rows),
        4 * _MODELS_PER_ROW - 1,
        width_ratios=([1, 1, 1, _GAP] * _MODELS_PER_ROW)[:-1],
        height_ratios=[h * cell_in + 0.42 for h in heights],
        left=0.008,
        right=0.992,
        top=1 - 0.95 / (height_in),
        bottom=1.3 / (height_in),
        wspace=0.02,
        hspace=0.0,
    )
    for i, row in enumerate(rows):
        for j, (caption, image) in enumerate(row):
            axes = [figure.add_subplot(grid[i, 4 * j + k]) for k in range(3)]
            _draw_image(axes, caption, image, farthest)
    _draw_depth_bar(figure, farthest, height_in)
    _draw_legend(figure, images.values(), objects, height_in)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    return path


def _rows(images: Mapping[str, OmniImage]) -> list[list[tuple[str, OmniImage]]]:
    """Images of about one shape share a row, the widest first, so that no row wastes height."""
    ordered = sorted(images.items(), key=lambda item: -round(item[1].camera.width / item[1].camera.height, 1))
    return [ordered[start : start + _MODELS_PER_ROW] for start in range(0, len(ordered), _MODELS_PER_ROW)]


def _layers(image: OmniImage) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    if image.lit is None or image.object_mask is None or image.depth is None:
        raise ValueError("contact_sheet: expected images with lit, object_mask and depth")
    return image.lit, image.object_mask, image.depth


def _farthest(images: Any) -> float:
    """The depth that the colours end at: all but the last percent of what is seen."""
    seen = [depth[np.isfinite(depth) & (depth > 0)] for depth in (_layers(image)[2] for image in images)]
    values = np.concatenate(seen)
    return float(np.ceil(np.quantile(values, 0.99))) if values.size else 1.0


def _draw_image(axes: Sequence[Axes], caption: str, image: OmniImage, farthest: float) -> None:
    lit, mask, depth = _layers(image)
    outside = ~image.valid
    for ax, picture in zip(axes, (lit, mask, colored_depth(depth, farthest)), strict=True):
        shown = picture.copy()
        shown[outside] = tuple(int(_OUTSIDE[i : i + 2], 16) for i in (1, 3, 5))
        ax.imshow(shown, interpolation="lanczos" if ax is axes[0] else "nearest")
        ax.set_axis_off()
        ax.set_anchor("N")
    name, _, note = caption.partition("\n")
    axes[0].set_title(name, loc="left", size=11, weight="bold", color=_INK, pad=4)
    if note:
        axes[2].set_title(note, loc="right", size=9, color="#5b6472", pad=4)


def colored_depth(depth: NDArray[np.float32], farthest: float) -> NDArray[np.uint8]:
    """Return (H, W, 3) RGB of depth (H, W): red is near, blue is ``farthest`` metres, white no surface."""
    finite = np.where(np.isfinite(depth), depth, farthest)
    rgba = colormaps["turbo_r"](np.clip(finite / farthest, 0, 1), bytes=True)
    rgb: NDArray[np.uint8] = rgba[..., :3].copy()
    rgb[np.isinf(depth)] = 255
    return rgb


def _draw_depth_bar(figure: Figure, farthest: float, height_in: float) -> None:
    ax = figure.add_axes((0.012, 0.62 / height_in, 0.22, 0.2 / height_in))
    ax.imshow(colored_depth(np.linspace(1e-3, farthest, 512, dtype=np.float32)[None], farthest),
              aspect="auto", extent=(0, farthest, 0, 1))  # fmt: skip
    ax.set_yticks([])
    ax.tick_params(labelsize=10, colors=_INK)
    ax.set_xlabel("depth along the ray, metres (white: sky)", size=10, color=_INK)


def _draw_legend(figure: Figure, images: Any, objects: ObjectTable, height_in: float) -> None:
    seen = {tuple(color) for image in images for color in np.unique(_layers(image)[1].reshape(-1, 3), axis=0)}
    patches = [
        Patch(facecolor="#{:02x}{:02x}{:02x}".format(*objects.colors[name]), edgecolor="#9aa3b0", label=name)
        for name in objects.names()
        if tuple(objects.colors[name]) in seen
    ]
    figure.legend(handles=patches, loc="lower right", bbox_to_anchor=(0.992, 0.0), frameon=False,
                  ncols=max(1, -(-len(patches) // 4)), fontsize=8.5, handlelength=1.2, handleheight=1.0,
                  columnspacing=1.2, labelcolor=_INK)  # fmt: skip
