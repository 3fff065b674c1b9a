"""Real processes: two at once, and one that is killed again and again."""

from __future__ import annotations

import subprocess
import sys

import numpy as np

from tests.rema_data.download.conftest import BLOCK, Publish, fetched
from tests.rema_data.download.servers import serve

MB = 1_000_000
FILES = {f"{BLOCK}/maps.zarr/scene/c/0": 3 * MB, f"{BLOCK}/maps.zarr/scene/c/1": MB, "DATASHEET.md": 500}
CODE = """
import sys
from rema_data.download import download
from rema_data.progress import Silent
class Notes(Silent):
    def phase(self, name, total): print("begins", flush=True)
    def note(self, text): print(text, flush=True)
download("tiny", sources=[sys.argv[1]], progress=Notes())
"""


def start(url: str) -> subprocess.Popen[str]:
    return subprocess.Popen([sys.executable, "-c", CODE, url], stdout=subprocess.PIPE, text=True)


def said(process: subprocess.Popen[str]) -> str:
    """What a process has printed, once it has ended well."""
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    return out


def test_two_downloads_at_once_share_the_work(publish: Publish) -> None:
    tiny = publish(sizes=FILES)
    with serve(tiny.folder, bytes_per_second=8 * MB) as server:
        first = start(server.url)
        server.wait_until_sent(1)
        second = start(server.url)
        out = said(first), said(second)
        assert server.sent == tiny.size()
    assert "begins" in out[0] and "begins" not in out[1] and "waiting" not in out[0]
    assert fetched() == tiny.content()


def test_killed_and_resumed_moves_hardly_a_byte_twice(publish: Publish) -> None:
    tiny = publish(sizes={path: 4 * size for path, size in FILES.items()})
    moments = np.sort(np.random.default_rng(3).uniform(0, tiny.size(), 3))
    with serve(tiny.folder, bytes_per_second=16 * MB) as server:
        for moment in moments:
            process = start(server.url)
            server.wait_until_sent(int(moment))
            process.kill()
            process.communicate()
        assert said(start(server.url)) == "begins\n"
        extra = server.sent - tiny.size()
    assert fetched() == tiny.content()
    assert extra < 0.05 * tiny.size()  # only what was on its way
