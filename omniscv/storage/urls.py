"""URLs of object stores, and texts that name them without credentials."""

import re
from pathlib import Path

SCHEMES = ("file", "s3", "gs", "memory")
"""Stores that are tested; any other scheme that fsspec knows is opened too."""

_URL = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+)://")
_USER = re.compile(r"(?<=://)[^/@\s'\"]*@")
_QUERY = re.compile(r"(?<=\S)\?[^\s'\"]*(?==)[^\s'\"]*|#[^\s'\"]*=[^\s'\"]*")


def is_url(text: object) -> bool:
    """Return whether a text is a URL, ``scheme://...``; a Path is none."""
    return isinstance(text, str) and _URL.match(text) is not None


def was_url(path: object) -> bool:
    """Return whether a Path was made of a URL, and so lost a slash: ``s3:/bucket/rooms``."""
    return isinstance(path, Path) and path.parts[:1] in {(f"{scheme}:",) for scheme in SCHEMES}


def scheme_of(url: str) -> str:
    """Return the scheme of a URL; an empty text for a path."""
    found = _URL.match(url)
    return found[1].lower() if found else ""


def without_secrets(text: object) -> str:
    """Return a text whose URLs have no user, password or query: these may be credentials."""
    return _QUERY.sub("", _USER.sub("", str(text)))
