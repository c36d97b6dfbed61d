"""Renders a scene inside Blender, as requests on the standard input say.

Blender's licence is the GNU GPL. This program runs inside Blender's process: omniscv talks to it over pipes,
and imports nothing of it. It needs Blender 5.0, or ``bpy``, and the NumPy that comes with them.

Frames each way: 4 bytes, the length, big endian, then so much JSON; ``MARK`` comes before the first one.
Pictures go to files in the folder that requests name.
"""

import json
import math
import os
import queue
import shutil
import sys
import threading
from typing import IO, Any

import bpy  # type: ignore[import-not-found]
import numpy as np
from mathutils import Matrix  # type: ignore[import-not-found]
from numpy.typing import NDArray

sys.path.append(os.path.dirname(os.path.abspath(__file__)))  # Blender knows nothing of omniscv

from inside_scene import (  # type: ignore[import-not-found]
    make_instances_real,
    named_objects,
    select_scene,
    show_as_rendered,
    vertices_of,
)

MARK = b"\n--omniscv-blender-1--\n"
MOST_OBJECTS = 32_767  # what a pass index can be
CAMERA = "omniscv.camera"
Message = dict[str, Any]


class World:
    """The opened scene.

    Attributes:
        ids: name of each object that pictures may show to its pass index.
        named: those names to the objects.
        metres: of a unit of the scene.
        viewer: where the scene's own camera is, in units; None without one.
    """

    def __init__(self, settings: Message) -> None:
        self.settings = settings
        bpy.ops.wm.read_factory_settings(use_empty=True)
        bpy.ops.wm.open_mainfile(filepath=settings["path"], load_ui=False, use_scripts=False)
        self.scene = select_scene(settings["scene"])
        bpy.context.window.scene = self.scene
        self.layer = next((item for item in self.scene.view_layers if item.use), self.scene.view_layers[0])
        bpy.context.window.view_layer = self.layer
        self.scene.frame_set(self.scene.frame_current if settings["frame"] is None else settings["frame"])
        self.metres = self.scene.unit_settings.scale_length
        show_as_rendered(self.layer)
        make_instances_real(self.scene)
        self.named = named_objects(self.layer)
        if len(self.named) > MOST_OBJECTS:
            raise RuntimeError(f"expected at most {MOST_OBJECTS} objects, got {len(self.named)}")
        self.ids = {name: 1 + i for i, name in enumerate(sorted(self.named))}
        for item in bpy.data.objects:
            item.pass_index = 0
        for name, index in self.ids.items():
            self.named[name].pass_index = index
        self.hidden: set[str] = set()
        self.rest = {name: item.matrix_world.copy() for name, item in self.named.items()}
        self.moved: set[str] = set()
        self.undo: list[tuple[Any, str, Any]] = []  # what draws have changed: owner, attribute, value before
        self.sockets = settings_of(self.scene, self.layer, self.named.values())
        self.viewer = self.scene.camera and tuple(self.scene.camera.matrix_world.translation)
        self.camera = bpy.data.objects.new(CAMERA, bpy.data.cameras.new(CAMERA))
        self.scene.collection.objects.link(self.camera)
        self.scene.camera = self.camera
        self.prepare()

    def description(self) -> Message:
        """Return what is known of the scene before anything is rendered."""
        paths = [bpy.path.abspath(item.filepath) for item in bpy.data.libraries]
        textures = [
            bpy.path.abspath(item.filepath, library=item.library)
            for item in bpy.data.images
            if item.source == "FILE" and not item.packed_file
        ]
        return {
            "scene": self.scene.name,
            "frame": self.scene.frame_current,
            "objects": self.ids,
            "world": self.scene.world is not None,
            **{
                kind: {name: {key: size_of(*at) for key, at in of.items()} for name, of in by_name.items()}
                for kind, by_name in self.sockets.items()
            },
            "metres": self.metres,
            "transfer": self.transfer(),
            "camera": None if self.viewer is None else [self.metres * x for x in self.viewer],
            "libraries": sorted(filter(os.path.isfile, paths)),
            "missing": sorted({path for path in (*paths, *textures) if not os.path.isfile(path)}),
        }

    def transfer(self) -> str:
        """Return what 8-bit colours say of light: known of view transforms that change no contrast."""
        view = self.scene.view_settings
        display = self.scene.display_settings.display_device
        changed = view.look != "None" or view.gamma != 1 or view.use_curve_mapping or display != "sRGB"
        known = {} if changed else {"Standard": "srgb", "Raw": "linear"}
        return known.get(view.view_transform, "unknown")

    def prepare(self) -> None:
        """Set what all renders have in common: pictures as they are, without anything drawn over them."""
        render = self.scene.render
        cycles = self.scene.cycles
        render.engine = "CYCLES"
        render.resolution_percentage = 100
        render.pixel_aspect_x = render.pixel_aspect_y = 1
        render.dither_intensity = 0
        render.use_file_extension = False
        render.use_persistent_data = True
        for switch in ("use_border", "use_multiview", "use_motion_blur", "use_freestyle", "use_stamp",
                       "use_compositing", "use_sequencer"):  # fmt: skip
            setattr(render, switch, False)
        for layer in self.scene.view_layers:
            layer.use = layer == self.layer
        cycles.use_animated_seed = False
        cycles.seed = self.settings["seed"]
        use_device(self.scene, self.settings["device"])
        if self.settings["threads"]:
            render.threads_mode = "FIXED"
            render.threads = self.settings["threads"]
        names = "pixel_filter_type", "filter_width", "max_bounces"
        self.look = {name: getattr(cycles, name) for name in names}

    def render(self, request: Message) -> Message:
        """Render one view into a file: colours, or all data at the centres of the pixels."""
        self.change(request)
        self.aim(request)
        file = os.path.join(request["folder"], request["file"])
        self.scene.render.filepath = file
        (self.set_colors if request["kind"] == "lit" else self.set_data)()
        bpy.ops.render.render(write_still=True, scene=self.scene.name, layer=self.layer.name)
        if not os.path.exists(file):
            raise RuntimeError("Blender has rendered no picture")
        return {"metres": self.metres}

    def aim(self, request: Message) -> None:
        """Set the camera: a pose from Blender's camera axes (x right, y up, z back) to its world."""
        data = self.camera.data
        render = self.scene.render
        tangent = request["tan_half_fov"]
        data.sensor_fit = "HORIZONTAL"
        data.lens = max(1.0, 18 / tangent)  # mm, at least 1
        data.sensor_width = 2 * data.lens * tangent
        data.clip_start, data.clip_end = (depth / self.metres for depth in self.settings["clip"])
        render.resolution_x, render.resolution_y = request["size"]
        pose = Matrix(request["R_w_b"]).to_4x4()
        pose.translation = [x / self.metres for x in request["position"]]
        self.camera.matrix_world = pose

    def set_data(self) -> None:
        """One sample at the centre of every pixel, without light; Blender knows no filter below 0.01 px."""
        cycles = self.scene.cycles
        self.use_passes("z", "normal", "object_index")
        cycles.samples = 1
        cycles.use_adaptive_sampling = False
        cycles.use_denoising = False
        cycles.pixel_filter_type = "BOX"
        cycles.filter_width = 0.01
        cycles.max_bounces = 0
        multi_layer_exr(self.scene.render.image_settings)

    def set_colors(self) -> None:
        """As many samples as the address says, through the scene's pixel filter."""
        cycles = self.scene.cycles
        image = self.scene.render.image_settings
        self.use_passes("combined")
        for name, value in self.look.items():
            setattr(cycles, name, value)
        cycles.samples = self.settings["samples"]
        cycles.use_adaptive_sampling = False
        cycles.use_denoising = self.settings["denoiser"] != "none"
        if cycles.use_denoising:
            cycles.denoiser = self.settings["denoiser"].upper()
        if self.settings["lit"] == "float32":
            multi_layer_exr(image)
            return
        image.media_type = "IMAGE"
        image.file_format = "PNG"
        image.color_mode = "RGB"
        image.color_depth = "8"
        image.compression = 0

    def use_passes(self, *names: str) -> None:
        """Render only these passes."""
        for setting in self.layer.bl_rna.properties:
            if setting.identifier.startswith("use_pass_"):
                setattr(self.layer, setting.identifier, False)
        for name in names:
            setattr(self.layer, f"use_pass_{name}", True)

    def change(self, request: Message) -> None:
        """Hide and place objects, and set lights and materials; whatever was changed before is put back."""
        hidden = set(request["hidden"])
        poses = request["poses"]
        for name in hidden ^ self.hidden:
            self.named[name].hide_render = name in hidden
        for name in sorted(self.moved | poses.keys()):
            place(self.named[name], self.rest[name], poses.get(name), self.metres)
        self.hidden = hidden
        self.moved = set(poses)
        for owner, attribute, value in reversed(self.undo):
            setattr(owner, attribute, value)
        self.undo = []
        for kind, by_name in self.sockets.items():
            for name, settings in request["varied"].get(kind, {}).items():
                for key, value in settings.items():
                    self.set(*by_name[name][key], value)
        bpy.context.view_layer.update()

    def set(self, owner: Any, attribute: str, value: Any) -> None:
        """Set a value, or a vector's first ones: colours of shaders have an alpha."""
        old = getattr(owner, attribute)
        old = old if isinstance(old, float) else tuple(old)
        self.undo.append((owner, attribute, old))
        if attribute == "temperature":
            self.undo.append((owner, "use_temperature", owner.use_temperature))
            owner.use_temperature = True
        if attribute == "angle":
            value = math.radians(value)
        setattr(owner, attribute, value if isinstance(old, float) else (*value, *old[len(value) :]))

    def boxes(self, request: Message) -> Message:
        """Return by object its place, and a box around its vertices in its own axes, instances included."""
        self.change(request)
        names = {index: name for name, index in self.ids.items()}
        points: dict[str, Any] = {}
        for instance in bpy.context.evaluated_depsgraph_get().object_instances:
            name = names.get(instance.object.pass_index)
            if name is not None and len(vertices := vertices_of(instance)):
                points.setdefault(name, []).append(vertices)
        places = {name: item.matrix_world.translation for name, item in self.named.items()}
        return {
            "places": {name: [self.metres * x for x in place] for name, place in places.items()},
            "boxes": {
                name: self.box(np.concatenate(rows), self.named[name].matrix_world)
                for name, rows in points.items()
            },
        }

    def box(self, points: NDArray[np.float64], matrix: Any) -> list[Any]:
        """Return centre, axes in rows, and size, in metres."""
        axes = np.array(matrix.to_quaternion().to_matrix())
        along = points @ axes
        low, high = along.min(axis=0), along.max(axis=0)
        center = axes @ ((low + high) / 2)
        return [(self.metres * center).tolist(), axes.T.tolist(), (self.metres * (high - low)).tolist()]


