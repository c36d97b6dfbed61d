"""The page of a report: one HTML file that needs no network, in the look of ``omniscv look``."""

import base64
import html
from collections.abc import Mapping, Sequence
from importlib.resources import files

import cv2
import numpy as np
from numpy.typing import NDArray

from omniscv.geometry import Array
from omniscv.score import groups
from omniscv.score.comparing import Difference
from omniscv.score.groups import Row
from omniscv.score.running import WEIGHTS, Map, Scored, all_groups, mean, mean_extra, mean_within

_MAP_PX = 480  # width of an error map
_FULL = 0.3  # error that is drawn as the brightest
_STEPS = 9  # of the scale of colours
_FEW = 12  # images whose rows are open at first


def page(
    results: Mapping[str, Sequence[Scored]],
    differences: Mapping[str, Sequence[Difference]],
    maps: Sequence[Map],
) -> str:
    """Return the page.

    Args:
        results: the scores of each prediction, by its name; the first one's images are shown.
        differences: of each further prediction from the first one.
        maps: of the worst images of the first one.
    """
    name = next(iter(results))
    scored = results[name]
    parts = [_head(name, scored), _mistakes(results), _figures(results)]
    for other, rows in differences.items():
        parts.append(_differences(name, other, rows))
    parts += [_where(scored), _worst(maps), _images(scored)]
    template = files("omniscv.score").joinpath("page.html").read_text(encoding="utf-8")
    return template.replace("<!-- parts -->", "\n".join(part for part in parts if part))


def _head(name: str, scored: Sequence[Scored]) -> str:
    """Return the title, with what was compared."""
    compared = sum(item.scores.compared for item in scored)
    in_doubt = sum(item.scores.in_doubt for item in scored)
    missing = sum(getattr(item.scores, "missing", 0) for item in scored)
    total = max(1, compared + in_doubt + missing)
    chips = [
        f"<b>{len(scored)}</b> images",
        f"<b>{compared:,}</b> pixels compared",
        f"<b>{in_doubt / total:.2%}</b> left out: their truth is in doubt",
        f"<b>{missing / total:.2%}</b> without a prediction",
    ]
    resampled = sorted({item.resampled for item in scored if item.resampled})
    chips += [html.escape(done) for done in resampled]
    items = "".join(f"<li>{chip}</li>" for chip in chips)
    return f'<header><h1>Scores of {html.escape(name)}</h1><ul class="chips">{items}</ul></header>'


def _mistakes(results: Mapping[str, Sequence[Scored]]) -> str:
    """Return what predictions read as instead, each mistake once with its images."""
    items = []
    for prediction, scored in results.items():
        images: dict[str, list[str]] = {}
        lines: dict[str, str] = {}
        for item in scored:
            for mistake in item.mistakes:
                images.setdefault(mistake.word, []).append(item.name)
                lines.setdefault(mistake.word, mistake.line())
        for word, names in images.items():
            where = names[0] if len(names) == 1 else f"{len(names)} images, such as {names[0]}"
            if len(results) > 1:
                where = f"{prediction}: {where}"
            items.append(f"<li><b>{html.escape(lines[word])}</b> <span>{html.escape(where)}</span></li>")
    if not items:
        return ""
    return f'<section class="alert"><h2>Reads as something else</h2><ul>{"".join(items)}</ul></section>'


def _figures(results: Mapping[str, Sequence[Scored]]) -> str:
    """Return the table of measures: a column for each prediction and kind of weights."""
    columns = []
    for name in results:
        for weights in WEIGHTS:
            title = weights.replace("_", " ")
            if len(results) > 1:
                title = f"{name}, {title}"
            columns.append((title, name, weights))
    first = next(iter(results.values()))
    rows = []
    for measure in first[0].figures("by_pixel"):
        cells = [f"<th>{html.escape(measure)}</th>"]
        for _, name, weights in columns:
            cells.append(_figure(results[name], measure, weights))
        rows.append(f"<tr>{''.join(cells)}</tr>")
    for measure in first[0].extra:
        cells = [f"<th>{html.escape(measure)}</th>"]
        for name in results:
            cells.append(f'<td colspan="2">{mean_extra(results[name])[measure]:.4g}</td>')
        rows.append(f"<tr>{''.join(cells)}</tr>")
    titles = "".join(f"<th>{html.escape(title)}</th>" for title, _, _ in columns)
    note = "Means over images. In grey: what truths within their bounds can make of them."
    if first[0].extra:
        note += " Figures of edges, points and protocols have no such interval."
    table = f"<table><thead><tr><th></th>{titles}</tr></thead><tbody>{''.join(rows)}</tbody></table>"
    return f"<section><h2>Figures</h2><p>{note}</p>{table}</section>"


