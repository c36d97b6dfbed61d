"""How long the mock server takes for six faces of 512 x 512: to trace, to encode, and over TCP.

The goal is 1 s for lit, mask and depth over TCP by the official client, on two cores. The best of five.
"""

import itertools
import logging
import warnings
from collections.abc import Iterator
from functools import partial

import numpy as np
import unrealcv

import mock_server
from benches import Figure, Reference, best_ms
from mock_server import pixels

GOAL_MS = 1000
FACES = ((0, 0, 0), (0, 90, 0), (0, 180, 0), (0, -90, 0), (90, 0, 0), (-90, 0, 0))
FRONT = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # camera axes as columns, in X forward, Y left, Z up
IMAGES = ("lit png", "object_mask png", "depth npy")


def measure(quick: bool) -> Iterator[Figure]:
    size, turns = (16, 1) if quick else (512, 5)
    for name in ("four-wall", "six-wall"):
        scene, title = mock_server.load_scene(name), f"{name}: six faces of {size} x {size}"
        for part, ms in best_ms(parts(scene, size), turns).items():
            yield Figure(title, part, "ms", 6 * ms)
        with mock_server.serve(scene) as server:
            client, moves = client_of(server, size), itertools.count()
            (ms,) = best_ms({"all": partial(six_faces, client, moves)}, turns).values()
            client.disconnect()
        yield Figure(title, "all over TCP", "ms", ms, limit=Reference("goal", GOAL_MS))


def parts(scene: mock_server.Scene, size: int) -> dict:
    """Return the work for one face."""
    trace = partial(mock_server.render_view, scene, FRONT, (0, 0, 1.5), 90, size, size)
    view = trace()
    mask = np.repeat(view.label.astype(np.uint8)[..., None], 3, axis=2)
    return {
        "trace": trace,
        "PNG of lit": lambda: pixels.png(view.color),
        "PNG of mask": lambda: pixels.png(mask),
        "NPY of depth": lambda: pixels.npy(pixels.stored(100 * view.depth, half=True)),
    }


def client_of(server: mock_server.Server, size: int) -> unrealcv.Client:
    """Return the official client, with a camera."""
    logging.getLogger("unrealcv").setLevel(logging.CRITICAL)
    unrealcv.print = lambda *_: None  # the module's own name, not the builtin
    client = unrealcv.Client((server.host, server.port))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        client.connect()
    client.request(["vset /cameras/spawn", f"vset /camera/1/size {size} {size}", "vset /camera/1/fov 90.0"])
    return client


def six_faces(client: unrealcv.Client, moves: Iterator[int]) -> None:
    """Capture from another position each time, so that no view is kept from before."""
    commands = [f"vset /camera/1/location {next(moves)}.0 0.0 150.0"]
    for rotation in FACES:
        commands.append("vset /camera/1/rotation {} {} {}".format(*rotation))
        commands += [f"vget /camera/1/{image}" for image in IMAGES]
    client.request(commands)
