"""Pages that a stranger reads before believing: a dataset's card, and descriptions that programs read.

``README.md`` is a dataset card with front matter, ``croissant.json`` a description in Croissant 1.1, whose
record set are the frames, ``codemeta.json`` and ``.zenodo.json`` what archives of research ask for. Only the
share of pixels in doubt is measured for them, of at most :data:`SAMPLED` frames.
"""

import hashlib
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from omniscv.arguments import text
from omniscv.dataset import manifest
from omniscv.dataset.manifest import FRAMES, Manifest
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.storage.local import LocalFolder, write_bytes

SAMPLED = 200
"""Frames, evenly spread, whose marks are read for the share of pixels in doubt."""
CARD = "README.md"
CROISSANT = "croissant.json"
CODEMETA = "codemeta.json"
ZENODO = ".zenodo.json"
UNKNOWN = "unknown"
"""The licence of a dataset for which none was given."""
_MARK = "<!-- written by omniscv dataset card -->"
_MARKS = ("label_edge", "unsure")
_TASKS = {
    "depth": "depth-estimation",
    "labels": "image-segmentation",
    "object_mask": "image-segmentation",
    "classes": "image-segmentation",
}
"""Words for tasks of the dataset hub's front matter, by the layer that they need."""
_SIZES = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"))
_LARGEST = "n>1M"
_CONTEXT = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "citeAs": "cr:citeAs",
    "column": "cr:column",
    "conformsTo": "dct:conformsTo",
    "cr": "http://mlcommons.org/croissant/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "equivalentProperty": "cr:equivalentProperty",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "extract": "cr:extract",
    "field": "cr:field",
    "fileObject": "cr:fileObject",
    "fileProperty": "cr:fileProperty",
    "fileSet": "cr:fileSet",
    "format": "cr:format",
    "includes": "cr:includes",
    "isLiveDataset": "cr:isLiveDataset",
    "jsonPath": "cr:jsonPath",
    "key": "cr:key",
    "md5": "cr:md5",
    "parentField": "cr:parentField",
    "path": "cr:path",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "recordSet": "cr:recordSet",
    "references": "cr:references",
    "regex": "cr:regex",
    "repeated": "cr:repeated",
    "replace": "cr:replace",
    "samplingRate": "cr:samplingRate",
    "sc": "https://schema.org/",
    "separator": "cr:separator",
    "source": "cr:source",
    "subField": "cr:subField",
    "transform": "cr:transform",
}
"""The names of Croissant's terms, as its specification lists them."""
_FIELDS = (
    ("key", "sc:Text", "Name of the frame: its files begin with it."),
    ("camera", "sc:Text", "Name of the camera in dataset.json."),
    ("place", "sc:Text", "The place of the pose; frames of one place are in one split."),
    ("split", "sc:Text", "The frame's split; empty without splits."),
    ("scene", "sc:Text", "The scene and a digest of its content."),
)


class About(NamedTuple):
    """What nobody can know from the files.

    Attributes:
        name: of the dataset.
        license: an identifier of SPDX, such as ``CC-BY-4.0``.
        creator: a person or group.
        url: where the dataset is published; empty if it is not.
    """

    name: str
    license: str = UNKNOWN
    creator: str = ""
    url: str = ""


def write_card(out: str | Path, about: About) -> list[Path]:
    """Write the card and the descriptions of a complete dataset into its folder, and return their paths.

    Args:
        out: the dataset's folder.
        about: what its files do not say.

    Raises:
        ArgumentError: a name or licence that is no line of text, or files of somebody else under these names.
        DatasetError: no complete dataset.
    """
    for key, value in about._asdict().items():
        if value:
            text(key, value)
    folder = LocalFolder(Path(out))
    whole = manifest.read(folder)
    frames = manifest.read_frames(folder, whole)
    _refuse_files_of_others(folder.local)
    failed = len(manifest.read_failed(folder))
    description = _description(whole, frames)
    contents = {
        CARD: _card(about, whole, frames, failed, description),
        CROISSANT: _as_json(_croissant(about, folder.local, description)),
        CODEMETA: _as_json(_codemeta(about, description)),
        ZENODO: _as_json(_zenodo(about, description)),
    }
    return [write_bytes(folder.local / name, content.encode()) for name, content in contents.items()]


def _refuse_files_of_others(folder: Path) -> None:
    """Raise ArgumentError for files under these names, unless a card says that omniscv wrote them."""
    path = folder / CARD
    if path.exists() and _MARK in path.read_text(encoding="utf-8", errors="replace"):
        return
    for name in (CARD, CROISSANT, CODEMETA, ZENODO):
        if (folder / name).exists():
            expected = "expected no file, or one beside a card of omniscv"
            raise ArgumentError(f"{folder / name}: {expected}; move yours away")


def _as_json(value: Mapping[str, Any]) -> str:
    """Return plain values as JSON for people."""
    return json.dumps(value, indent=2, ensure_ascii=False) + "\n"


def _description(whole: Manifest, frames: Sequence[Frame]) -> str:
    """Return a sentence that says what the dataset holds."""
    kinds: dict[str, None] = {}
    for frame in frames:
        kinds |= dict.fromkeys(frame.files)
    layers = ", ".join(name for name in kinds if name != "image")
    models = ", ".join(sorted({camera.name for camera in whole.cameras.values()}))
    return f"{len(frames)} synthetic images by {len(whole.cameras)} cameras ({models}) with {layers}."


