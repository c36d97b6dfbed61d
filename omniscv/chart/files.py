"""Measurements as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from omniscv.compose.files import whole_file


def write_rows(rows: Sequence[Any], out: Path, name: str) -> Path:
    """Write dataclasses as ``NAME.json`` into a folder, which is made; what is not a number becomes null."""
    out.mkdir(parents=True, exist_ok=True)
    path = out / f"{name}.json"
    with whole_file(path) as part:
        part.write_text(json.dumps([_plain(asdict(row)) for row in rows], indent=1) + "\n", encoding="utf-8")
    return path


def _plain(row: dict[str, Any]) -> dict[str, Any]:
    return {key: None if isinstance(v, float) and math.isnan(v) else v for key, v in row.items()}
