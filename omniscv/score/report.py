"""What came out, as files: JSON, a table, and a page."""

import csv
import io
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from omniscv.score import groups
from omniscv.score.comparing import Difference, differences
from omniscv.score.page import page
from omniscv.score.running import (
    WEIGHTS,
    Map,
    Scored,
    all_groups,
    mean,
    mean_extra,
    mean_within,
    score,
)
from omniscv.storage.local import write_bytes

WORST = 10
"""Images whose error maps are in the page."""

Results = Mapping[str, Sequence[Scored]]
"""The scores of each prediction, by its name; the first one is the one that is shown."""


def score_all(
    predictions: Sequence[Path],
    truth: str | Path,
    out: Path | None = None,
    done: Callable[[int], None] = lambda count: None,
    **options: Any,
) -> dict[str, list[Scored]]:
    """Return the scores of several predictions of the same images, and write a report of them.

    Args:
        predictions: folders or files; the report shows the first one's images.
        truth: see :func:`omniscv.score.running.score`.
        out: folder for ``report.json``, ``report.csv`` and ``report.html``; None: nothing is written.
        done: called with the count of images after each.
        options: see :class:`omniscv.score.running.Options`.

    Raises:
        ArgumentError: an image without a prediction, or one that cannot be compared.
    """
    results: dict[str, list[Scored]] = {}
    maps: list[tuple[float, Map]] = []

    def keep(item: Scored, error: Map) -> None:
        """Keep the maps of the worst images of the first prediction."""
        if results or out is None:
            return
        maps.append((item.worst, error))
        maps.sort(key=lambda entry: -entry[0])
        del maps[WORST:]

    before = 0
    for path in predictions:
        scored = score(path, truth, partial(_add, done, before), keep, **options)
        results[_name_of(path, results)] = scored
        before += len(scored)
    if out is not None:
        write(results, [error for _, error in maps], out)
    return results


def _add(done: Callable[[int], None], before: int, count: int) -> None:
    """Call ``done`` with the count of images of this prediction and of those before it."""
    done(before + count)


def _name_of(path: Path, results: Results) -> str:
    """Return a name for a prediction that none before it has."""
    name = path.resolve().name
    number = 2
    while name in results:
        name = f"{path.resolve().name} ({number})"
        number += 1
    return name


def write(results: Results, maps: Sequence[Map], out: Path) -> None:
    """Write ``report.json``, ``report.csv`` and ``report.html``.

    Args:
        results: the scores.
        maps: of the worst images, for the page.
        out: the folder; made if it is not there.
    """
    out.mkdir(parents=True, exist_ok=True)
    write_bytes(out / "report.json", (json.dumps(summary_of(results), indent=2) + "\n").encode())
    write_bytes(out / "report.csv", _table(results).encode())
    write_bytes(out / "report.html", page(results, compared(results), maps).encode())


def compared(results: Results) -> dict[str, list[Difference]]:
    """Return the differences of each further prediction from the first one, by its name."""
    first, *others = results
    rows = {}
    for name in others:
        rows[name] = differences(results[first], results[name])
    return rows


def summary_of(results: Results) -> dict[str, Any]:
    """Return all figures as plain values: those of the first prediction, and of the others beside it."""
    first, *others = results
    content = _plain(results[first])
    if others:
        content["prediction"] = first
        content["beside"] = {name: _plain(results[name]) for name in others}
        rows = compared(results)
        content["differences"] = {name: [row._asdict() for row in rows[name]] for name in others}
    return content


def _plain(scored: Sequence[Scored]) -> dict[str, Any]:
    """Return the figures of one prediction as plain values."""
    images = []
    for item in scored:
        described = {"name": item.name, "scene": item.scene, **item.scores.to_dict(), **item.extra}
        described["mistakes"] = [mistake.line() for mistake in item.mistakes]
        images.append({**described, "resampled": item.resampled})
    content: dict[str, Any] = {"mean": mean(scored), "mean_within": mean_within(scored)}
    content |= {"mean_extra": mean_extra(scored), "without_interval": without_interval(scored)}
    total = all_groups(scored)
    if total is not None:
        content["groups"] = {
            "by_ring": [asdict(row) for row in groups.by_ring(total)],
            "by_latitude": [asdict(row) for row in groups.by_band(total)],
            "by_distance": [asdict(row) for row in groups.by_distance(total)],
            "seam": groups.seam(total),
        }
    return {**content, "images": images}


def without_interval(scored: Sequence[Scored]) -> list[str]:
    """Return the names of figures that have no interval by the truth's bounds."""
    names = list(scored[0].extra)
    within = mean_within(scored)
    for weights in WEIGHTS:
        if weights not in within:
            names += [f"{weights}: {measure}" for measure in scored[0].figures(weights)]
    return names


def _table(results: Results) -> str:
    """Return a line for each prediction, image and kind of weights, as CSV."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    first = next(iter(results.values()))[0]
    measures = list(first.figures("by_pixel"))
    beside = ["prediction"] if len(results) > 1 else []
    writer.writerow(["image", "weights", *measures, *first.extra, "compared", "in_doubt", "missing", *beside])
    for name, scored in results.items():
        for item in scored:
            missing = getattr(item.scores, "missing", 0)
            counts = [item.scores.compared, item.scores.in_doubt, missing]
            extra = [f"{value:.9g}" for value in item.extra.values()]
            for weights in WEIGHTS:
                values = [f"{value:.9g}" for value in item.figures(weights).values()]
                row = [item.name, weights, *values, *extra, *counts]
                writer.writerow([*row, name] if beside else row)
    return text.getvalue()


def summary(scored: Sequence[Scored]) -> list[dict[str, str]]:
    """Return a row for each measure: its means by pixels and by solid angle, with their intervals."""
    means = mean(scored)
    within = mean_within(scored)
    rows = []
    for measure in means["by_pixel"]:
        row = {"measure": measure}
        for weights in WEIGHTS:
            row[weights.replace("_", " ")] = f"{means[weights][measure]:.4g}"
            if weights in within:
                low, high = within[weights][measure]
                row[f"{weights.replace('_', ' ')}: within"] = f"[{low:.4g}, {high:.4g}]"
        rows.append(row)
    return rows
