"""The speed of a download, and what a kill costs.

    python benchmarks/download.py                      # nginx where it is on the PATH, else Python's own server
    python benchmarks/download.py --repeats 9 --kills 20

Throughput: one large file, and eight shards at once, against curl from the same server and against cp from the same
folder. The methods take turns; the ratio is the median over the turns. Ours includes the sha256 of every byte and the
fsync of every file, and not the start of Python. curl and cp do neither: further rows add sync, and sha256sum.

Kills: a download of the same files is killed (SIGKILL) at random moments and started again until it is whole, and the
server counts the bytes.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from rich.table import Table

from benchmarks.results import finish, parser, target
from rema_data.download import download
from rema_data.release.manifest import BlockEntry, FileEntry, Manifest
from tests.rema_data.download.servers import serve

MB = 1_000_000
SHARDS, SHARD_MB, LARGE_MB = 8, 30, 512
CURL_SHARE = 0.8
EXTRA_SHARE = 0.05
KILL_RATE = 80 * MB
"""Bytes a second of the server of the kill test, so that the moments fall into the transfer and not between two."""
NGINX = """
{user}
daemon off; worker_processes 1; pid {folder}/pid; error_log {folder}/error.log;
events {{}}
http {{
  access_log off; sendfile on;
  client_body_temp_path {folder}/a; proxy_temp_path {folder}/b; fastcgi_temp_path {folder}/c;
  uwsgi_temp_path {folder}/d; scgi_temp_path {folder}/e;
  server {{ listen 127.0.0.1:{port}; root {root}; }}
}}
"""


def make_release(folder: Path, name: str, sizes: list[int]) -> Manifest:
    """Random files below ``folder / name``, and their manifest."""
    rng = np.random.default_rng(0)
    entries = []
    for number, size in enumerate(sizes):
        data = rng.bytes(size)
        path = f"round-1/grasp/train/maps.zarr/scene/c/{number}"
        target_path = folder / name / path
        target_path.parent.mkdir(parents=True, exist_ok=True)
        target_path.write_bytes(data)
        entries.append(FileEntry(path, size, hashlib.sha256(data).hexdigest(), name))
    block = BlockEntry(1, "grasp", "train", 0, 0, 0, 0, ("random",), name)
    made = Manifest(name, name, "Random bytes.", "CC0-1.0", "", (block,), tuple(entries))
    (folder / f"{name}.json").write_bytes(made.to_bytes())
    return made


@contextmanager
def server(root: Path, folder: Path) -> Iterator[tuple[str, str]]:
    """Name and URL of a web server of ``root``, in a process of its own."""
    with socket.create_server(("127.0.0.1", 0)) as unused:
        port = unused.getsockname()[1]
    nginx = shutil.which("nginx")
    if nginx:
        config = folder / "nginx.conf"
        user = "user root;" if os.geteuid() == 0 else ""
        config.write_text(NGINX.format(user=user, folder=folder, port=port, root=root))
        command = [nginx, "-c", str(config)]
    else:
        command = [sys.executable, "-m", "http.server", str(port), "--bind", "127.0.0.1", "--directory", str(root)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        for _ in range(100):
            try:
                socket.create_connection(("127.0.0.1", port), timeout=1).close()
                break
            except OSError:
                time.sleep(0.05)
        yield "nginx" if nginx else "http.server", f"http://127.0.0.1:{port}"
    finally:
        process.terminate()
        process.wait()


def seconds(work: Callable[[Path], None], folder: Path) -> float:
    """Time of ``work`` into an empty folder."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    os.sync()
    began = time.perf_counter()
    work(folder)
    took = time.perf_counter() - began
    shutil.rmtree(folder)
    return took