LIGHT = {"power": "energy", "kelvin": "temperature", "color": "color", "angle_deg": "angle"}
"""Attributes of lights by the names that jobs have for them."""


def settings_of(scene: Any, layer: Any, items: Any) -> dict[str, dict[str, dict[str, tuple[Any, str]]]]:
    """Return what draws may set of lights and materials: by kind, name and setting, owner and attribute.

    Of shaders those inputs of the node at the output that no other node gives.
    """
    lights: dict[str, Any] = {}
    for item in layer.objects:
        if item.type == "LIGHT" and not item.hide_render:
            if item.data.users > 1:
                item.data = item.data.copy()
            found = {key: (item.data, name) for key, name in LIGHT.items() if hasattr(item.data, name)}
            lights[item.name] = found
    if scene.world is not None and (inputs := inputs_of(scene.world)):
        lights["World"] = inputs
    used = {slot.material for item in items for slot in item.material_slots if slot.material}
    materials = {each.name: inputs_of(each) for each in used}
    return {"lights": lights, "materials": {name: of for name, of in sorted(materials.items()) if of}}


def inputs_of(shaded: Any) -> dict[str, tuple[Any, str]]:
    """Return the inputs of a material's or world's shader by name: ``base_color`` is Base Color."""
    output = shaded.node_tree and shaded.node_tree.get_output_node("CYCLES")
    links = output.inputs["Surface"].links if output else ()
    free = [each for link in links for each in link.from_node.inputs if not each.is_linked]
    return {
        each.name.lower().replace(" ", "_"): (each, "default_value")
        for each in free
        if each.enabled and each.type in ("VALUE", "RGBA", "VECTOR")
    }


