"""Charts: what they measure, their files, fronts, and plain numbers; errors and answers of faults."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from omniscv.chart import accuracy, central, drawing, failures, stability
from omniscv.chart.drawing import Dot, Look
from omniscv.chart.failures import Cause
from omniscv.cli import reports, run

DOCS = Path(__file__).parents[2] / "docs"


def of_docs(module, name, **changes):
    """Return the rows of a chart in docs; ``changes`` has functions of fields that JSON does not hold."""
    rows = json.loads((DOCS / f"{name}.json").read_text())
    return [module.Row(**row | {key: change(row[key]) for key, change in changes.items()}) for row in rows]


CHARTS = {
    "chart-accuracy": (
        accuracy,
        lambda: of_docs(accuracy, "chart-accuracy", seconds_at=lambda at: {int(ms): at[ms] for ms in at}),
        ("mirror ball", "the paper", accuracy.ASKED),
    ),
    "chart-central": (
        central,
        lambda: of_docs(central, "chart-central", rms=lambda rms: np.nan if rms is None else rms),
        ("py360convert", "bilinear"),
    ),
    "chart-failures": (failures, lambda: of_docs(failures, "chart-failures")[:4], ("found by the doctor",)),
    "stability": (stability, lambda: stability.measure(models=["octahedral"]), ("octahedral",)),
}


@pytest.mark.parametrize("name", CHARTS)
def test_charts_are_written_and_drawn(name, tmp_path):
    module, rows, texts = CHARTS[name]
    data, drawn, picture = module.write(rows(), tmp_path / "new")
    assert [path.suffix for path in (data, drawn, picture)] == [".json", ".svg", ".png"]
    assert {path.stem for path in (data, drawn, picture)} == {name}
    written = json.loads(data.read_text())
    if (DOCS / f"{name}.json").exists():
        assert written == json.loads((DOCS / f"{name}.json").read_text())[: len(written)]
    assert all(text in drawn.read_text() for text in texts)
    with Image.open(picture) as opened:
        assert opened.width == 1600


def test_the_front_holds_what_nothing_beats():
    dots = [Dot("a", "", x, y) for x, y in ((1, 9), (2, 5), (2, 7), (3, 6), (4, 1), (5, 1))]
    assert drawing.front(dots) == [dots[0], dots[1], dots[4]]


def test_a_picture_has_the_same_bytes_every_time(tmp_path):
    def drawn(folder):
        figure, (axes,) = drawing.figure(1, 3.0, "The same")
        ways = [Dot("a", "one", 1, 2, default=True), Dot("a", "two", 3, 1)]
        drawing.dots(axes, ways, {"a": Look("#0072b2", "o", "-")})
        return [path.read_bytes() for path in drawing.write([], figure, folder, "chart")]

    assert drawn(tmp_path / "first") == drawn(tmp_path / "second")


CAMERAS = ("panorama", "mirror ball")


def test_the_paper_takes_six_faces_a_centre_and_the_others_less(monkeypatch):
    """Of two cameras by fewer strategies. Finer faces leave less doubt, and aims are reached."""
    cameras = accuracy.cameras(32)
    monkeypatch.setattr(accuracy, "cameras", lambda width: {name: cameras[name] for name in CAMERAS})
    fewer = {**accuracy._NONCENTRAL, accuracy.EXACT: [("exact", None, 1)]}
    monkeypatch.setattr(accuracy, "_NONCENTRAL", fewer)
    ways = accuracy.measure(width=32, asked=(0.1,))
    for name in CAMERAS:
        camera = cameras[name]
        mine = {(row.series, row.viewpoints, row.face_size): row for row in ways if row.camera == name}
        paper = mine[accuracy.PAPER, None, 8]
        faces = 6 * len(camera.viewpoints().centers)
        around = 0 if camera.central else 6  # in depth alone, to find which viewpoints are occluded
        assert paper.requests == 2 * faces + around
        assert mine[accuracy.EXACT, None, 8].requests <= paper.requests
        assert mine[accuracy.DEFAULT, None, None].requests <= paper.requests
        assert paper.seconds == pytest.approx(0.005 * paper.requests + 0.025 * paper.megapixels)
        assert paper.seconds_at[30] - paper.seconds == pytest.approx(0.025 * paper.requests)
        if camera.central:
            doubt = [mine[accuracy.EXACT, None, size].doubtful for size in (4, 16, 64)]
            assert doubt == sorted(doubt, reverse=True)
    assert all(row.wrong <= row.doubtful for row in ways)
    asked = [row for row in ways if row.accuracy is not None]
    assert [row.camera for row in asked] == list(CAMERAS)
    assert all(row.doubtful <= row.accuracy == 0.1 for row in asked)


@pytest.mark.parametrize(
    "address", ["scene://four-wall", pytest.param("mock://four-wall", marks=pytest.mark.soak)]
)
def test_a_camera_of_ones_own_stands_on_the_chart(address, tmp_path, monkeypatch):
    """In a source that traces, wrong pixels are known and seconds modelled; else seconds are measured."""
    monkeypatch.setattr(accuracy, "AIMS", ())
    monkeypatch.setattr(accuracy.measure_own, "__defaults__", ((0.1,), None))
    monkeypatch.setattr(accuracy, "_SIZES", (1,))
    monkeypatch.setitem(accuracy._CENTRAL, accuracy.EXACT, [("exact", None, 1)])
    lens = ["--camera", "kannala-brandt", "--size", "16x16", "--set", "camera.fx=6", "--set", "camera.fy=6"]
    assert run(["chart", "accuracy", *lens, "--source", address, "--out", str(tmp_path)]) == 0
    rows = json.loads((tmp_path / "chart-accuracy.json").read_text())
    assert {row["camera"] for row in rows} == {"kannala-brandt"}
    for row in rows:
        modelled = 0.005 * row["requests"] + 0.025 * row["megapixels"]
        if address.startswith("scene"):
            assert row["seconds"] == pytest.approx(modelled)
            assert row["wrong"] <= row["doubtful"]
        else:
            assert row["wrong"] is None
            assert 0 < row["seconds"] != pytest.approx(modelled, rel=1e-9)
    assert ("measured" in (tmp_path / "chart-accuracy.svg").read_text()) == address.startswith("mock")


def test_options_of_one_chart_are_refused_by_others(capsys):
    assert run(["chart", "central", "--camera", "pinhole"]) == 2
    assert "expected none, with --quick or a chart that is not 'accuracy'" in capsys.readouterr().err


def test_ours_and_the_peers_are_measured():
    rows = central.measure(width=64)
    ours = {(row.name, row.face_size) for row in rows if row.ours and row.map == "kept"}
    assert ours == {(filter, size) for filter in central.FILTERS for size in (8, 16, 32)}
    peers = {row.name for row in rows if not row.ours}
    assert peers == {"the paper's algorithm", "py360convert", "ffmpeg v360", "cv2.remap, map ready"}
    assert [row.face_size for row in rows if row.default] == [16, 16]  # its map kept, and new
    rms = {row.name: row.rms for row in rows if not row.ours or row.face_size == 16}
    assert rms["nearest"] == pytest.approx(rms["the paper's algorithm"], rel=1e-3)  # but rays between pixels
    assert rms["bilinear"] == pytest.approx(rms["ffmpeg v360"], rel=0.05)  # but its fixed-point weights


def row(name, face_size, ms, rms, **more):
    values = {"map": "kept", "ours": name in central.FILTERS, "default": name == "bilinear", **more}
    return central.Row(name, 64, face_size, ms=ms, rms=rms, **values)


def test_the_title_names_sizes_speed_truth_and_front():
    ours = [row("nearest", 16, 1, 5), row("bilinear", 16, 2, 3), row("area", 16, 4, 3.5)]
    slower = row("ffmpeg v360", 16, 8, 3.01)
    limit = row("cv2.remap, map ready", 16, 0.5, np.nan)
    start = "6 x 16\u00b2 to 64 x 32 px, bilinear: 2.0 ms, 4.0 times as fast as ffmpeg v360"
    title = central.finding([*ours, slower, limit])
    assert title == f"{start}; none of them is nearer to the truth. Front: nearest 16, bilinear 16"
    title = central.finding([*ours, slower, row("py360convert", 16, 1.5, 2.97)])
    nearer = "py360convert is nearer to the truth by 1.0%. Front: nearest 16, py360convert"
    assert title == f"{start}; {nearer}"


@pytest.mark.parametrize("words", [["chart", "central", "--quick"], ["evaluate", "layout", "--quick"]])
def test_without_the_package_of_charts_its_extra_is_named(words, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(reports, "find_spec", lambda name: None)
    assert run([*words, "--out", str(tmp_path)]) == 1
    assert "expected the package matplotlib; pip install 'omniscv[charts]'" in capsys.readouterr().err


COLUMNS = ("panorama", "8 viewpoints")


def told(address, position, timeout_s, patience_s):
    """What the doctor, who takes seconds, finds of the depth that the address makes radial."""
    assert (position == failures._POSE.position).all()
    return [SimpleNamespace(name="depth, turned", verdict="bad")] if "fault=" in address else []


@pytest.mark.parametrize("doctor", [told, pytest.param(failures.examine_address, marks=pytest.mark.soak)])
def test_strong_faults_are_found(doctor, monkeypatch):
    small = "size=96x72"
    radial = Cause("radial depth", "of the way", (1,), f"{small}&fault=radial-depth={{}}", sound=small)
    for name, value in (("examine_address", doctor), ("CAUSES", (radial,)), ("COLUMNS", COLUMNS)):
        monkeypatch.setattr(failures, name, value)
    faults = failures.measure(width=32)
    assert {row.column for row in faults} == set(COLUMNS)
    assert {row.said for row in faults} == {"doctor"}
    assert all(row.wrong > 0.5 and "depth, turned" in row.findings for row in faults)


def test_weak_faults_hold():
    """Without a doctor's finding, what is as true as without the fault."""
    images = dict.fromkeys(failures.COLUMNS, (0.01, 0.0))
    sound = failures._Outcome(images, frozenset())
    weak = failures._Outcome(images | {"exact": (0.02, 0.0005), "auto": (0.02, 0.02)}, frozenset())
    rows = failures._rows(failures.CAUSES[0], 0.001, weak, sound)
    assert [row.said for row in rows] == ["holds", "marked", "holds", "silent"]


