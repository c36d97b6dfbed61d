"""``mesh://ROOM.glb``: worlds that are triangles, of glTF, PLY, OBJ, STL and OFF files, exact by rays."""

from omniscv.sources.mesh.source import MeshSource, open_mesh

__all__ = ["MeshSource", "open_mesh"]
