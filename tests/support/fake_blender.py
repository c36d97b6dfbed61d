"""Speaks as ``inside.py`` does, and shows a floor under the sky. It can misbehave.

The first argument is its version, the others are Blender's. A file NAME.blend.json has ``world``: whether
there is one; ``missing``: files; ``refuse_scene``: why it does not open the scene; and numbers of renders,
over all processes: ``kill``: in which it kills itself; ``hang``, ``garbage``, ``refuse``, ``small``,
``no_picture``, ``fifo``, ``link``, ``unknown``: which fail so. ``noise``: bytes that it prints first, -1 for
no end; ``hello``: its first reply; ``opened``, ``boxes``: what is other in these replies. Every render is a
line in a log beside the file.
"""

import json
import os
import signal
import struct
import sys
import time

MARK = b"\n--omniscv-blender-1--\n"
OBJECTS = {"Floor": 1, "Roof": 2}


def main():
    assert sys.argv[2] == "--background", sys.argv
    assert sys.argv[-1].endswith("inside.py"), sys.argv
    path = os.path.join(os.path.dirname(os.path.abspath(os.environ["FAKE_BLENDER"])), "room.blend")
    with open(f"{path}.json", encoding="utf-8") as file:
        faults = json.load(file)
    say(b"Blender 5.0.1 (fake)\nRead prefs\n" + b"\0" * faults.get("noise", 0))
    while faults.get("noise") == -1:
        say(b"\0" * 65536)
    say(MARK)
    reply(faults.get("hello", {"version": [int(part) for part in sys.argv[1].split(".")]}))
    while True:
        head = sys.stdin.buffer.read(4)
        if len(head) < 4:
            return
        asked = json.loads(sys.stdin.buffer.read(struct.unpack(">I", head)[0]))
        reply(answer(asked, path, faults))


def answer(asked, path, faults):
    if asked["do"] == "open":
        if "refuse_scene" in faults:
            return {"error": faults["refuse_scene"]}
        about = {"scene": "Scene", "frame": 1, "objects": OBJECTS, "metres": 1.0, "camera": None}
        about |= {"lights": {}, "materials": {}, "transfer": "unknown", "libraries": []}
        about |= {"world": faults.get("world", True), "missing": faults.get("missing", [])}
        return about | faults.get("opened", {})
    if asked["do"] == "boxes":
        boxes = {"Floor": [[0, 0, 0], [[1, 0, 0], [0, 1, 0], [0, 0, 1]], [10, 10, 0]]}
        return {"places": {"Floor": [0, 0, 0]}, "boxes": faults.get("boxes", boxes)}
    number = logged(path, asked["kind"])
    if number in faults.get("kill", ()):
        os.kill(os.getpid(), signal.SIGKILL)
    if number in faults.get("hang", ()):
        time.sleep(100)
    if number in faults.get("garbage", ()):
        say(struct.pack(">I", 7) + b"garbage")
    if number in faults.get("refuse", ()):
        return {"error": "Error: Out of memory in CPU device buffers"}
    if number in faults.get("unknown", ()):
        return {"metres": "a few"}
    file = os.path.join(asked["folder"], asked["file"])
    if number in faults.get("fifo", ()):
        os.mkfifo(file)
    elif number in faults.get("link", ()):
        os.symlink("/dev/zero", file)
    elif number not in faults.get("no_picture", ()):
        render(asked, 8 if number in faults.get("small", ()) else 0)
    return {"metres": 1.0}


def logged(path, kind):
    """Append a line to the log; the number of lines before it."""
    with open(f"{path}.log", "a+", encoding="utf-8") as log:
        log.write(f"{kind}\n")
        log.seek(0)
        return len(log.readlines()) - 1


def render(asked, less):
    import numpy as np  # here, so that it starts fast

    (width, height) = asked["size"]
    tangent = asked["tan_half_fov"]
    width -= less
    x = (np.arange(width) + 0.5 - width / 2) / (width / 2) * tangent
    y = (np.arange(height) + 0.5 - height / 2) / (width / 2) * tangent
    x, y = np.meshgrid(x, y)
    rays = np.stack([x, -y, -np.ones_like(x)], axis=-1) @ np.array(asked["R_w_b"]).T
    hit = rays[..., 2] < 0
    depth = np.where(hit, -asked["position"][2] / np.where(hit, rays[..., 2], -1), 1e10)
    hit &= "Floor" not in asked["hidden"]
    file = os.path.join(asked["folder"], asked["file"])
    if asked["kind"] == "lit":
        colors = 0.5 + 0.5 * rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        write(file, [("Combined", "RGB", colors)] if file.endswith("exr") else [("", "RGB", colors)])
        return
    normal = np.zeros((*hit.shape, 3))
    normal[..., 2] = hit
    depth = np.where(hit, depth, 1e10)
    write(file, [("Depth", "Z", depth[..., None]), ("Normal", "XYZ", normal),
                 ("Object Index", "X", hit[..., None])])  # fmt: skip


def write(file, passes):
    """A PNG of 8 bits, or an EXR of one part for each pass, as Blender's."""
    import numpy as np
    import OpenImageIO

    specs = []
    for name, letters, pixels in passes:
        height, width = pixels.shape[:2]
        form = "float" if file.endswith("exr") else "uint8"
        spec = OpenImageIO.ImageSpec(width, height, len(letters), form)
        if name:
            spec.channelnames = [f"ViewLayer.{name}.{letter}" for letter in letters]
            spec.attribute("name", f"ViewLayer.{name}")
        specs.append(spec)
    out = OpenImageIO.ImageOutput.create(file)
    opened = out.open(file, tuple(specs)) if len(specs) > 1 else out.open(file, specs[0])
    assert opened, out.geterror()
    for number, (_, _, pixels) in enumerate(passes):
        if number:
            assert out.open(file, specs[number], "AppendSubimage"), out.geterror()
        assert out.write_image(np.ascontiguousarray(pixels, np.float32)), out.geterror()
    out.close()


def reply(message):
    data = json.dumps(message).encode()
    say(struct.pack(">I", len(data)) + data)


def say(data):
    sys.stdout.buffer.write(data)
    sys.stdout.buffer.flush()


main()
