"""Files in and out: folders of this machine or of an object store by URL (``s3://bucket/rooms``).

``folder(where)`` opens either. URLs are opened through fsspec, which the extra ``cloud`` installs.
"""

from omniscv.storage.base import Folder
from omniscv.storage.opening import StoredFile, fetch_file, file_at, folder
from omniscv.storage.remote import SCHEMES, is_url, was_url, without_secrets

__all__ = [
    "SCHEMES",
    "Folder",
    "StoredFile",
    "fetch_file",
    "file_at",
    "folder",
    "is_url",
    "was_url",
    "without_secrets",
]