def _figure(scored: Sequence[Scored], measure: str, weights: str) -> str:
    """Return a cell: a mean, and its interval."""
    value = f"{mean(scored)[weights][measure]:.4g}"
    bounds = mean_within(scored).get(weights)
    if bounds is None:
        return f"<td>{value}</td>"
    low, high = bounds[measure]
    return f"<td>{value} <small>{low:.4g} to {high:.4g}</small></td>"


def _differences(first: str, other: str, rows: Sequence[Difference]) -> str:
    """Return the table of differences between two predictions, by solid angle."""
    lines = []
    for row in rows:
        if row.weights != "by_solid_angle":
            continue
        mark = ' class="clear"' if row.is_clear else ""
        lines.append(
            f"<tr{mark}><th>{html.escape(row.measure)}</th><td>{row.mean:+.4g}</td><td>{row.interval}</td></tr>"
        )
    title = f"{html.escape(other)} less {html.escape(first)}"
    scenes = rows[0].scenes if rows else 0
    note = f"Paired by image, by solid angle. 95 % of {scenes} drawn scenes; bright where that leaves out 0."
    head = "<tr><th></th><th>mean difference</th><th>interval</th></tr>"
    table = f"<table><thead>{head}</thead><tbody>{''.join(lines)}</tbody></table>"
    return f"<section><h2>{title}</h2><p>{note}</p>{table}</section>"


def _where(scored: Sequence[Scored]) -> str:
    """Return the charts of errors by angle and by distance."""
    total = all_groups(scored)
    if total is None:
        return ""
    steps = groups.seam(total)
    parts = []
    if steps:
        parts.append(_chart("By latitude", groups.by_band(total)[::-1], "at equal distance"))
        parts.append(_chart("By distance", groups.by_distance(total, by_latitude=True), "at equal latitude"))
    else:
        parts.append(_chart("By angle from the axis", groups.by_ring(total), "at equal distance"))
        parts.append(_chart("By distance", groups.by_distance(total), "at equal angle"))
    note = "AbsRel by solid angle: the bar. The tick: the same {}."
    seam = ""
    if steps:
        across = steps["across the seam"]
        elsewhere = steps["elsewhere"]
        seam = (
            f"<p>Across the seam, steps of log depth are off by <b>{across:.3g}</b>; elsewhere by "
            f"<b>{elsewhere:.3g}</b>.</p>"
        )
    text = note.format("with distances, or angles, as frequent as in all")
    charts = f'<div class="charts">{"".join(parts)}</div>'
    return f"<section><h2>Where errors are</h2><p>{text}</p>{charts}{seam}</section>"


def _chart(title: str, rows: Sequence[Row], at_equal: str) -> str:
    """Return a chart of horizontal bars."""
    most = max([row.abs_rel for row in rows] + [row.abs_rel_at_equal for row in rows] + [1e-12])
    lines = []
    for row in rows:
        bar = 100 * row.abs_rel / most
        tick = 100 * row.abs_rel_at_equal / most
        tip = f"{row.share:.1%} of what is compared, delta1 {row.delta1:.3f}, "
        tip += f"{at_equal} {row.abs_rel_at_equal:.3g}"
        lines.append(
            f'<li title="{html.escape(tip)}"><span>{html.escape(row.name)}</span>'
            f'<i><b style="width:{bar:.2f}%"></b><u style="left:{tick:.2f}%"></u></i>'
            f"<em>{row.abs_rel:.3g}</em></li>"
        )
    return f'<div><h3>{html.escape(title)}</h3><ul class="bars">{"".join(lines)}</ul></div>'


