"""A recorder to be killed: prints when it is ready, waits for a line, then records all faces into a file.

Usage: recorder.py ADDRESS FILE
"""

import sys

import omniscv
import omniscv.sources.unreal.source  # what opening a source imports, before the clock starts
from omniscv.geometry import Pose, cube_rotations
from omniscv.sources import Request, View

CENTERS = ((0.0, 0.0, 1.5), (0.5, 0.0, 1.5))
MODES = ("lit", "object_mask", "depth", "normals")
SIZE = 96


def requests():
    """All faces at some centres, in all modes."""
    return [
        Request(View(Pose(center, R_w_c), 90.0, SIZE, SIZE), mode)
        for center in CENTERS
        for mode in MODES
        for _, R_w_c in cube_rotations()
    ]


def record(source, path):
    """Record them all; close the source."""
    with omniscv.record(source, path) as recording:
        recording.objects()
        for _ in recording.capture(requests()):
            pass


if __name__ == "__main__":
    print("ready", flush=True)
    sys.stdin.readline()
    record(omniscv.open_source(sys.argv[1]), sys.argv[2])
    print("done", flush=True)