def size_of(owner: Any, attribute: str) -> int:
    """Return how many numbers a setting has."""
    return 1 if isinstance(getattr(owner, attribute), float) else 3


def place(item: Any, rest: Any, pose: Any, metres: float) -> None:
    """Place an object by a rotation and metres, or where it was; what would move it otherwise is removed."""
    item.animation_data_clear()
    item.constraints.clear()
    item.parent = None
    matrix = rest.copy()
    if pose is not None:
        R_w_o, position = pose
        turn = Matrix(R_w_o) @ rest.to_quaternion().to_matrix().transposed()
        matrix = turn.to_4x4() @ rest
        matrix.translation = [x / metres for x in position]
    item.matrix_world = matrix


def multi_layer_exr(image: Any) -> None:
    image.media_type = "MULTI_LAYER_IMAGE"
    image.file_format = "OPEN_EXR_MULTILAYER"
    image.color_depth = "32"
    image.exr_codec = "NONE"


def use_device(scene: Any, device: str) -> None:
    """Render on the CPU, or on all devices of a type, such as ``cuda``."""
    scene.cycles.device = "CPU" if device == "cpu" else "GPU"
    if device == "cpu":
        return
    preferences = bpy.context.preferences.addons["cycles"].preferences
    try:
        preferences.compute_device_type = device.upper()
    except TypeError:
        raise RuntimeError(f"expected a device of kind {device}, which this Blender does not know") from None
    preferences.refresh_devices()
    for item in preferences.devices:
        item.use = item.type == device.upper()
    if not any(item.use for item in preferences.devices):
        raise RuntimeError(f"expected a device of kind {device}, found none")


