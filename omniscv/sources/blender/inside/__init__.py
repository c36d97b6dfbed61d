"""Programs that run inside Blender, whose licence is the GNU GPL; omniscv imports nothing of this folder."""
