"""``rema view``: what it serves and writes, refusals in a sentence, and how it ends."""

from __future__ import annotations

import json
import shutil
import signal
import socket
import subprocess
import sys
import urllib.request
import webbrowser
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from evaluator.cli.main import cli
from rema_data import interrupts
from rema_data.release.folder import ReleaseFolder
from rema_data.testing import make_release


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> ReleaseFolder:
    return make_release(tmp_path_factory.mktemp("tiny") / "releases", tasks=("grasp", "grasp_push"), episodes=10)


def view(*arguments: str) -> Result:
    return CliRunner().invoke(cli, ["view", *arguments], prog_name="rema")


def test_a_page_is_written(tiny: ReleaseFolder, tmp_path: Path) -> None:
    path = tmp_path / "pages" / "a.html"
    result = view(str(tiny.path), "--output", str(path), "--episodes", "3", "--filter", "task=grasp_push", "--json")
    assert result.exit_code == 0, result.stderr
    (about,) = json.loads(result.stdout)["files"]
    assert about == {"file": str(path), "bytes": path.stat().st_size, "episodes": 3}
    assert "round-1/grasp_push/train/" in path.read_text() and "round-1/grasp/train/" not in path.read_text()


def test_a_page_of_one_episode(tiny: ReleaseFolder, tmp_path: Path) -> None:
    path = tmp_path / "a.html"
    result = view(str(tiny.path), "--output", str(path), "--episode", "round-1/grasp/val/1")
    assert result.stdout == f"{path}: 0.1 MB, 1 episode\n", result.stderr


@pytest.mark.parametrize(
    ("arguments", "sentence", "code"),
    [
        (("nowhere",), "'nowhere' is neither a published release nor a folder", 2),
        (("RELEASE", "--filter", "task=fly"), "no episode has task fly", 2),
        (("RELEASE", "--episode", "nobody"), "there is no episode 'nobody' in tiny", 2),
        (("RELEASE", "--output", "a.html", "--filter", "q=nothing_of_that"), "no episode was selected", 2),
        (("RELEASE", "--output", "a.png"), "a.png is not an HTML file", 2),
        (("RELEASE", "--output", "a.html", "--port", "8000"), "--port is for serving", 2),
        (("RELEASE", "--play"), "--play is for a page in a file", 2),
        (("RELEASE", "--json"), "--json is for files", 2),
        (("RELEASE", "--mp4", "a.mp4"), "--mp4 writes one episode", 2),
        (("RELEASE", "--rrd", "a.rrd"), "--rrd writes one episode", 2),
        (("RELEASE", "--port", "99999"), "99999 is not in the range", 2),
    ],
)
def test_bad_input_is_refused_in_a_sentence(
    arguments: tuple[str, ...], sentence: str, code: int, tiny: ReleaseFolder
) -> None:
    result = view(*(str(tiny.path) if one == "RELEASE" else one for one in arguments))
    assert result.exit_code == code
    assert sentence in result.stderr and "Traceback" not in result.stderr


def test_a_taken_port_is_refused(tiny: ReleaseFolder) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        result = view(str(tiny.path), "--no-browser", "--port", str(other.getsockname()[1]))
    assert result.exit_code == 2
    assert "is taken" in result.stderr and "choose another --port" in result.stderr


def test_damage_is_said_before_the_page(tiny: ReleaseFolder, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(tiny.path, tmp_path / "tiny"))
    table = copy / "round-1" / "grasp" / "val" / "steps.parquet"
    table.write_bytes(bytes(table.stat().st_size))
    result = view(str(copy), "--output", str(tmp_path / "a.html"), "--episodes", "2")
    assert result.exit_code == 0
    assert f"table {table} is damaged" in result.stderr and "rema verify" in result.stderr


def test_the_browser_opens_the_link(tiny: ReleaseFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []

    def stopped() -> None:
        raise interrupts.Interrupted(signal.SIGINT)

    monkeypatch.setattr(webbrowser, "open", lambda link: bool(opened.append(link)))
    monkeypatch.setattr("evaluator.cli.view.interrupts.check", lambda: stopped() if opened else None)
    result = view(str(tiny.path), "--filter", "task=grasp&q=sim_steps>5", "--episode", "round-1/grasp/train/0")
    assert result.exit_code == 0, result.stderr
    (link,) = opened
    assert link.endswith("/#task=grasp&q=sim_steps%3E5&episode=round-1/grasp/train/0")
    assert result.stdout == link + "\n"
    assert "no browser was found" in result.stderr


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_is_the_ordinary_end(number: signal.Signals, tiny: ReleaseFolder) -> None:
    command = [sys.executable, "-m", "evaluator.cli", "view", str(tiny.path), "--no-browser"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, restore_signals=True)
    assert process.stdout is not None and process.stderr is not None
    address = process.stdout.readline().strip()
    with urllib.request.urlopen(f"{address}api/rows", timeout=60) as answer:
        assert json.load(answer)["total"] == 24
    process.send_signal(number)
    assert process.wait(60) == 0
    said = process.stderr.read()
    process.stdout.close()
    process.stderr.close()
    assert "serving 24 episodes of tiny; stop with Ctrl-C" in said and "Traceback" not in said
