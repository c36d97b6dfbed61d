"""What needs Blender is collected where there is one; scripts/test-blender makes one."""

from support import blender

collect_ignore = [] if blender.found() else ["test_blender_rendered.py"]
