"""Runs ``checks.py`` in a process of its own: what an outsider registers stays registered."""

import re
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent


def test_an_outsiders_package_works_through_public_names():
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(HERE / "checks.py")]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=HERE.parents[1])
    assert done.returncode == 0, done.stdout[-4000:]
    checks = len(re.findall(r"^def test_", (HERE / "checks.py").read_text(encoding="utf-8"), re.MULTILINE))
    assert int(re.search(r"(\d+) passed", done.stdout)[1]) >= checks
