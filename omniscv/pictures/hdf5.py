"""HDF5 of one array, such as Hypersim's: the data set ``dataset`` of a file, by the extra ``hdf5``."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import shown
from omniscv.errors import ArgumentError, OmniscvError
from omniscv.pictures import MAX_PIXELS
from omniscv.storage.bounded import open_regular

SUFFIXES = (".hdf5", ".h5")
_NAME = "dataset"
_MOST_CHANNELS = 4  # of a pixel


def read(file: Path) -> NDArray[Any]:
    """Return the array of a file.

    Raises:
        OmniscvError: the package h5py is not installed.
        ArgumentError: no such file, or another data set than one of numbers within it.
    """
    try:
        import h5py
    except ImportError as cause:
        raise OmniscvError("HDF5: expected the package h5py; pip install 'omniscv[hdf5]'") from cause
    with open_regular(file) as opened:
        try:
            with h5py.File(opened, "r") as content:
                return _array(content, h5py)
        except (OSError, RuntimeError, KeyError, ValueError) as cause:
            raise ArgumentError(f"expected HDF5, got: {shown(str(cause))}") from cause


def _array(content: Any, h5py: Any) -> NDArray[Any]:
    """Return the data set ``dataset``; ArgumentError for a link, or what is no array of numbers."""
    link = content.get(_NAME, getlink=True)
    if not isinstance(link, h5py.HardLink) or not isinstance(content[_NAME], h5py.Dataset):
        raise ArgumentError(f"expected a data set {_NAME!r}, got {shown(', '.join(list(content)[:8]))}")
    data = content[_NAME]
    if data.external or data.is_virtual:
        raise ArgumentError("expected numbers in the file itself, got those of other files")
    if data.dtype.kind not in "iuf" or not 0 < data.size <= _MOST_CHANNELS * MAX_PIXELS:
        raise ArgumentError(f"expected numbers of a picture, got {data.dtype} of shape {data.shape}")
    return np.asarray(data[()])
