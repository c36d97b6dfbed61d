"""Score a folder of predictions, and write what came out: JSON, a table, and a page."""

import base64
import csv
import html
import io
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from omniscv.arguments import number
from omniscv.geometry import Array
from omniscv.score.depth_scores import DepthScores, as_range, depth
from omniscv.score.measures import DepthMeasures
from omniscv.score.mistakes import Mistake, find_mistakes
from omniscv.score.reading import Truth, prediction, truths
from omniscv.storage.local import write_bytes

WORST = 10
"""Images whose error maps are in the page."""
_MAP_PX = 320  # width of an error map
_MEASURES = tuple(field.name for field in fields(DepthMeasures))


@dataclass(frozen=True)
class Scored:
    """An image that was scored.

    Attributes:
        name: of the image.
        scores: of its depth.
        mistakes: what the prediction reads as instead.
        resampled: what was done to its size; empty for nothing.
    """

    name: str
    scores: DepthScores
    mistakes: list[Mistake]
    resampled: str = ""


class Options(NamedTuple):
    """How predictions are read and scored; see :func:`score`."""

    form: str = "range"
    align: str = "none"
    unit_m: float = 1.0
    intervals: bool = True
    bounded: bool = False


def score(
    predictions: Path,
    truth: str | Path,
    *,
    form: str = "range",
    align: str = "none",
    unit_m: float = 1.0,
    intervals: bool | None = None,
    bounded: bool = False,
    out: Path | None = None,
    done: Callable[[int], None] = lambda count: None,
) -> list[Scored]:
    """Return the scores of a folder of predictions, and write a report of them.

    Args:
        predictions: a folder with a file for each image.
        truth: a dataset, or a folder that ``render`` wrote.
        form: what predictions hold: ``range``, ``planar``, ``disparity``.
        align: see :data:`omniscv.score.ALIGNMENTS`.
        unit_m: of predictions, metres.
        intervals: whether figures have intervals where the truth has bounds; None: without an alignment, with
            which they take seconds for an image.
        bounded: whether pixels in doubt are compared where the truth has a bound; see
            :func:`omniscv.score.depth`.
        out: folder for ``report.json``, ``report.csv`` and ``report.html``; None: nothing is written.
        done: called with the count of images after each.

    Raises:
        ArgumentError: an image without a prediction, or one that cannot be compared.
    """
    number("unit", unit_m, above=0)
    options = Options(form, align, unit_m, align == "none" if intervals is None else intervals, bounded)
    scored = []
    maps: list[tuple[float, str, Array]] = []
    for image in truths(truth):
        item, error = _scored(predictions, image, options)
        scored.append(item)
        maps.append((item.scores.by_solid_angle.abs_rel, item.name, error))
        maps = sorted(maps, key=lambda entry: -entry[0])[:WORST]
        done(len(scored))
    if out is not None:
        _write(scored, maps, out)
    return scored


def mean(scored: Sequence[Scored]) -> dict[str, dict[str, float]]:
    """Return the means over images of all measures, by the kind of weights."""
    means: dict[str, dict[str, float]] = {}
    for weights in ("by_pixel", "by_solid_angle"):
        means[weights] = {}
        for measure in _MEASURES:
            values = [getattr(getattr(item.scores, weights), measure) for item in scored]
            means[weights][measure] = float(np.mean(values))
    return means


def mean_within(scored: Sequence[Scored]) -> dict[str, dict[str, tuple[float, float]]]:
    """Return what those means can be by truths within their bounds, (least, greatest), by the kind of
    weights; nothing for a kind that an image has no interval of."""
    means: dict[str, dict[str, tuple[float, float]]] = {}
    for weights in ("by_pixel", "by_solid_angle"):
        intervals = [getattr(item.scores, f"{weights}_within") for item in scored]
        if None in intervals:
            continue
        means[weights] = {}
        for measure in _MEASURES:
            low = np.mean([getattr(interval.low, measure) for interval in intervals])
            high = np.mean([getattr(interval.high, measure) for interval in intervals])
            means[weights][measure] = float(low), float(high)
    return means


def _scored(predictions: Path, truth: Truth, options: Options) -> tuple[Scored, Array]:
    """Return the scores of an image, and its map of relative errors (H, W), NaN where nothing is compared."""
    values, resampled = prediction(predictions, truth)
    scores = depth(
        values,
        truth.depth,
        truth.camera,
        doubt=truth.doubt,
        error=truth.error if options.intervals or options.bounded else None,
        bounded=options.bounded,
        form=options.form,
        align=options.align,
        unit_m=options.unit_m,
    )
    along = as_range(values * options.unit_m, options.form, truth.camera)
    mistakes = []
    if options.align == "none":
        mistakes = find_mistakes(along, truth.depth, truth.camera, truth.doubt)
    with np.errstate(divide="ignore", invalid="ignore"):
        error = np.abs(along - truth.depth) / truth.depth
    known = truth.camera.valid() & np.isfinite(truth.depth) & ~truth.doubt
    return Scored(truth.name, scores, mistakes, resampled), np.where(known, error, np.nan)