def _worst(maps: Sequence[Map]) -> str:
    """Return the error maps of the worst images, over their pictures."""
    if not maps:
        return ""
    figures = []
    for item in maps:
        error = float(np.nanmean(item.error)) if np.isfinite(item.error).any() else float("nan")
        caption = f"<b>{html.escape(item.name)}</b> mean error of its pixels {error:.3g}"
        alt = f"Errors of {html.escape(item.name)}"
        figures.append(
            f'<figure><img alt="{alt}" src="{_picture(item)}"><figcaption>{caption}</figcaption></figure>'
        )
    legend = "".join(f'<i style="background:{color}"></i>' for color in _scale())
    scale = f'<p class="scale">0 {legend} {_FULL:.0%} and more; hatched: not compared</p>'
    note = "<p>Relative error of depth, wrong labels, or the angle of normals by 100 degrees.</p>"
    return (
        f'<section><h2>The worst images</h2>{note}{scale}<div class="maps">{"".join(figures)}</div></section>'
    )


def _scale() -> list[str]:
    """Return the colours of errors from 0 on, for the legend."""
    codes = np.linspace(0, 255, _STEPS).astype(np.uint8)[None]
    colors = cv2.applyColorMap(codes, cv2.COLORMAP_INFERNO)[0, :, ::-1]
    return [f"rgb({r},{g},{b})" for r, g, b in colors]


def _picture(item: Map) -> str:
    """Return an error map over its picture as a data URL; pixels that are not compared are hatched."""
    size = _MAP_PX, max(1, round(_MAP_PX * item.error.shape[0] / item.error.shape[1]))
    is_known = np.isfinite(item.error)
    share = cv2.resize(is_known.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    total = cv2.resize(
        np.where(is_known, np.minimum(item.error, 10), 0).astype(np.float32),
        size,
        interpolation=cv2.INTER_AREA,
    )
    error = total / np.maximum(share, 1e-6)
    codes = (np.clip(error / _FULL, 0, 1) * 255).astype(np.uint8)
    colors = cv2.applyColorMap(codes, cv2.COLORMAP_INFERNO).astype(np.float32)
    grey = _grey(item, size)
    if grey is not None:
        strength = 0.45 + 0.5 * np.clip(error / _FULL, 0, 1)[..., None]
        colors = grey[..., None] * (1 - strength) + colors * strength
    rows, columns = np.indices(share.shape)
    is_stripe = (rows + columns) % 8 < 2
    unknown = (30.0 if grey is None else 0.35 * grey) + 55.0 * is_stripe
    colors = np.where(share[..., None] >= 0.5, colors, np.broadcast_to(unknown, share.shape)[..., None])
    return _data_url(np.clip(colors, 0, 255).astype(np.uint8))


def _grey(item: Map, size: tuple[int, int]) -> Array | None:
    """Return an image's picture in grey; None where it has none, or one by another camera."""
    lit = item.picture()
    if lit is None or lit.shape[:2] != item.error.shape:
        return None
    values = np.asarray(lit[..., :3], np.float32)
    if lit.dtype != np.uint8:
        values = 255 * np.clip(values, 0, 1) ** (1 / 2.2)
    return np.asarray(cv2.resize(values.mean(axis=2), size, interpolation=cv2.INTER_AREA), np.float64)


def _data_url(pixels: NDArray[np.uint8]) -> str:
    """Return (H, W, 3) BGR as a PNG in a data URL."""
    _, encoded = cv2.imencode(".png", pixels)
    return "data:image/png;base64," + base64.b64encode(encoded.tobytes()).decode()


def _images(scored: Sequence[Scored]) -> str:
    """Return the table of all images, the worst first, by solid angle."""
    measures = list(scored[0].figures("by_solid_angle"))[:8]
    rows = []
    for item in sorted(scored, key=lambda entry: -entry.worst):
        figures = item.figures("by_solid_angle")
        cells = "".join(f"<td>{figures[measure]:.4g}</td>" for measure in measures)
        words = ", ".join(mistake.word for mistake in item.mistakes)
        rows.append(f"<tr><th>{html.escape(item.name)}</th>{cells}<td>{html.escape(words)}</td></tr>")
    titles = "".join(f"<th>{measure}</th>" for measure in measures)
    head = f"<tr><th></th>{titles}<th>reads as</th></tr>"
    table = f"<table><thead>{head}</thead><tbody>{''.join(rows)}</tbody></table>"
    opened = " open" if len(scored) <= _FEW else ""
    summary = f"All {len(scored)} images by solid angle, the worst first"
    return f"<section><details{opened}><summary>{summary}</summary>{table}</details></section>"
