"""What pages cite is there: the tests of docs/other-implementations.md, the borders of docs/security.md."""

import re

from support.command_line import ROOT


def test_every_test_is_cited_and_every_citation_is_a_test():
    page = (ROOT / "docs" / "other-implementations.md").read_text(encoding="utf-8")
    folder = ROOT / "tests" / "cameras"
    tests = {
        path.name: re.findall(r"^def (test_\w+)", path.read_text("utf-8"), re.M)
        for path in folder.glob("*.py")
    }
    cited = set(re.findall(r"`(test_\w+)`", page))
    assert (
        set(tests["test_other_implementations.py"])
        <= cited
        <= {name for names in tests.values() for name in names}
    )


def test_the_versions_are_those_that_are_installed():
    import cv2
    import pycolmap

    page = (ROOT / "docs" / "other-implementations.md").read_text(encoding="utf-8")
    assert f"OpenCV {cv2.__version__.partition('-')[0]} " in page
    assert f"pycolmap {pycolmap.__version__}," in page


def test_borders_are_modules_and_their_numbers_those_of_the_code():
    from mock_server import yaml_text
    from omniscv import arguments, errors
    from omniscv.dataset import manifest
    from omniscv.sources.unreal import client
    from omniscv.storage import base, bounded, remote

    page = (ROOT / "docs" / "security.md").read_text(encoding="utf-8")
    rows = [line.split(" | ") for line in page.splitlines() if line.startswith("| ")][1:]
    for row in rows:
        for name in re.findall(r"`([\w/.]+)`", row[1]):
            assert (ROOT / "omniscv" / name).exists() or (ROOT / name).exists(), name
    checked = {row[0].strip("| "): row[2] for row in rows}

    def says(row, *bounds):
        assert all(str(bound) in checked[row] for bound in bounds), checked[row]

    assert (yaml_text.MOST_BYTES, base.MOST_BYTES) == (1 << 20, 1 << 30)
    says("jobs, scenes, calibration files", "1 MiB", f"{yaml_text.MOST_VALUES:,} values")
    says("jobs, scenes, calibration files", f"{yaml_text.MOST_LEVELS} levels", yaml_text.LONGEST_NUMBER)
    assert (bounded.MOST_JSON_BYTES, manifest._MOST_FRAMES_BYTES) == (64 << 20, 1 << 30)
    says("the manifest of a dataset", "64 MiB", "1 GiB", f"{arguments._LONGEST_STEM} bytes")
    seconds = remote._ANSWER_S, remote._PATIENCE_S, remote._LISTING_S
    says("an object store", *(f"{each:.0f} s" for each in seconds), f"{remote._SLOWEST / 1e3:.0f} kB")
    says("an UnrealCV server", f"{client.TIMEOUT_S:.0f} s for each", f"{client.PATIENCE_S:.0f} s for retries")
    says("what is printed", f"{errors.LONGEST_LINE} printable")
