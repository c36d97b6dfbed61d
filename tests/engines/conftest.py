"""Engines by others behind the mock's protocol; scripts/test-engines makes an environment with them."""

import sys
from importlib.util import find_spec
from pathlib import Path

collect_ignore = [] if find_spec("panda3d") else ["test_panda3d.py"]
sys.path.append(str(Path(__file__).parent))
