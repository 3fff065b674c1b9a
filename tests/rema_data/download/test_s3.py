"""Downloads from an S3 server (moto's)."""

from __future__ import annotations

from collections.abc import Iterator

import boto3
import fsspec
import pytest
from moto.server import ThreadedMotoServer

from rema_data.download import download
from rema_data.errors import MissingFileError
from rema_data.release.folder import downloads_folder
from tests.rema_data.download.conftest import BLOCK, Mirrored, Publish, fetched

STEPS = f"tiny/{BLOCK}/steps.parquet"


@pytest.fixture
def tiny(publish: Publish, monkeypatch: pytest.MonkeyPatch) -> Iterator[Mirrored]:
    """A release at ``s3://bucket/releases``."""
    made = publish(sizes={f"{BLOCK}/steps.parquet": 5_000_000, "DATASHEET.md": 500})
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    for name, value in {
        "AWS_ACCESS_KEY_ID": "test",
        "AWS_SECRET_ACCESS_KEY": "test",
        "AWS_DEFAULT_REGION": "us-east-1",
        "AWS_ENDPOINT_URL": f"http://{host}:{port}",
    }.items():
        monkeypatch.setenv(name, value)
    client = boto3.client("s3")
    client.create_bucket(Bucket="bucket")
    for location, data in made.content().items():
        client.put_object(Bucket="bucket", Key=f"releases/{location}", Body=data)
    yield made
    client.close()
    fsspec.filesystem("s3").clear_instance_cache()
    server.stop()


def test_s3(tiny: Mirrored) -> None:
    assert download("tiny", sources=["s3://bucket/releases"]).moved_bytes == tiny.size()
    assert fetched() == tiny.content()
    file = downloads_folder() / STEPS
    half = file.read_bytes()[:2_500_001]
    file.unlink()
    file.with_name("steps.parquet.part").write_bytes(half)
    report = download("tiny", sources=["s3://bucket/nothing", "s3://bucket/releases"])
    assert fetched() == tiny.content() and report.moved_bytes == 2_499_999
    file.unlink()
    with pytest.raises(MissingFileError, match="s3://nowhere: does not have it"):
        download("tiny", sources=["s3://nowhere"])
