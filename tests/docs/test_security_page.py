"""The borders that docs/security.md names are there."""

import re

from support.command_line import ROOT


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
