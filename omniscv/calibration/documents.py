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
    """A file: its text, and the values of its documents.

    Args:
        data: the file's bytes or text.
    """

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
            values = self._parse()
        except ArgumentError as cause:
            self.error = cause
            return []
        return [value for value in values if isinstance(value, dict | list) and value]

    error: ArgumentError | None = None
    """Why there are no values."""

    @property
    def documents(self) -> list[Any]:
        """The values without those printed twice, as a topic's messages are but for their header."""
        bodies: list[Any] = []
        for value in self.values:
            body = value
            if isinstance(value, dict):
                body = dict(value)
                body.pop("header", None)
            if body not in bodies:
                bodies.append(body)
        return bodies

    def _parse(self) -> list[Any]:
        """Return the documents by the syntax that the bytes start with; ArgumentError for none that is
        known."""
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
            documents = _from_matrix(self.text) or _from_messages(self.text)
            if not documents:
                raise
            return documents


def _from_matrix(text: str) -> list[Any]:
    """Return the document of a text of nine numbers of K, and a baseline; none of another text."""
    words = re.sub(r"#.*|[\[\],;]", " ", text).split()
    if len(words) not in (9, 10) or not all(map(_NUMBER.fullmatch, words)):
        return []
    document: dict[str, Any] = {"K": words[:9]}
    if len(words) == 10:
        document["baseline"] = words[9]
    return [document]


def _from_messages(text: str) -> list[Any]:
    """Return the documents of lines, one for each ``ost.txt`` of a pair; none of another text."""
    documents = []
    for part in re.split(r"^(?=# oST version)", text, flags=re.MULTILINE):
        values = _from_lines(part)
        if values:
            documents.append(values)
    return documents


def _is_utf16(data: bytes) -> bool:
    """Return whether bytes start with a byte-order mark of UTF-16."""
    return data[:2] in (b"\xff\xfe", b"\xfe\xff") and len(data) % 2 == 0


def put_once(values: dict[str, Any], key: str, value: Any) -> None:
    """Add a key to a mapping.

    Args:
        values: the mapping.
        key: what is added.
        value: its value.

    Raises:
        ArgumentError: the mapping has another value of the key already.
    """
    if key in values and values[key] != value:
        raise ArgumentError(f"{key}: expected this key once, got {shown(values[key])} and {shown(value)}")
    values[key] = value


def _from_json(text: str) -> Any:
    """Return the value of JSON; a key that a mapping has twice must have one value."""
    if len(text) > MOST_JSON_BYTES:
        raise ArgumentError(f"expected at most {MOST_JSON_BYTES} bytes, got more")

    def once(pairs: Iterable[tuple[str, Any]]) -> dict[str, Any]:
        values: dict[str, Any] = {}
        for key, value in pairs:
            put_once(values, key, value)
        return values

    try:
        return json.loads(text, object_pairs_hook=once)
    except (json.JSONDecodeError, ArgumentError):
        raise
    except (RecursionError, ValueError) as cause:
        raise ArgumentError("expected JSON, got one nested too deeply, or with too long a number") from cause


def _from_yaml(text: str) -> list[Any]:
    """Return the documents of YAML, also of OpenCV's; ArgumentError for a mere text."""
    text = _NO_SPACE.sub(r"\1: ", _HEADERS.sub("", text.replace("\t", " ")))
    values = [parse_yaml(part) for part in _DOCUMENT_ENDS.split(text) if part.strip()]
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
    """Return a text without blanks and quotes around it."""
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

    values = _xml_value(root)
    return values if root.tag == "opencv_storage" else {root.tag: values}


_DEEPEST_XML = 32  # levels of elements


def _xml_value(node: Any, level: int = 0) -> Any:
    """Return the value of an element, ``level`` below the root: a text, a list of OpenCV, or a mapping."""
    if level > _DEEPEST_XML:
        raise ArgumentError(f"expected at most {_DEEPEST_XML} levels of XML, got more")
    if len(node) and all(child.tag == "_" for child in node):  # a sequence of OpenCV
        return [_xml_value(child, level + 1) for child in node]
    if not len(node) and (not node.attrib or "type_id" in node.attrib):
        return _scalar(node.text or "")
    values: dict[str, Any] = dict(node.attrib)
    for child in node:
        _put_child(
            values, child.tag, _xml_value(child, level + 1), is_listed=len(node.findall(child.tag)) > 1
        )
    return values


def _put_child(values: dict[str, Any], tag: str, value: Any, is_listed: bool) -> None:
    """Add the value of an element to its parent's values; elements that are mappings and listed are a
    list."""
    if tag not in values:
        values[tag] = value
    elif is_listed and isinstance(value, dict):
        first = values[tag]
        values[tag] = [*first, value] if isinstance(first, list) else [first, value]
    else:
        put_once(values, tag, value)


_MOST_ARRAY = 4096  # numbers of an array that may belong to a lens


def _from_npz(data: bytes) -> dict[str, Any]:
    """Return the arrays of an archive of numpy as lists; None for large ones and for Python's objects."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if sum(member.file_size for member in archive.infolist()) > MOST_JSON_BYTES:
                raise ArgumentError(f"expected arrays of at most {MOST_JSON_BYTES} bytes, got more")
        values: dict[str, Any] = {}
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            for name in arrays.files:
                try:
                    values[name] = arrays[name].tolist() if arrays[name].size < _MOST_ARRAY else None
                except ValueError:  # Python's objects, such as lists of rotations: they may run code
                    values[name] = None
        return values
    except (zipfile.BadZipFile, OSError, ValueError, EOFError, KeyError, NotImplementedError) as cause:
        if isinstance(cause, ArgumentError):
            raise
        raise ArgumentError(f"expected an archive of numpy, got {shown(str(cause))}") from cause


# -- writing -------------------------------------------------------------------------------------------


def _yaml(values: Any) -> str:
    """Return YAML with lists of numbers in one line."""
    return yaml.safe_dump(values, sort_keys=False, default_flow_style=None, width=1000)


def _opencv_yaml(values: dict[str, Any]) -> str:
    """Return YAML that ``cv2.FileStorage`` reads.

    A list of rows becomes a matrix: its size, its element type (``d``: float64) and its elements row by row,
    under the tag ``!!opencv-matrix``.
    """
    with_matrices = dict(values)
    for key, value in values.items():
        if isinstance(value, list) and isinstance(value[0], list):
            elements = [*chain(*value)]
            with_matrices[key] = {"rows": len(value), "cols": len(value[0]), "dt": "d", "data": elements}
    untagged = _yaml(with_matrices)
    return "%YAML:1.0\n---\n" + re.sub(r":(\n +rows:)", r": !!opencv-matrix\1", untagged)


def _lines(values: dict[str, Any]) -> str:
    """Return lines ``key: value``, or ``key: number number ...``."""
    text = ""
    for key, value in values.items():
        words = " ".join(map(str, value)) if isinstance(value, list) else str(value)
        text += f"{key}: {words}\n"
    return text


def _xml(values: dict[str, Any], level: int = 0) -> str:
    """Return elements, a list as one for each item; the outermost has XML's first line."""
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
    "lines": _lines,
}
"""Writers of plain values by syntax."""
