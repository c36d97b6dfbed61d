"""Training data as tensors: WebDataset shards, datasets on disk, and recordings that are composed on the fly.

Everything here works with ``torch.utils.data.DataLoader`` and its default collation, with workers that are
forked or spawned. PyTorch is an extra, ``omniscv[torch]``.
"""

from omniscv.errors import OmniscvError

try:
    import torch as _torch  # noqa: F401
except ImportError as cause:
    message = "omniscv.torch: expected PyTorch, got none; install it with: pip install 'omniscv[torch]'"
    raise OmniscvError(message) from cause

from omniscv.torch.faces import Faces
from omniscv.torch.recordings import RandomTurns, RecordingDataset
from omniscv.torch.samples import LAYERS, FolderDataset, ShardDataset

__all__ = ["LAYERS", "Faces", "FolderDataset", "RandomTurns", "RecordingDataset", "ShardDataset"]
