"""``mujoco://MODEL.xml``: captures of a MuJoCo model. Colours by its renderer, data by its exact rays."""

from omniscv.sources.mujoco.source import MujocoSource, from_model, open_mujoco

__all__ = ["MujocoSource", "from_model", "open_mujoco"]
