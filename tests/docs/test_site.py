"""The site: its navigation has every page, links and anchors lead somewhere, every key is documented."""

import re
from dataclasses import fields
from itertools import pairwise

import pytest
import yaml
from support.command_line import ROOT

import omniscv
from omniscv import calibration, cameras
from omniscv.cli import COMMANDS
from omniscv.cli.images import RECORD, key_rows
from omniscv.cli.options import IMAGES
from omniscv.dataset import exporting, truths
from omniscv.records import key_of

DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
LINK = re.compile(r"(?<!\\)\]\(([^)\s]+)\)")


def text_of(page):
    """A page without its fenced blocks."""
    return re.sub(r"^( *)```.*?^\1```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)


def anchors(page):
    """Of headings, as the site and GitHub make them."""
    titles = re.findall(r"^#+ (.+?)(?: \{.*\})?$", text_of(page), flags=re.MULTILINE)
    words = [re.sub(r"[^\w\s-]", "", re.sub(r"[`*]", "", title).lower()).strip() for title in titles]
    return {re.sub(r"[\s]", "-", each) for each in words}


def leaves(nav):
    if isinstance(nav, str):
        return [nav]
    return [leaf for each in (nav.values() if isinstance(nav, dict) else nav) for leaf in leaves(each)]


def site():
    return yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))


def test_the_navigation_names_every_page_once():
    assert sorted(leaves(site()["nav"])) == sorted(str(page.relative_to(DOCS)) for page in PAGES)


def test_the_site_loads_nothing_from_elsewhere():
    assert site()["theme"]["font"] is False
    assert "extra_javascript" not in site()
    for style in site()["extra_css"]:
        assert not re.search(r"url|import|//", (DOCS / style).read_text(encoding="utf-8"))


@pytest.mark.parametrize("page", [ROOT / "README.md", *PAGES], ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page):
    for link in LINK.findall(text_of(page)):
        if re.match(r"https?://", link):
            continue
        path, _, anchor = link.partition("#")
        there = (page.parent / path).resolve() if path else page
        assert there.exists(), link
        assert page.parent == ROOT or there.is_relative_to(DOCS), f"{link}: not in the site"
        assert not anchor or anchor in anchors(there), link


def test_numbers_of_several_pages_are_those_of_the_code():
    pages = [ROOT / "README.md", ROOT / "CHANGELOG.md", *PAGES, *(ROOT / "examples").glob("*/README.md")]
    said = "\n".join(page.read_text(encoding="utf-8") for page in pages)
    models = len(cameras.names())
    formats = len(calibration.formats())
    for pattern, count in (
        (r"(\d+) \[?camera models|has a page[^.]*?(\d+) models", models),
        (r"(\d+) (?:formats|\[?lens files)", formats),
    ):
        found = [int(next(filter(None, match.groups()))) for match in re.finditer(pattern, said)]
        assert set(found) == {count}, pattern


def test_the_table_of_keys_is_the_one_that_is_generated():
    """To mend it, print these rows into the page."""
    page = (DOCS / "job.md").read_text(encoding="utf-8")
    rows = [f"| `{name}` | {default and f'`{default}`'} | {text} |" for name, default, text in key_rows()]
    assert "\n".join(["| key | default | meaning |", "|---|---|---|", *rows]) in page
    words = set(re.findall(r"\w+", page))
    nested = "position yaw_deg pitch_deg roll_deg time place start rate count spline random grid path"
    assert {*nested.split(), *truths.names(), "tolerance"} <= words


def test_the_page_of_scenes_has_every_word():
    """Those that messages name as known, of a scene, a room, an object, a solid, a texture, a motion."""
    source = (ROOT / "mock_server" / "scene_file.py").read_text(encoding="utf-8")
    calls = re.findall(r"_mapping\(([^()]*(?:\([^()]*\)[^()]*)*)\)", source)
    known = {word for call in calls for word in re.findall(r'(?<!f)"(\w+)"', call)}
    assert {"sky", "floor_texture", "period_s", "velocity", "points", "turn_deg", "period_rad"} <= known
    assert known <= set(re.findall(r"\w+", (DOCS / "scenes.md").read_text(encoding="utf-8")))


def test_the_page_of_the_command_line_has_every_command_and_override():
    text = (DOCS / "command-line.md").read_text(encoding="utf-8")
    assert set(COMMANDS) <= set(re.findall(r"^\| `omniscv ([a-z]+)", text, flags=re.MULTILINE))
    options = {f"--{name.replace('_', '-')}" for name in {**IMAGES, **RECORD}}
    assert options <= set(re.findall(r"--[a-z-]+", text))


