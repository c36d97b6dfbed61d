"""Materials and pictures of glTF files."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from omniscv.arguments import numbers, shown
from omniscv.errors import ArgumentError
from omniscv.geometry import Array
from omniscv.sources.mesh.gltf import Gltf
from omniscv.sources.mesh.materials import CLAMP, MIRROR, REPEAT, Material, Texture
from omniscv.sources.mesh.pictures import Pictures

_WRAPS = {10497: REPEAT, 33071: CLAMP, 33648: MIRROR}
_NEAREST = 9728
_DEFAULT_CUTOFF = 0.5
CONVERT_KTX = "convert them: npx @gltf-transform/cli ktxdecompress IN.glb OUT.glb, or toktx's ktx extract"


@dataclass(frozen=True)
class Covering:
    """A material, and how its picture lies on faces.

    Attributes:
        material: what faces show.
        uv_set: the number of the ``TEXCOORD`` that is used.
        uv_transform: (2, 3) of KHR_texture_transform, or None.
    """

    material: Material
    uv_set: int = 0
    uv_transform: Array | None = None


class Coverings:
    """The materials of a file; each is read once.

    Attributes:
        colorless: why colours cannot be shown; empty where they can.
    """

    def __init__(self, gltf: Gltf) -> None:
        self._gltf = gltf
        self._pictures = Pictures()
        self._read: dict[int | None, Covering] = {}
        self._textures: dict[tuple[Any, Any], Texture] = {}
        self.colorless = ""

    def get(self, number: int | None) -> Covering:
        """Return a material by its number; the format's default for None."""
        if number not in self._read:
            self._read[number] = self._material(number)
        return self._read[number]

    def _material(self, number: int | None) -> Covering:
        if number is None:
            return Covering(Material(double_sided=False))
        gltf = self._gltf
        entry = gltf.item("materials", number)
        where = f"material {number}"
        surface = gltf.record(entry, "pbrMetallicRoughness")
        gloss = gltf.extension(entry, "KHR_materials_pbrSpecularGlossiness")
        if gloss is None:
            color = numbers(f"{where}: baseColorFactor", surface.get("baseColorFactor", [1] * 4), (4,))
            picture = gltf.record(surface, "baseColorTexture")
        else:
            color = numbers(f"{where}: diffuseFactor", gloss.get("diffuseFactor", [1] * 4), (4,))
            picture = gltf.record(gloss, "diffuseTexture")
        mode = entry.get("alphaMode", "OPAQUE")
        if mode not in ("OPAQUE", "MASK", "BLEND"):
            raise ArgumentError(f"{where}: expected alphaMode OPAQUE, MASK or BLEND, got {shown(mode)}")
        cutoff = numbers(f"{where}: alphaCutoff", [entry.get("alphaCutoff", _DEFAULT_CUTOFF)], (1,))
        red, green, blue, alpha = color.tolist()
        material = Material(
            name=str(entry.get("name") or f"material {number}"),
            color=(red, green, blue, alpha),
            texture=self._texture(picture, where) if picture else None,
            cutoff=float(cutoff[0]) if mode == "MASK" else 0.0,
            blended=mode == "BLEND",
            double_sided=entry.get("doubleSided") is True,
            unlit=gltf.extension(entry, "KHR_materials_unlit") is not None,
        )
        transform = gltf.extension(picture, "KHR_texture_transform")
        uv_set = picture.get("texCoord", 0)
        if transform is None:
            return Covering(material, uv_set)
        return Covering(material, transform.get("texCoord", uv_set), _uv_transform(transform, where))

    def _texture(self, info: dict[str, Any], where: str) -> Texture | None:
        """Return the picture that a material names; None where no colours can be shown."""
        gltf = self._gltf
        texture = gltf.item("textures", info.get("index"))
        webp = gltf.extension(texture, "EXT_texture_webp")
        number = texture.get("source") if webp is None else webp.get("source")
        if number is None:
            if gltf.extension(texture, "KHR_texture_basisu") is not None:
                self.colorless = f"expected textures of PNG, JPEG or WebP, got KTX2; {CONVERT_KTX}"
                return None
            raise ArgumentError(f"{where}: expected a texture with a picture, got none")
        key = (number, texture.get("sampler"))
        if key not in self._textures:
            image = gltf.item("images", number)
            if "bufferView" in image:
                data: Any = bytes(gltf.view_bytes(image["bufferView"]))
            else:
                data = gltf.uri_bytes(image.get("uri"))
            sampler = {} if key[1] is None else gltf.item("samplers", key[1])
            wrap = (_WRAPS.get(sampler.get("wrapS", 0), REPEAT), _WRAPS.get(sampler.get("wrapT", 0), REPEAT))
            pixels = self._pictures.read(data, f"image {number}")
            self._textures[key] = Texture(pixels, wrap, sampler.get("magFilter") == _NEAREST)
        return self._textures[key]


def _uv_transform(transform: dict[str, Any], where: str) -> Array:
    """Return (2, 3) of KHR_texture_transform: scaled, turned, then moved."""
    offset = numbers(f"{where}: offset", transform.get("offset", [0, 0]), (2,))
    scale = numbers(f"{where}: scale", transform.get("scale", [1, 1]), (2,))
    (angle,) = numbers(f"{where}: rotation", [transform.get("rotation", 0)], (1,))
    cosine = np.cos(angle)
    sine = np.sin(angle)
    turned = np.array([[cosine, sine], [-sine, cosine]])
    return np.column_stack([turned * scale, offset])
