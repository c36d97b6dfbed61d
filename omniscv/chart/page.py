"""Measurements as a self-contained HTML page: a picture and a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from html import escape
from pathlib import Path
from typing import Any

from omniscv.storage.local import whole_file

_STYLE = """
body { font: 15px/1.4 system-ui, sans-serif; margin: 2em auto; max-width: 70em; color: #1c2330 }
table { border-collapse: collapse; margin: 1em 0 2.5em; font-variant-numeric: tabular-nums }
th, td { padding: .25em .8em; text-align: right; border-bottom: 1px solid #d5d9e0 }
th:first-child, td:first-child { text-align: left } tr.default { background: #fdf1e7; font-weight: 600 }
img { max-width: 800px }
"""


def write(title: str, rows: Sequence[Any], pictures: Sequence[Path], path: Path) -> Path:
    """Write a page, and return its path.

    Args:
        title: of the page.
        rows: dataclasses of one class; those whose field ``default`` is true are marked.
        pictures: SVG files, embedded in the page.
        path: of the page.
    """
    drawings = [picture.read_text("utf-8") for picture in pictures]
    parts = [f"<h1>{escape(title)}</h1>", *(text[text.index("<svg") :] for text in drawings)]
    parts.append(_table(rows))
    page = f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{escape(title)}</title>'
    with whole_file(path) as part:
        part.write_text(f"{page}<style>{_STYLE}</style>{''.join(parts)}</html>\n", encoding="utf-8")
    return path


def _table(rows: Sequence[Any]) -> str:
    names = [field.name for field in fields(rows[0])] if rows else []
    head = "".join(f"<th>{escape(name.replace('_', ' '))}</th>" for name in names)
    lines = []
    for row in rows:
        cells = "".join(f"<td>{escape(_text(getattr(row, name)))}</td>" for name in names)
        lines.append(f"<tr{' class=default' if getattr(row, 'default', False) else ''}>{cells}</tr>")
    return f"<table><tr>{head}</tr>{''.join(lines)}</table>"


def _text(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else ""
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{key}: {_text(item)}" for key, item in value.items())
    return "all" if value is None else str(value)
