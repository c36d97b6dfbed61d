"""docs/other-implementations.md cites tests: each is there, and each of those tests is cited."""

import re

from support.command_line import ROOT


def test_every_test_is_cited_and_every_citation_is_a_test():
    page = (ROOT / "docs" / "other-implementations.md").read_text(encoding="utf-8")
    tests = (ROOT / "tests" / "cameras" / "test_other_implementations.py").read_text(encoding="utf-8")
    assert set(re.findall(r"`(test_\w+)`", page)) == set(re.findall(r"^def (test_\w+)", tests, re.MULTILINE))


def test_the_versions_are_those_that_are_installed():
    import cv2
    import pycolmap

    page = (ROOT / "docs" / "other-implementations.md").read_text(encoding="utf-8")
    assert f"OpenCV {cv2.__version__.partition('-')[0]} " in page
    assert f"pycolmap {pycolmap.__version__}," in page