def methods(release: Manifest, mirror: Path, url: str) -> dict[str, Callable[[Path], None]]:
    """The contestants: each brings the files of a release into a folder."""
    files = [entry.location for entry in release.files]
    names = [f"{number}" for number in range(len(files))]

    def run(*command: str, cwd: Path) -> None:
        subprocess.run(command, cwd=cwd, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def curl(folder: Path) -> None:
        wanted = [word for file, name in zip(files, names, strict=True) for word in ("-o", name, f"{url}/{file}")]
        run("curl", "-s", "--parallel", "--parallel-max", "8", *wanted, cwd=folder)

    def copy(folder: Path) -> None:
        for file, name in zip(files, names, strict=True):
            run("cp", str(mirror / file), name, cwd=folder)

    def then(fetch: Callable[[Path], None], *commands: str) -> Callable[[Path], None]:
        def both(folder: Path) -> None:
            fetch(folder)
            for command in commands:
                run(command, *names, cwd=folder)

        return both

    def ours(source: str) -> Callable[[Path], None]:
        def fetch(folder: Path) -> None:
            os.environ["REMA_HOME"] = str(folder)
            report = download(manifest=mirror / f"{release.name}.json", sources=[source])
            assert report.moved_bytes == report.bytes and report.sources == {source: report.files}

        return fetch

    return {
        "curl": curl,
        "curl, then sync": then(curl, "sync"),
        "curl, then sha256sum and sync": then(curl, "sha256sum", "sync"),
        "rema download, http": ours(url),
        "cp": copy,
        "cp, then sync": then(copy, "sync"),
        "cp, then sha256sum and sync": then(copy, "sha256sum", "sync"),
        "rema download, folder": ours(str(mirror)),
    }


def throughput(release: Manifest, mirror: Path, url: str, scratch: Path, repeats: int) -> dict[str, list[float]]:
    """MB/s of every contestant in every turn; a first turn is not counted."""
    size = sum(entry.bytes for entry in release.files) / MB
    speeds: dict[str, list[float]] = {}
    for turn in range(repeats + 1):
        for name, work in methods(release, mirror, url).items():
            took = seconds(work, scratch / "out")
            if turn:
                speeds.setdefault(name, []).append(size / took)
    return speeds


def killed(releases: list[Manifest], mirror: Path, scratch: Path, kills: int) -> tuple[int, int]:
    """Bytes that a server sent to a download that was killed so often, and the bytes of the files."""
    sent = size = 0
    for number, release in enumerate(releases):
        whole = sum(entry.bytes for entry in release.files)
        times = kills // len(releases)
        moments = np.sort(np.random.default_rng(number).uniform(0, whole, times))
        home = scratch / "killed"
        command = [sys.executable, "-m", "evaluator.cli", "download"]
        command += ["--manifest", str(mirror / f"{release.name}.json"), "--source"]
        with serve(mirror, bytes_per_second=KILL_RATE) as counting:
            options = {"env": os.environ | {"REMA_HOME": str(home)}, "stderr": subprocess.DEVNULL}
            for moment in moments:
                process = subprocess.Popen([*command, counting.url], stdout=subprocess.DEVNULL, **options)
                counting.wait_until_sent(int(moment), timeout_s=300)
                process.kill()
                process.wait()
            subprocess.run([*command, counting.url], check=True, stdout=subprocess.DEVNULL, **options)
            sent, size = sent + counting.sent, size + whole
        shutil.rmtree(home)
    return sent, size


def main() -> int:
    """Measure and print."""
    options = parser(__doc__)
    options.add_argument("--repeats", type=int, default=5, help="turns of every method (default 5)")
    options.add_argument("--kills", type=int, default=20, help="kills, half of them with each release (default 20)")
    options.add_argument("--scale", type=float, default=1.0, help="of the sizes of the files (default 1)")
    options.add_argument("--folder", type=Path, help="where the files are written (default: a temporary folder)")
    arguments = options.parse_args()
    with tempfile.TemporaryDirectory(dir=arguments.folder) as name:
        scratch, mirror = Path(name), Path(name) / "mirror"
        releases = {
            f"one file of {LARGE_MB} MB": make_release(mirror, "large", [int(LARGE_MB * MB * arguments.scale)]),
            f"{SHARDS} shards of {SHARD_MB} MB": make_release(
                mirror, "shards", [int(SHARD_MB * MB * arguments.scale)] * SHARDS
            ),
        }
        speeds = {}
        with server(mirror, scratch) as (kind, url):
            for what, release in releases.items():
                speeds[what] = throughput(release, mirror, url, scratch, arguments.repeats)
        sent, size = killed(list(releases.values()), mirror, scratch, arguments.kills)

    tables, targets, ratios = [], [], {}
    for what, by_method in speeds.items():
        table = Table("method", "MB/s, median", "MB/s, each repeat", title=f"{what}, {kind} on this machine")
        for method, values in by_method.items():
            table.add_row(method, f"{statistics.median(values):.0f}", ", ".join(f"{value:.0f}" for value in values))
        tables.append(table)
        for method, reference in (("rema download, http", "curl"), ("rema download, folder", "cp")):
            for other in [name for name in by_method if name.startswith(reference)]:
                pairs = zip(by_method[method], by_method[other], strict=True)
                ratios[f"{what}: {method} / {other}"] = statistics.median(ours / theirs for ours, theirs in pairs)
        share = ratios[f"{what}: rema download, http / curl"]
        targets.append(target(f"{what}, against curl", f">= {CURL_SHARE:.0%}", f"{share:.0%}", share >= CURL_SHARE))
    shares = Table("ratio, median over the repeats", "", title="throughput")
    for what, ratio in ratios.items():
        shares.add_row(what, f"{ratio:.0%}")
    extra = sent / size - 1
    kills = Table("kills", "bytes of the files", "bytes sent", "more", title="killed at random moments, and resumed")
    kills.add_row(str(arguments.kills), f"{size:,}", f"{sent:,}", f"{extra:.2%}")
    targets.append(target(f"{arguments.kills} kills", f"< {EXTRA_SHARE:.0%} more", f"{extra:.2%}", extra < EXTRA_SHARE))
    numbers = {"server": kind, "speeds_mb_s": speeds, "ratios": ratios, "kill_bytes": [sent, size]}
    return finish(arguments, "download", [*tables, shares, kills], targets, [], numbers)


if __name__ == "__main__":
    sys.exit(main())