def table(rows):
    """A Markdown table of the strengths at which each strategy breaks, and of the answers there."""
    columns = failures.COLUMNS
    lines = [f"| cause | strengths | {' | '.join(columns)} | the doctor |", "|---" * (len(columns) + 3) + "|"]
    for cause in dict.fromkeys(row.cause for row in rows):
        mine = [row for row in rows if row.cause == cause]
        strengths = ", ".join(dict.fromkeys(str(row.strength) for row in mine))
        cells = []
        for column in failures.COLUMNS:
            broken = [row for row in mine if row.column == column and row.said != "holds"]
            answers = [row for i, row in enumerate(broken) if i == 0 or broken[i - 1].said != row.said]
            cells.append("; ".join(f"{row.strength}: {row.said}" for row in answers) or "holds")
        findings = next((row.findings for row in mine if row.findings), ())
        start = f"| {cause} | {strengths} {mine[0].unit}".rstrip()
        lines.append(f"{start} | {' | '.join(cells)} | {'; '.join(findings[:3])} |")
    return "\n".join(lines) + "\n"


def test_the_page_has_the_table_of_its_data():
    rows_of_docs = of_docs(failures, "chart-failures")
    page = (DOCS / "failures.md").read_text(encoding="utf-8")
    assert table(rows_of_docs) in page
    assert {row.cause for row in rows_of_docs} == {cause.name for cause in failures.CAUSES}
    silent = {row.cause for row in rows_of_docs if row.said == "silent"}
    assert all(page.count(f"\n| {cause}") >= 2 for cause in silent)