def _card(about: About, whole: Manifest, frames: Sequence[Frame], failed: int, description: str) -> str:
    """Return the dataset card: front matter, what is inside, how it was made, what its truth leaves open."""
    lines = _front_matter(about, frames)
    lines += [_MARK, "", f"# {about.name}", "", description, "", "## Cameras", ""]
    lines += ["| camera | model | size, px | images |", "|---|---|---|---|"]
    images = Counter(frame.camera_name for frame in frames)
    for name, camera in whole.cameras.items():
        lines.append(f"| {name} | {camera.name} | {camera.width}x{camera.height} | {images[name]} |")
    splits = Counter(frame.split for frame in frames if frame.split)
    if splits:
        lines += ["", "## Splits", "", "| split | images |", "|---|---|"]
        for split, count in sorted(splits.items()):
            lines.append(f"| {split} | {count} |")
    lines += ["", "## How it was made", ""]
    lines.append(f"By omniscv {whole.to_dict()['omniscv']}, from captures of virtual worlds. Conventions:")
    lines.append("")
    for key, value in whole.to_dict()["conventions"].items():
        lines.append(f"- {key}: {value}")
    lines += ["", "## What its truth leaves open", ""]
    lines += _doubt(frames)
    if failed:
        lines.append(f"{failed} frames failed and are left out: `failed.jsonl` says why.")
    lines += [
        "",
        "## Files",
        "",
        "`dataset.json` has cameras, objects and conventions, `frames.jsonl` a line for",
    ]
    lines += ["each image with its pose, files and checksums. `omniscv.dataset.open(DIR)` reads them.", ""]
    return "\n".join(lines)


def _front_matter(about: About, frames: Sequence[Frame]) -> list[str]:
    """Return the lines of the card's front matter, YAML."""
    kinds = set()
    for frame in frames:
        kinds |= set(frame.files)
    tasks = dict.fromkeys(task for layer, task in _TASKS.items() if layer in kinds)
    size = next((word for most, word in _SIZES if len(frames) < most), _LARGEST)
    lines = ["---", f"pretty_name: {json.dumps(about.name)}", f"license: {about.license.lower()}"]
    if tasks:
        lines += ["task_categories:", *(f"- {task}" for task in tasks)]
    return [*lines, "tags:", "- synthetic", "- omnidirectional", "size_categories:", f"- {size}", "---", ""]


def _doubt(frames: Sequence[Frame]) -> list[str]:
    """Return lines on the share of pixels that are marked, of some of the frames."""
    step = max(1, -(-len(frames) // SAMPLED))
    sample = frames[::step]
    lines = []
    for mark in _MARKS:
        shares = []
        for frame in sample:
            if mark in frame.files:
                shares.append(float(np.mean(frame.layer(mark)[frame.valid])))
            elif mark in frame.blank:
                shares.append(0.0)
        if shares:
            of_all = "" if step == 1 else f", of {len(sample)} of {len(frames)} images"
            lines.append(f"- `{mark}`: {100 * float(np.mean(shares)):.3g} % of the pixels{of_all}.")
    if not lines:
        return ["No layer marks pixels in doubt."]
    return ["Pixels whose label or depth may be another one are marked, not guessed:", "", *lines]


def _croissant(about: About, folder: Path, description: str) -> dict[str, Any]:
    """Return the description in Croissant: the manifest, and its frames as records."""
    files = []
    for name, form in (("dataset.json", "application/json"), (FRAMES, "application/jsonlines")):
        content = (folder / name).read_bytes()
        files.append(
            {
                "@type": "cr:FileObject",
                "@id": name,
                "name": name,
                "contentUrl": name,
                "encodingFormat": form,
                "contentSize": f"{len(content)} B",
                "sha256": hashlib.sha256(content).hexdigest(),
            }
        )
    fields = []
    for name, data_type, meaning in _FIELDS:
        fields.append(
            {
                "@type": "cr:Field",
                "@id": f"frames/{name}",
                "name": f"frames/{name}",
                "description": meaning,
                "dataType": data_type,
                "source": {"fileObject": {"@id": FRAMES}, "extract": {"column": name}},
            }
        )
    dataset: dict[str, Any] = {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "name": about.name,
        "description": description,
        "conformsTo": "http://mlcommons.org/croissant/1.1",
        "license": about.license,
        "version": "1.0.0",
        "distribution": files,
        "recordSet": [
            {
                "@type": "cr:RecordSet",
                "@id": "frames",
                "name": "frames",
                "description": "An image with its truth.",
                "key": {"@id": "frames/key"},
                "field": fields,
            }
        ],
    }
    if about.url:
        dataset["url"] = about.url
    if about.creator:
        dataset["creator"] = {"@type": "Person", "name": about.creator}
    return dataset


def _codemeta(about: About, description: str) -> dict[str, Any]:
    """Return the content of ``codemeta.json``, as CodeMeta 3 defines it: name, licence and author."""
    record: dict[str, Any] = {
        "@context": "https://w3id.org/codemeta/3.0",
        "@type": "Dataset",
        "name": about.name,
        "description": description,
    }
    if about.license != UNKNOWN:
        record["license"] = f"https://spdx.org/licenses/{about.license}"
    if about.creator:
        record["author"] = [{"@type": "Person", "name": about.creator}]
    return record


def _zenodo(about: About, description: str) -> dict[str, Any]:
    """Return the content of ``.zenodo.json``, which Zenodo reads when the dataset is deposited."""
    record: dict[str, Any] = {"upload_type": "dataset", "title": about.name, "description": description}
    if about.license != UNKNOWN:
        record["license"] = about.license
    if about.creator:
        record["creators"] = [{"name": about.creator}]
    return record