def test_the_page_of_datasets_has_every_option_of_a_format():
    page = (DOCS / "datasets.md").read_text(encoding="utf-8")
    for name in exporting.names():
        known = exporting.get(name).options  # None: a format of another package
        options = {key_of(field) for field in fields(known)} if known else set()
        of_the_job = {"layout", "sensor"}
        assert not options - of_the_job - set(re.findall(r"`(\w+)`", page)), name


def test_the_page_of_architecture_has_every_module():
    page = (DOCS / "architecture.md").read_text(encoding="utf-8")
    paths = [path for path in (ROOT / "omniscv").iterdir() if not path.name.startswith(("_", "py.typed"))]
    names = {f"{path.name}/" if path.is_dir() else path.name for path in paths} - {"jobs.py"}  # an old name
    assert not names - set(re.findall(r"`(?:omniscv/)?([\w.]+/?)`", page))


def source_of(name):
    """The text of the module that a dotted name is, or is in."""
    path = ROOT.joinpath(*name.split("."))
    found = [file for at in (path, path.parent) for file in (at.with_suffix(".py"), at / "__init__.py")]
    return next(each for each in found if each.exists()).read_text(encoding="utf-8")


def test_the_reference_has_every_public_name():
    pages = (DOCS / "reference").glob("*.md")
    shown = {name for page in pages for name in re.findall(r"^::: (\S+)", page.read_text(), re.MULTILINE)}
    for name in set(omniscv.__all__) - {"__version__"}:
        found = getattr(omniscv, name)
        home = getattr(found, "__module__", None) or found.__name__
        alone = any(each.endswith(f".{name}") for each in shown)
        assert alone or home in shown or any(each.startswith(f"{home}.") for each in shown), name
    for name in shown:
        assert re.search(rf"\b{name.rpartition('.')[2]}\b", source_of(name)) or name.islower(), name


def test_the_citation_is_of_this_version():
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert {"cff-version", "message", "title", "authors", "type"} <= cited.keys()
    assert (cited["cff-version"], cited["version"]) == ("1.2.0", omniscv.__version__)
    paper = cited["preferred-citation"]
    assert paper["doi"] in (ROOT / "README.md").read_text(encoding="utf-8")
    assert all({"family-names", "given-names"} == set(each) for each in paper["authors"])


def test_lists_begin_after_an_empty_line():
    """GitHub does without, Markdown on the site does not."""
    for page in PAGES:
        lines = text_of(page).splitlines()
        for before, line in pairwise(lines):
            starts = re.match(r"(?:[*-]|\d+\.) ", line)
            inside = re.match(r"\s*(?:[*-]|\d+\.) |\s+|$", before)
            assert not starts or inside, f"{page.name}: {line}"


def test_frames_are_drawn_with_their_axes():
    for frame, words in {
        "world": ("X forward", "Y left", "Z up"),
        "unreal": ("X forward", "Y right", "Z up"),
        "camera": ("x right", "y down", "z forward"),
        "pixels": ("(0, 0)", "(0.5, 0.5)", "(width, height)"),
        "angles": ("to the left", "nose up", "right side down"),
    }.items():
        picture = (DOCS / "frames" / f"{frame}.svg").read_text(encoding="utf-8")
        assert len(picture) < 1 << 15
        assert all(word in picture for word in words)
        assert f"](frames/{frame}.svg)" in (DOCS / "conventions.md").read_text(encoding="utf-8")


def figures_of_all(page, heading):
    """The last row, of all images, of the first table behind a heading, by column."""
    behind = page.partition(f"## {heading}")[2]
    head = re.search(r"^\| \| images \|.*$", behind, re.M)[0].split("|")
    row = re.search(r"^\| all \|.*$", behind, re.M)[0].split("|")
    return {name.strip(): value.strip() for name, value in zip(head, row, strict=True)}


def test_the_readme_has_at_most_130_lines_and_the_rates_of_the_page_on_accuracy():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    accuracy = (ROOT / "docs/accuracy.md").read_text(encoding="utf-8")
    assert len(readme.splitlines()) <= 130
    measured = figures_of_all(accuracy, "Measured")
    wrong = float(measured["unmarked %"]) + float(measured["too thin %"])
    assert (
        f"of {measured['images']} random images, {round(1000 * wrong)} pixels in 100,000 were wrong" in readme
    )
    engine = figures_of_all(accuracy, "Judged by another engine")
    worst = float(engine["worst image %"])
    assert f"and {worst:.2f} % wrong in one that looks from below a floor" in readme
