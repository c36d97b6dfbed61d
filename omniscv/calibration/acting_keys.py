"""Keys whose names say that they change what is seen.

A key that is read acts as in the program that wrote it. Any other whose name has to do with lens, pose, unit,
size, time or mask is refused by name, unless its value is neutral or it is on a list of those that change
nothing. Keys of other names pass.
"""

import re
from collections.abc import Collection

GEOMETRY = re.compile(
    r"skew|tilt|shear|^dist(?!anc|ribut)|distort|tangential|prism|radial|windshield|binning|^roi|crop|rectif|"
    r"mirror|linedelay|readout|shutter(?!us$|speed)|stretch|aspect|decenter|affine|^poly|^coef|^([kps]\W?\d.*|xi|alpha|beta|omega|fov)$"
)
"""Plain keys that may change the geometry of a lens: files of every form are refused that have others."""

TOPICS = {
    "lens": r"lens|focal|^fl[xy]?$|^f[xyu]$|fov|fieldofview|camera(angle|model|type)|intrins|matrix|"
    r"principal|^c[xy]$|^k$|projection|ftheta|fisheye|latlong|equirect|panoram|spheric|stereo",
    "pose": r"pose(?!ter)|extrins|transform|rotat|translat|quatern|position|orient|convention|coordinate|"
    r"handed|ax[ei]s$|c2w|w2c|camtoworld|cam2world|worldtocam|world2cam|flip|^from(na|mitsuba)$|normalmts|"
    r"inverse",
    "unit": r"unit|scale|met(re|er)s",
    "size": r"width|height|resolution|imagesize|imgsize",
    "time": r"time(?!s?$|stamp|code|zone)|delay|latency",
    "mask": r"mask",
}
"""What plain keys have to do with, by pattern."""

_HARMLESS = {
    "kalibr": r"^tcncnm1$|topic|overlaps|^timeshiftcamimustd$",
    "nerfstudio": r"^((file|depth|depthfile|mask|plyfile)path|transformmatrix|appliedtransform|appliedscale|"
    r"orientationoverride|autoscaleposesfactor|integerdepthscale|rotation|scale|(n|max|min)k|maskcolor)$|"
    r"^(aabb|renderaabb|exif|metadata)|(exposure|capture|date|create)time|filenames?$|id$",
}
"""By form, a pattern of plain keys that change nothing, or on which a reader of frames acts."""


def is_acting(key: str, form: str, topics: Collection[str] = tuple(TOPICS)) -> bool:
    """Return whether a key of a form has to do with one of some topics, and may change what is seen.

    Args:
        key: plain, that is in lower case without signs between its words; dots separate mappings.
        form: its name; of forms without a list of what changes nothing, no key is.
        topics: of :data:`TOPICS`.
    """
    if form not in _HARMLESS or re.search(_HARMLESS[form], key):
        return False
    patterns = [TOPICS[topic] for topic in topics]
    return any(re.search("|".join(patterns), word) for word in key.split("."))
