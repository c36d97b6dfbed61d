"""What a dataset is to hold beyond images: the keys of a job that ``omniscv dataset make`` reads.

::

    classes: classes.yaml                 # or its content
    truth:  {boxes: true, layout: true, amodal: masks, flow: {wrap: shortest}, tolerance: {abs_m: 0.02}}
    export: [coco, {format: depth_png, scale: mm, out: depth, cameras: [panorama]}]
    split:  {train: 0.8, val: 0.1, test: 0.1, by: place, distance_m: 0.5, seed: 0}
    shards: {format: webdataset, max_count: 1000, max_bytes: 1000000000}
    media:  {xmp: true, north: 0.0}
    seam:   whole                         # or split: objects that cross the seam of a panorama
    layout: {source: scene, maps: {edge_sigma: 0.0054, corner_sigma: 0.0107}}   # of layouts and their maps
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Literal, get_args

from omniscv import modalities
from omniscv.arguments import Reader, fields, flag, number, one_of, shown, text, texts, within
from omniscv.cameras import Camera
from omniscv.dataset import registry
from omniscv.dataset.classes import class_rules
from omniscv.dataset.exporting import Export, check_cameras, check_kinds
from omniscv.dataset.manifest import IMAGE
from omniscv.dataset.splits import Split
from omniscv.errors import ArgumentError
from omniscv.truth import registry as truths
from omniscv.truth.classes import ClassRules

Seam = Literal["whole", "split"]


@dataclass(frozen=True)
class Recipe:
    """What ``omniscv dataset make`` makes of images.

    Attributes:
        classes: rules that give objects classes; None for no layer ``classes``.
        truth: the truths to derive, by name, with their options.
        exports: the formats to write at the end; shards are the last.
        split: how frames are shared among splits; None for none.
        media: metadata of pictures; empty for none.
    """

    classes: ClassRules | None = None
    truth: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    exports: tuple[Export, ...] = ()
    split: Split | None = None
    media: Mapping[str, Any] = field(default_factory=dict)

    def kinds(self, modes: tuple[str, ...]) -> frozenset[str]:
        """Return the kinds of files that every frame has: layers, and records of truths."""
        rows = [modalities.get(mode) for mode in modes]
        found = {IMAGE, *modes, *(layer for row in rows for layer in row.derives)}
        found |= {row.marked_by for row in rows if row.marked_by}
        if self.classes is not None and "labels" in found:
            found.add("classes")
        return frozenset(found | {truths.get(name).kind for name in self.truth})

    def check(self, cameras: Mapping[str, Camera], modes: tuple[str, ...]) -> None:
        """Refuse what cannot be made, before anything is captured.

        Raises:
            ArgumentError: a truth or classes that need other modes, a format that cannot carry a camera or
                needs what frames will not have, or two exports into one folder.
        """
        kinds = self.kinds(modes)
        if self.classes is not None and "labels" not in kinds:
            raise _modes("classes", ["object_mask"], modes)
        for name, options in self.truth.items():
            truth = truths.get(name)
            if missing := [mode for mode in truth.needs if mode not in kinds]:
                raise _modes(f"truth.{name}", missing, modes)
            with within(f"truth.{name}"):
                truth.read_options(options)
        for i, each in enumerate(self.exports):
            if each.folder in {before.folder for before in self.exports[:i]}:
                raise ArgumentError(
                    f"export: expected a folder for each, got {each.folder!r} twice; set 'out'"
                )
            check_cameras(each, cameras)
            check_kinds(each.format, kinds)

    def settings(self) -> dict[str, Any]:
        """Return plain values: what the manifest holds of it."""
        return {
            "splits": None if self.split is None else self.split.to_dict(),
            "exports": [each.to_dict() for each in self.exports],
            "options": {"truth": {k: dict(v) for k, v in self.truth.items()}, "media": dict(self.media)},
        }


def read(given: Mapping[str, Any], folder: Path) -> Recipe:
    """Return the recipe of a job's keys.

    Args:
        given: values as the readers of ``FIELDS`` return them.
        folder: that the path of ``classes`` is relative to.

    Raises:
        ArgumentError: an unknown truth or format, or classes that cannot be read.
    """
    classes = given.get("classes")
    truth = {name: options for name, options in given.get("truth", {}).items() if options is not None}
    shared = {key: given[key] for key in ("seam", "layout") if key in given}
    if "tolerance" in truth:
        shared["tolerance"] = truth.pop("tolerance")
    exports = [dict(each) for each in given.get("export", [])]
    for name in [name for name in truth if truths.get(name).format]:  # truths between frames
        exports = _with_options(exports, truths.get(name).format, truth.pop(name))
    exports += [given["shards"]] if "shards" in given else []
    return Recipe(
        classes=None
        if classes is None
        else class_rules(folder / classes if isinstance(classes, str) else classes),
        truth={name: _shared(truths.get(name), shared) | options for name, options in truth.items()},
        exports=tuple(_export(each, shared) for each in exports),
        split=given.get("split"),
        media=given.get("media", {}),
    )


def _with_options(
    exports: list[dict[str, Any]], format: str, options: dict[str, Any]
) -> list[dict[str, Any]]:
    """The exports with options added to those of a format, which is appended if it is missing."""
    if not any(export["format"] == format for export in exports):
        exports.append({"format": format})
    return [export | options if export["format"] == format else export for export in exports]


def _export(given: Mapping[str, Any], shared: Mapping[str, Any]) -> Export:
    options = {key: value for key, value in given.items() if key not in ("format", "out", "cameras")}
    cameras = texts("export.cameras", given["cameras"]) if "cameras" in given else ()
    with within("export"):
        taken = _shared(registry.get(given["format"]), shared)
        return Export(given["format"], taken | options, given.get("out", ""), cameras)


def _shared(taker: object, shared: Mapping[str, Any]) -> dict[str, Any]:
    """The keys of a job that a truth or format takes among its options: those that its ``keys`` name."""
    return {key: shared[key] for key in getattr(taker, "keys", ()) if key in shared}


def _modes(name: str, missing: list[str], modes: tuple[str, ...]) -> ArgumentError:
    wanted = f"expected modes with {', '.join(missing)}"
    return ArgumentError(f"{name}: {wanted}, got {', '.join(modes)}; add them to 'modes'")


# -- the keys: each is read by a function (name, value) -------------------------------------------------


def _truth(name: str, value: object) -> dict[str, dict[str, Any] | None]:
    """Options by truth; None where it is not wanted."""
    known = (*truths.names(), "tolerance")
    found = fields(name, value, dict.fromkeys(known, _wanted))
    if found.get("tolerance") is not None:
        found["tolerance"] = fields(f"{name}.tolerance", found["tolerance"], _TOLERANCE)
    return {key: found[key] for key in known if key in found}


def _wanted(name: str, value: object) -> dict[str, Any] | None:
    """Options: none for true, ``{kind: WORD}`` for a word; None for false and off."""
    if value is None or value is False or value == "off":
        return None
    if value is True:
        return {}
    if isinstance(value, str):
        return {"kind": value}
    if isinstance(value, Mapping):
        return dict(value)
    raise ArgumentError(f"{name}: expected true, false, or a mapping of options, got {shown(value)}")


def _exports(name: str, value: object) -> list[dict[str, Any]]:
    if not isinstance(value, list):
        raise ArgumentError(f"{name}: expected a list of formats, got {shown(value)}")
    return [_format(f"{name}[{i}]", each) for i, each in enumerate(value)]


def _format(name: str, value: object) -> dict[str, Any]:
    """A format's name, or a mapping with it and its options."""
    given = {"format": value} if isinstance(value, str) else value
    if not isinstance(given, Mapping) or not isinstance(given.get("format"), str):
        raise ArgumentError(
            f"{name}: expected a format, or {{format: NAME, OPTION: VALUE}}, got {shown(value)}"
        )
    with within(name):
        registry.get(given["format"])
    return dict(given)


def _classes(name: str, value: object) -> Any:
    return text(name, value) if isinstance(value, str) else _mapping(name, value)


def _mapping(name: str, value: object) -> dict[str, Any]:
    if not isinstance(value, Mapping):
        raise ArgumentError(f"{name}: expected a mapping, got {shown(value)}")
    return dict(value)


_TOLERANCE: dict[str, Reader] = {"abs_m": partial(number, least=0), "rel": partial(number, least=0)}

_MAPS: dict[str, Reader] = dict.fromkeys(("edge_sigma", "corner_sigma"), partial(number, above=0, most=1))

FIELDS: dict[str, Reader] = {
    "classes": _classes,
    "truth": _truth,
    "export": _exports,
    "split": Split.read,
    "shards": _format,
    "media": partial(fields, readers={"xmp": flag, "north": number}),
    "seam": partial(one_of, words=get_args(Seam)),
    "layout": partial(fields, readers={"source": text, "maps": partial(fields, readers=_MAPS)}),
}
