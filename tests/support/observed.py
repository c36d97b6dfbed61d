"""Images with what is known of their scenes, in memory and as frames on disk."""

import json
from dataclasses import replace

import omniscv
from omniscv.dataset import truths
from omniscv.frame import Frame

MODES = ("lit", "object_mask", "depth")


def observed(source, camera, pose, modes=MODES, classes=None, renderer=None, **options):
    """An image of a source as a dataset sees it; instance ids are the labels plus 100."""
    renderer = renderer or omniscv.Renderer(source)
    image = renderer.render(camera, pose, modes, omniscv.RenderOptions(**options))
    instances = {name: 100 + image.objects.label(name) for name in image.objects.names()}
    labels = image.labels + (image.labels > 0) * image.labels.dtype.type(100)
    image = replace(image, layers={**image.layers, "labels": labels})
    known = {"image": image, "geometry": source.geometry(), "renderer": renderer}
    return Frame("frame", "camera", camera, pose, instances=instances, classes=classes, **known)


def framed(seen, folder, wanted=(), key="frame", split="", **options):
    """A frame on disk with its colours, labels and some truths, each with its options."""
    image = seen.image
    written = replace(image, objects=None).save(folder, key)
    records = {name: truths.get(name).apply(seen, options.get(name, {})) for name in wanted}
    (folder / f"{key}.truth.json").write_text(json.dumps(records, allow_nan=False))
    files = {path.name.split(".")[1]: path for path in written} | {"truth": folder / f"{key}.truth.json"}
    instances = seen.instances
    classes = seen.classes
    return Frame(key, "camera", image.camera, image.pose, files, instances, classes, split=split)
