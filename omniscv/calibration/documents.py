"""Files of other programs as plain values: YAML, JSON, XML, INI, ``key = value``, numpy's archives.

OpenCV's YAML is no YAML: its first line is ``%YAML:1.0``, its matrices have tags, and people write tabs after
colons. A byte-order mark, CRLF and several documents are no obstacles. A key that a mapping has twice with
different values is refused: programs differ in which one they take.
"""

import io
import json
import re
import zipfile
from collections.abc import Callable, Iterable
from functools import cached_property
from itertools import chain
from typing import Any

import numpy as np
import yaml

from omniscv.arguments import shown
from omniscv.errors import ArgumentError
from omniscv.storage.bounded import MOST_JSON_BYTES, parse_yaml

_HEADERS = re.compile(r"^%[^\n]*$|![!\w:/.]*(?:opencv|python|float|int|str|seq|map)[\w/:.-]*", re.MULTILINE)
_NO_SPACE = re.compile(r"^([ \t]*[A-Za-z_][\w.]*) *:(?=[-+.\d\[\"'])", re.MULTILINE)
_SECTION = re.compile(r"^[ \t]*\[[A-Za-z/][^\]\[,]*\][ \t]*(#.*)?$", re.MULTILINE)
_PAIR = re.compile(r"[ \t]*([A-Za-z_][\w .-]*?)[ \t]*[=:][ \t]*(.*)")
_NUMBER = re.compile(r"[-+]?[\d.]+(?:[eE][-+]?\d+)?")
_DOCUMENT_ENDS = re.compile(r"^(?:---|\.\.\.)(?=\s|$)", re.MULTILINE)


class Content:
    """A file by its bytes or text: its text ("" of binary files), and the values of its documents."""

    def __init__(self, data: bytes | str) -> None:
        self.data = data.encode() if isinstance(data, str) else data
        self.is_binary = self.data.startswith(b"PK\3\4") or b"\0" in self.data.removeprefix(b"\xff\xfe")
        self.is_binary &= not _is_utf16(self.data)

    @cached_property
    def text(self) -> str:
        """The text with ``\\n`` at the ends of lines; "" of a binary file."""
        if self.is_binary:
            return ""
        if _is_utf16(self.data):
            text = self.data.decode("utf-16")
        else:  # comments of people are in any encoding, keys and numbers are ASCII
            text = self.data.decode("utf-8-sig", errors="replace")
        return text.replace("\r\n", "\n").replace("\r", "\n")

    @cached_property
    def values(self) -> list[Any]:
        """The documents that are mappings or lists; none where the file has no such syntax."""
        try:
            return [value for value in self._parse() if isinstance(value, dict | list) and value]
        except ArgumentError as cause:
            self.error = cause
            return []

    error: ArgumentError | None = None
    """Why there are no values."""

    @property
    def documents(self) -> list[Any]:
        """The values without those printed twice, as a topic's messages are but for their header."""
        known: list[Any] = []
        for value in self.values:
            body = {k: v for k, v in value.items() if k != "header"} if isinstance(value, dict) else value
            if body not in known:
                known.append(body)
        return known

    def _parse(self) -> list[Any]:
        if self.data.startswith(b"PK\3\4"):
            return [_from_npz(self.data)]
        start = self.text.lstrip()[:1]
        if start == "<":
            return [_from_xml(self.text)]
        if start in ("{", "["):
            try:
                return [_from_json(re.sub(r"^[ \t]*//.*", "", self.text, flags=re.MULTILINE))]
            except json.JSONDecodeError as cause:  # of YAML, or of lines that start so
                if start == "{" and '\\"' in json.dumps(_from_yaml(self.text), default=str):
                    raise ArgumentError(f"expected JSON, got a stray quote: {cause}") from cause
                if re.search(r'"\s*:\s*[,}\]]', self.text):
                    raise ArgumentError(f"expected JSON, got a key without a value: {cause}") from cause
        try:
            return _from_yaml(self.text)
        except ArgumentError:
            words = re.sub(r"#.*|[\[\],;]", " ", self.text).split()
            if len(words) in (9, 10) and all(map(_NUMBER.fullmatch, words)):  # 3 x 3, and a baseline
                return [{"K": words[:9]} | dict.fromkeys(["baseline"] * len(words[9:]), words[-1])]
            parts = re.split(r"^(?=# oST version)", self.text, flags=re.MULTILINE)  # of a pair
            if lines := [values for part in parts if (values := _from_lines(part))]:
                return lines
            raise


def _is_utf16(data: bytes) -> bool:
    return data[:2] in (b"\xff\xfe", b"\xfe\xff") and len(data) % 2 == 0


def put_once(values: dict[str, Any], key: str, value: Any) -> None:
    """Add a key to a mapping; ArgumentError where it has another value already."""
    if key in values and values[key] != value:
        raise ArgumentError(f"{key}: expected this key once, got {shown(values[key])} and {shown(value)}")
    values[key] = value


def _from_json(text: str) -> Any:
    if len(text) > MOST_JSON_BYTES:
        raise ArgumentError(f"expected at most {MOST_JSON_BYTES} bytes, got more")

    def once(pairs: Iterable[tuple[str, Any]]) -> dict[str, Any]:
        values: dict[str, Any] = {}
        for pair in pairs:
            put_once(values, *pair)
        return values

    try:
        return json.loads(text, object_pairs_hook=once)
    except (json.JSONDecodeError, ArgumentError):
        raise
    except (RecursionError, ValueError) as cause:
        raise ArgumentError("expected JSON, got one nested too deeply, or with too long a number") from cause


