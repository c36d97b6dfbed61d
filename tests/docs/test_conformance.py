"""The page of the mock's commands is the one that its script makes."""

import runpy

from support.command_line import ROOT


def test_the_page_of_commands_is_as_made():
    page = runpy.run_path(str(ROOT / "scripts/conformance"))["page"]()
    assert (ROOT / "docs/conformance.md").read_text(encoding="utf-8") == page
