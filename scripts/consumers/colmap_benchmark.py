"""The reference set as a dataset of COLMAP's benchmark of reconstruction.

COLMAP's folder ``benchmark/reconstruction`` has the benchmark; its module ``evaluation.utils`` says what a
dataset is. Register the class in its ``evaluate.py``::

    from colmap_benchmark import dataset_class
    DatasetOmniscv = dataset_class(evaluation.utils)

``--data_path`` is the folder of ``scripts/make-reference``; the categories are *still*, *varied*, *moving*
and *mesh*, and a scene is a folder of ``scenes``.
"""

from types import ModuleType
from typing import Any

NAME = "omniscv"
POSITION_ACCURACY_M = 1e-6
"""Positions are exact; nearer centres have no direction between them in float64 of pixels."""


def dataset_class(utils: ModuleType) -> type[Any]:
    """Return the dataset as a class of COLMAP's module ``evaluation.utils``."""

    class DatasetOmniscv(utils.Dataset):
        """Scenes with exact poses, lenses and points."""

        @property
        def position_accuracy_gt(self) -> float:
            """Metres."""
            return POSITION_ACCURACY_M

        @property
        def supports_covisibility_filtering(self) -> bool:
            """Whether points have tracks: they are those of depth, which has none."""
            return False

        def list_scenes(self) -> list[Any]:
            """Return the scenes that are exported to COLMAP's form."""
            infos = []
            for folder in sorted((self.data_path / "scenes").iterdir()):
                export = folder / "exports/colmap"
                category = folder.name.partition("-")[0]
                is_wanted = not self.categories or category in self.categories
                if not export.is_dir() or not is_wanted or (self.scenes and folder.name not in self.scenes):
                    continue
                images = export / "images"
                info = utils.SceneInfo(
                    dataset=NAME,
                    category=category,
                    scene=folder.name,
                    num_images=sum(path.is_file() for path in images.rglob("*")),
                    workspace_path=self.run_path / self.run_name / NAME / category / folder.name,
                    image_path=images,
                    sparse_gt_path=export / "sparse/0",
                    has_camera_priors=True,
                    colmap_extra_args=[],
                )
                infos.append(info)
            return infos

        def prepare_scene(self, scene_info: Any) -> None:
            """Do nothing: the truth is there."""

    return DatasetOmniscv
