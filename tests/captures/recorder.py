"""A recorder to be killed: says when it is ready, waits for a word, then records all faces into a file.

Usage: recorder.py URI FILE
"""

import sys

import omniscv
import omniscv.captures.unreal.live  # what opening a source would import, before the clock starts
from omniscv.captures.view import MODES, Request, View
from omniscv.geometry import Pose, cube_rotations

CENTERS = ((0.0, 0.0, 1.5), (0.5, 0.0, 1.5))
SIZE = 96


def requests():
    """All faces at some places, in all modes."""
    return [
        Request(View(Pose(center, R_w_c), 90.0, SIZE, SIZE), mode)
        for center in CENTERS
        for mode in MODES
        for _, R_w_c in cube_rotations()
    ]


def record(source, path):
    """Records them all; closes the source."""
    with omniscv.record(source, path) as recording:
        recording.objects()
        for _ in recording.capture(requests()):
            pass


if __name__ == "__main__":
    print("ready", flush=True)
    sys.stdin.readline()
    record(omniscv.open_source(sys.argv[1]), sys.argv[2])
    print("done", flush=True)