# -- the pipes ------------------------------------------------------------------------------------------


def main() -> None:
    """Answer requests until the input ends, which is when the process that started this one is gone."""
    replies = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # drops what Blender prints
    replies.write(MARK)
    send(replies, {"version": list(bpy.app.version)})
    requests = queue.SimpleQueue[Message]()
    world: Any = None
    threading.Thread(target=read, args=(sys.stdin.buffer, requests), daemon=True).start()
    while True:
        request = requests.get()
        try:
            if request["do"] == "open":
                world = World(request)
                answer = world.description()
            else:
                answer = {"render": world.render, "boxes": world.boxes}[request["do"]](request)
        except (RuntimeError, MemoryError) as wrong:  # what Blender reports; other errors end this program
            answer = {"error": " ".join(str(wrong).split()) or type(wrong).__name__}
        send(replies, answer)


def read(stream: IO[bytes], requests: "queue.SimpleQueue[Message]") -> None:
    """Put requests in a queue. Their end ends this program at once, even while it renders, and removes the
    folders that they have named."""
    folders: set[str] = set()
    while len(head := stream.read(4)) == 4:
        request = json.loads(stream.read(int.from_bytes(head, "big")))
        folders.add(request["folder"])
        requests.put(request)
    for folder in folders:
        shutil.rmtree(folder, ignore_errors=True)
    os._exit(0)


def send(stream: IO[bytes], message: Message) -> None:
    data = json.dumps(message).encode()
    stream.write(len(data).to_bytes(4, "big") + data)
    stream.flush()


if __name__ == "__main__":
    main()
