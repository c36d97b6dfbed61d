"""An omnidirectional image and its ground truth."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from omniscv import light
from omniscv.cameras import Camera
from omniscv.compose import files, pictures
from omniscv.compose.layers import doubt_of
from omniscv.errors import ArgumentError
from omniscv.geometry import Array, Pose
from omniscv.geometry.arrays import Mask
from omniscv.modalities import Transfer
from omniscv.render_options import RenderOptions
from omniscv.sources.base import Color, ObjectTable

if TYPE_CHECKING:
    from PIL.Image import Image

_REPORTS = "seams", "light"  # in the provenance: what composition did to colours, and found


@dataclass(frozen=True)
class Effort:
    """What an image took.

    Attributes:
        captures: requests, over all modes.
        megapixels: captured, over all modes.
        stopped: why captures did not become finer: ``aim`` where the accuracy is reached; empty for images
            that have none.
        strategy: that made the captures: ``exact`` where the source cannot do what ``auto`` needs.
        traced: modes that took no captures: the source told what rays meet, one of each pixel or, of colours,
            several.
    """

    captures: int = 0
    megapixels: float = 0.0
    stopped: str = ""
    strategy: str = ""
    traced: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False, repr=False)
class OmniImage:
    """An image that :func:`omniscv.render` returns. Indexing gives a layer: ``image["depth"]``.

    Attributes:
        camera, pose: of the image.
        valid: (H, W) bool, the pixel is inside the field of view, and was seen (``unseen="blank"``).
        layers: by the names of :mod:`omniscv.modalities`: those that were requested, and derived ones.
        centers_w: (H, W, 3) or (3,), where depth is measured from, world frame, metres.
        objects: names and mask colours; None without labels.
        unknown_colors: mask colours that no object has, and the number of their pixels.
        transfer: what 8-bit colours say of light (:mod:`omniscv.light`), as the source declares it.
        provenance: where the captures came from.
        options: how it was captured and composed.
        effort: what it took.
    """

    camera: Camera
    pose: Pose
    valid: Mask
    layers: Mapping[str, NDArray[Any]]
    centers_w: Array
    objects: ObjectTable | None = None
    unknown_colors: Mapping[Color, int] = field(default_factory=dict)
    transfer: Transfer = "unknown"
    provenance: Mapping[str, Any] = field(default_factory=dict)
    options: RenderOptions = field(default_factory=RenderOptions)
    effort: Effort = field(default_factory=Effort)

    def __getitem__(self, layer: str) -> NDArray[Any]:
        if layer not in self.layers:
            raise ArgumentError(f"layer: expected one of {', '.join(self.layers)}; got {layer!r}")
        return self.layers[layer]

    @property
    def lit(self) -> NDArray[Any] | None:
        """(H, W, 3) RGB, as captured: uint8 from servers. None if not requested, as for all layers."""
        return self.layers.get("lit")

    @property
    def object_mask(self) -> NDArray[np.uint8] | None:
        """(H, W, 3) uint8 RGB, only colours that were captured."""
        return self.layers.get("object_mask")

    @property
    def labels(self) -> NDArray[np.uint16] | None:
        """(H, W) uint16; 0 where nothing is known."""
        return self.layers.get("labels")

    @property
    def depth(self) -> NDArray[np.float32] | None:
        """(H, W) float32 metres along the ray; +inf no surface, 0 outside the field of view."""
        return self.layers.get("depth")

    @property
    def normals(self) -> NDArray[np.float32] | None:
        """(H, W, 3) float32 unit vectors, camera frame; 0 where unknown."""
        return self.layers.get("normals")

    @property
    def depth_error(self) -> NDArray[np.float32] | None:
        """(H, W) float32 metres: bound on the error of depth along the pixel's own ray; +inf where nothing
        bounds it, 0 outside the field of view."""
        return self.layers.get("depth_error")

    @property
    def label_edge(self) -> Mask | None:
        """(H, W) bool: within a capture's pixel of a label boundary: the label may be the neighbour's."""
        return self.layers.get("label_edge")

    @property
    def unsure(self) -> Mask | None:
        """(H, W) bool: not verified by any capture."""
        return self.layers.get("unsure")

    @property
    def occluded(self) -> Mask | None:
        """(H, W) bool: the pixel's optical centre is not visible from the camera's position, for example
        beyond a wall; None for a single centre, and where that is not known."""
        return self.layers.get("occluded")

    @property
    def unseen(self) -> float:
        """Share of the pixels inside the field of view, 0 to 1, that no recorded view shows; they are not
        valid."""
        unseen = self.layers.get("unseen")
        missing = 0 if unseen is None else int(np.count_nonzero(unseen))
        return missing / max(missing + int(np.count_nonzero(self.valid)), 1)

    @property
    def doubt(self) -> Mask:
        """(H, W) bool: the label or depth may be wrong, as far as the image has them.

        Pixels of ``label_edge`` and ``unsure``, and those whose depth may be off by more than 1 % of it.
        """
        return doubt_of(self.layers, self.valid.shape) & self.valid

    @property
    def doubtful(self) -> float:
        """Share of the valid pixels, 0 to 1, that are in ``doubt``."""
        return float(self.doubt[self.valid].mean()) if self.valid.any() else 0.0

    @property
    def seconds(self) -> float:
        """Modelled time of the captures, one after the other, by ``options.capture_ms``."""
        request_ms, megapixel_ms = self.options.capture_ms
        return (request_ms * self.effort.captures + megapixel_ms * self.effort.megapixels) / 1e3

    def points(self) -> Array:
        """Return (N, 3) world points, metres, of the pixels with finite depth, row by row.

        Raises:
            ArgumentError: the image has no depth.
        """
        if self.depth is None:
            raise ArgumentError(
                "points: expected an image with depth, got none; render with modes=('depth', ...)"
            )
        seen = self.valid & np.isfinite(self.depth) & (self.depth > 0)
        directions_w = self.camera.unproject().directions[seen] @ self.pose.R_w_c.T
        centers_w = np.broadcast_to(self.centers_w, (*seen.shape, 3))[seen]
        return centers_w + self.depth[seen, None].astype(np.float64) * directions_w

    def save(
        self,
        out: str | Path,
        stem: str = "image",
        image_format: str = "png",
        store: str = "files",
        depth_format: str = "exr",
        doubt: bool = False,
    ) -> list[Path]:
        """Write the layers into a folder; see :mod:`omniscv.compose.files`.

        Args:
            out: the folder; made if it is not there.
            stem: start of the file names.
            image_format: ``png`` or ``jpg``, for lit.
            store: ``files``, pictures that other programs read; ``fast``, arrays of Blosc2.
            depth_format: ``exr``, ``tiff`` or ``npy``, for depth, its bounds and normals.
            doubt: whether :attr:`doubt` is written, too.

        Returns:
            The files, each written whole or not at all.
        """
        forms = files.Forms(image_format=image_format, store=store, depth_format=depth_format)
        layers = {**self.layers, "doubt": self.doubt} if doubt else self.layers
        return files.write(layers, self.description(), self.objects, Path(out), stem, **forms)

    def to_srgb(self) -> NDArray[np.uint8]:
        """Return (H, W, 3) colours as sRGB codes; 8-bit ones of an unknown transfer as they are.

        Raises:
            ArgumentError: the image has no colours.
        """
        lit = self["lit"]
        if lit.dtype == np.uint8 and self.transfer in ("srgb", "unknown"):
            return lit
        return light.encode(light.decode(lit, self.transfer), "srgb")

    def __repr__(self) -> str:
        size = f"{self.camera.width}x{self.camera.height}"
        return f"<OmniImage {self.camera.name} {size}: {', '.join(self.layers)}>"

    def to_pil(self, layer: str | None = None) -> Image:
        """Return a layer as a picture, RGB of the image's size, or a sheet of all layers.

        Labels, depth and normals are in colours; see :mod:`omniscv.compose.pictures`.

        Raises:
            ArgumentError: the image has no such layer.
        """
        from PIL import Image

        if layer is None:
            return pictures.sheet(self)
        self[layer]  # raises
        return Image.fromarray(pictures.picture(self, layer))

    def show(self, layer: str | None = None) -> None:
        """Show the picture of :meth:`to_pil`: in a notebook, else in the system's viewer of pictures."""
        shown = self.to_pil(layer)
        notebook = sys.modules.get("IPython")
        if notebook is not None and notebook.get_ipython() is not None:
            import_module("IPython.display").display(shown)
        else:
            shown.show()

    def _repr_png_(self) -> bytes:
        """The sheet of layers, which a notebook shows."""
        encoded = BytesIO()
        self.to_pil().save(encoded, "PNG")
        return encoded.getvalue()

    def description(self) -> dict[str, Any]:
        """Return the plain values of ``STEM.json``."""
        reports = {}
        source = {}
        for key, value in self.provenance.items():
            if key not in _REPORTS:
                source[key] = value
        for key in _REPORTS:
            if key in self.provenance:
                reports[key] = self.provenance[key]
        reached = {}
        if self.effort.stopped:
            effort = asdict(self.effort)
            if not self.effort.traced:
                del effort["traced"]
            reached = {"accuracy": {**effort, "doubtful": self.doubtful, "seconds": self.seconds}}
        transfer = {}
        if self.lit is not None and self.transfer != "unknown":
            transfer = {"transfer": self.transfer}
        unseen = {"unseen": self.unseen} if self.options.unseen == "blank" else {}
        return {
            "camera": self.camera.to_dict(),
            "pose": self.pose.to_dict(),
            "options": asdict(self.options),
            **transfer,
            **reached,
            **unseen,
            "source": source,
            **reports,
            "unsure_pixels": _count(self.unsure),
            "occluded_pixels": _count(self.occluded),
            "unknown_mask_colors": [[*color, count] for color, count in self.unknown_colors.items()],
        }


def _count(mask: Mask | None) -> int | None:
    return None if mask is None else int(np.count_nonzero(mask))
