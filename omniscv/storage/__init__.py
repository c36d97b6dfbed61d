"""Files of a local folder, or of an object store by URL (``s3://bucket/rooms``): the same few operations.

``folder(where)`` returns the one or the other. A path costs nothing extra; a URL is opened through fsspec,
which the extra ``cloud`` installs.
"""

from omniscv.storage.base import Folder
from omniscv.storage.opening import Place, fetch_file, file_at, folder
from omniscv.storage.remote import SCHEMES, is_url, was_url, without_secrets

__all__ = [
    "SCHEMES",
    "Folder",
    "Place",
    "fetch_file",
    "file_at",
    "folder",
    "is_url",
    "was_url",
    "without_secrets",
]