def _write(scored: Sequence[Scored], maps: Sequence[tuple[float, str, Array]], out: Path) -> None:
    """Write the report's files into a folder."""
    out.mkdir(parents=True, exist_ok=True)
    images = []
    for item in scored:
        lines = [mistake.line() for mistake in item.mistakes]
        images.append(
            {"name": item.name, **item.scores.to_dict(), "mistakes": lines, "resampled": item.resampled}
        )
    report = {"mean": mean(scored), "mean_within": mean_within(scored), "images": images}
    write_bytes(out / "report.json", (json.dumps(report, indent=2) + "\n").encode())
    write_bytes(out / "report.csv", _table(scored).encode())
    write_bytes(out / "report.html", _page(scored, maps).encode())


def _table(scored: Sequence[Scored]) -> str:
    """Return a line for each image and kind of weights, as CSV."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["image", "weights", *_MEASURES, "compared", "in_doubt", "missing"])
    for item in scored:
        counts = [item.scores.compared, item.scores.in_doubt, item.scores.missing]
        for weights in ("by_pixel", "by_solid_angle"):
            values = [f"{getattr(getattr(item.scores, weights), measure):.9g}" for measure in _MEASURES]
            writer.writerow([item.name, weights, *values, *counts])
    return text.getvalue()


def _page(scored: Sequence[Scored], maps: Sequence[tuple[float, str, Array]]) -> str:
    """Return one HTML file that needs no network: the means, and error maps of the worst images."""
    rows = []
    for measure in _MEASURES:
        values = [f"<td>{means[measure]:.4g}</td>" for means in mean(scored).values()]
        rows.append(f"<tr><th>{measure}</th>{''.join(values)}</tr>")
    named = []
    for item in scored:
        for mistake in item.mistakes:
            named.append(f"<li>{html.escape(item.name)} {html.escape(mistake.line())}</li>")
    figures = []
    for error, name, picture in maps:
        caption = f"{html.escape(name)}: AbsRel {error:.3g}"
        figures.append(f'<figure><img src="{_picture(picture)}"><figcaption>{caption}</figcaption></figure>')
    return _PAGE.format(
        count=len(scored), rows="\n".join(rows), mistakes="\n".join(named), figures="\n".join(figures)
    )


def _picture(error: Array) -> str:
    """Return a map of relative errors as a data URL: black for none, yellow for 30 % and more, grey for
    unknown."""
    scaled = np.nan_to_num(np.clip(error / 0.3, 0, 1) * 255, nan=0.0).astype(np.uint8)
    colors = cv2.applyColorMap(scaled, cv2.COLORMAP_INFERNO)
    colors[np.isnan(error)] = 128
    height = max(1, round(_MAP_PX * error.shape[0] / error.shape[1]))
    _, encoded = cv2.imencode(".png", cv2.resize(colors, (_MAP_PX, height), interpolation=cv2.INTER_AREA))
    return "data:image/png;base64," + base64.b64encode(encoded.tobytes()).decode()


def summary(scored: Sequence[Scored]) -> list[dict[str, str]]:
    """Return a row for each measure: its means by pixels and by solid angle, with their intervals."""
    means = mean(scored)
    within = mean_within(scored)
    rows = []
    for measure in _MEASURES:
        row = {"measure": measure}
        for weights in ("by_pixel", "by_solid_angle"):
            row[weights.replace("_", " ")] = f"{means[weights][measure]:.4g}"
            if weights in within:
                low, high = within[weights][measure]
                row[f"{weights.replace('_', ' ')}: within"] = f"[{low:.4g}, {high:.4g}]"
        rows.append(row)
    return rows


_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>Scores of depth</title>
<style>
body {{ font: 15px system-ui, sans-serif; margin: 2rem; color: #1c2330; }}
td, th {{ padding: .2rem 1rem .2rem 0; text-align: left; }}
figure {{ display: inline-block; margin: .5rem; }}
</style></head><body>
<h1>Scores of depth, {count} images</h1>
<table><tr><th></th><th>by pixel</th><th>by solid angle</th></tr>
{rows}
</table>
<ul>
{mistakes}
</ul>
<h2>The worst images: relative error, black 0, yellow 30 % and more, grey not compared</h2>
{figures}
</body></html>
"""
