"""The tests render without a screen; MuJoCo reads how when it is imported."""

import os

os.environ.setdefault("MUJOCO_GL", "egl")