def _from_yaml(text: str) -> list[Any]:
    text = _NO_SPACE.sub(r"\1: ", _HEADERS.sub("", text.replace("\t", " ")))
    parts = [part for part in _DOCUMENT_ENDS.split(text) if part.strip()]
    values = [parse_yaml(part) for part in parts]
    if not any(isinstance(value, dict | list) for value in values):
        raise ArgumentError("expected YAML of keys and values, got a text")
    return values


def _from_lines(text: str) -> dict[str, Any]:
    """Return the values of an INI file, of lines ``key = value``, or of ROS's ``ost.txt``."""
    values: dict[str, Any] = {}
    if not (_SECTION.search(text) or re.search(r"^[ \t]*\w[\w .]*=", text, re.MULTILINE)):
        return values
    section = values
    key = ""
    for number, line in enumerate(text.split("\n"), start=1):
        line = re.sub(r"^\s*[#;%].*" if "[" in line else r"(^|\s)[#;%].*", "", line)
        if not line.strip():
            continue
        if _SECTION.fullmatch(line):
            section = {}
            key = ""
            put_once(values, line.partition("]")[0].strip(" \t["), section)
        elif pair := _PAIR.fullmatch(line):
            key = pair[1]
            put_once(section, key, _scalar(pair[2]))
        elif re.match(r"[ \t]*[A-Za-z]", line) and not any(map(_NUMBER.fullmatch, line.split())):
            # a title, whose values follow
            key = line.strip()
            put_once(section, key, "")
        elif key:
            section[key] = f"{section[key]} {line.strip()}".strip()
        else:
            raise ArgumentError(f"line {number}: expected 'key = value' or a title, got {shown(line)}")
    return values


def _scalar(text: str) -> Any:
    return text.strip().strip("\"'")


def _from_xml(text: str) -> Any:
    """Return {name of the root: values}, those of OpenCV without its root; attributes are keys, too."""
    from xml.etree import ElementTree

    if "<!DOCTYPE" in text:  # its entities can expand to gigabytes
        raise ArgumentError("expected XML without <!DOCTYPE, got one")
    try:
        root = ElementTree.fromstring(text.lstrip("\ufeff \t\r\n"))
    except ElementTree.ParseError as cause:
        raise ArgumentError(f"expected XML, got {cause}") from cause

    def value(node: Any, level: int = 0) -> Any:
        if level > 32:
            raise ArgumentError("expected at most 32 levels of XML, got more")
        if len(node) and {child.tag for child in node} == {"_"}:  # a sequence of OpenCV
            return [value(child, level + 1) for child in node]
        if not len(node) and (not node.attrib or "type_id" in node.attrib):
            return _scalar(node.text or "")
        values: dict[str, Any] = dict(node.attrib)
        for child in node:
            below = value(child, level + 1)
            if child.tag not in values:
                values[child.tag] = below
            elif len(node.findall(child.tag)) > 1 and isinstance(below, dict):  # a list of elements
                first = values[child.tag]
                values[child.tag] = [*first, below] if isinstance(first, list) else [first, below]
            else:
                put_once(values, child.tag, below)
        return values

    values = value(root)
    return values if root.tag == "opencv_storage" else {root.tag: values}


def _from_npz(data: bytes) -> dict[str, Any]:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if sum(member.file_size for member in archive.infolist()) > MOST_JSON_BYTES:
                raise ArgumentError(f"expected arrays of at most {MOST_JSON_BYTES} bytes, got more")
        values: dict[str, Any] = {}
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            for name in arrays.files:
                try:
                    values[name] = arrays[name].tolist() if arrays[name].size < 4096 else None
                except ValueError:  # Python's objects, such as lists of rotations: they may run code
                    values[name] = None
        return values
    except (zipfile.BadZipFile, OSError, ValueError, EOFError, KeyError, NotImplementedError) as cause:
        if isinstance(cause, ArgumentError):
            raise
        raise ArgumentError(f"expected an archive of numpy, got {shown(str(cause))}") from cause


# -- writing -------------------------------------------------------------------------------------------


def _yaml(values: Any) -> str:
    return yaml.safe_dump(values, sort_keys=False, default_flow_style=None, width=1000)


def _opencv_yaml(values: dict[str, Any]) -> str:
    """Return what ``cv2.FileStorage`` reads: matrices have their type."""
    typed = {
        key: {"rows": len(value), "cols": len(value[0]), "dt": "d", "data": [*chain(*value)]}
        if isinstance(value, list) and isinstance(value[0], list)
        else value
        for key, value in values.items()
    }
    return "%YAML:1.0\n---\n" + re.sub(r":(\n +rows:)", r": !!opencv-matrix\1", _yaml(typed))


def _words(value: Any) -> str:
    return " ".join(map(str, value)) if isinstance(value, list) else str(value)


def _xml(values: dict[str, Any], level: int = 0) -> str:
    lines = ['<?xml version="1.0" encoding="UTF-8"?>'] if level == 0 else []
    for key, value in values.items():
        for item in value if isinstance(value, list) else [value]:
            below = f"\n{_xml(item, level + 1)}" if isinstance(item, dict) else item
            lines.append(f"<{key}>{below}</{key}>")
    return "\n".join(lines) + "\n"


SYNTAXES: dict[str, Callable[[Any], str]] = {
    "yaml": _yaml,
    "opencv-yaml": _opencv_yaml,
    "json": lambda values: json.dumps(values, indent=1) + "\n",
    "xml": _xml,
    "lines": lambda values: "".join(f"{key}: {_words(value)}\n" for key, value in values.items()),
}
"""Writers of plain values by syntax."""
