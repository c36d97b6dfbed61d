"""Score anybody's depth against truth that knows its own doubt.

::

    scores = omniscv.score.depth(predicted, truth, camera, doubt=doubt)
    scores.by_solid_angle.abs_rel

Pixels of a panorama are not alike: those beyond 60 degrees of latitude are a third of the picture and a
seventh of the sphere. So each measure comes twice, by pixels, as papers have it, and by solid angle. Pixels
whose truth is in doubt are left out and counted.
"""

from omniscv.score.alignment import ALIGNMENTS, align
from omniscv.score.areas import solid_angles
from omniscv.score.depth_scores import DepthScores, depth
from omniscv.score.edges import boundary_f1
from omniscv.score.intervals import Interval
from omniscv.score.labels import LabelScores, PanopticScores, labels, panoptic
from omniscv.score.measures import DepthMeasures
from omniscv.score.mistakes import Mistake, find_mistakes
from omniscv.score.normals import NormalScores, find_frame, normals
from omniscv.score.points import PointScores, cloud, points

__all__ = [
    "ALIGNMENTS", "DepthMeasures", "DepthScores", "Interval", "LabelScores", "Mistake", "NormalScores",
    "PanopticScores", "PointScores", "align", "boundary_f1", "cloud", "depth", "find_frame", "find_mistakes",
    "labels", "normals", "panoptic", "points", "solid_angles"
]  # fmt: skip
