"""A store on loopback, and a cache, that tests of this folder share."""

import pytest
from support.stores import s3_server


@pytest.fixture(scope="package")
def s3():
    """A boto3 client of an S3 server with the bucket of :mod:`support.stores`."""
    with s3_server() as client:
        yield client


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    """The folder of the local cache, new for each test."""
    monkeypatch.setenv("OMNISCV_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"
