"""``rema stats``: tables, JSON, figure."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from evaluator.cli.main import cli
from rema_data.release.folder import ReleaseFolder
from rema_data.release.registry import register
from rema_data.testing import make_release

PUBLISHED = Path(__file__).resolve().parents[3] / "manifests" / "published"
TASKS = ("grasp", "push", "grasp_grasp_push")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> ReleaseFolder:
    return make_release(tmp_path_factory.mktemp("whole"), tasks=TASKS, rounds=(1, 2), episodes=8)


@pytest.fixture
def release(whole: ReleaseFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ReleaseFolder:
    shutil.copytree(PUBLISHED, tmp_path / "manifests" / "published")
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path / "manifests"))
    monkeypatch.setenv("REMA_HOME", str(tmp_path / "home"))
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.chdir(tmp_path)
    register(whole.manifest)
    shutil.copytree(whole.path, tmp_path / "home" / "releases" / "tiny")
    return ReleaseFolder(whole.manifest, tmp_path / "home" / "releases")


def stats(*arguments: str | Path) -> Result:
    result = CliRunner().invoke(cli, ["stats", *map(str, arguments)])
    assert result.exit_code == 0, result.output
    return result


def test_tables_fit_a_terminal(release: ReleaseFolder) -> None:
    """The newest release by default; a row a step, and the totals."""
    lines = stats().stdout.splitlines()
    assert max(map(len, lines)) <= 80
    titles = [line for line in lines if line.startswith("tiny (")]
    assert [title.split()[-1] for title in titles] == ["1", "2"]
    assert sum(" 1 grasp " in line and " reference " in line for line in lines) == 2 * 2 * 1
    assert sum(re.search(r" \d last ", line) is not None for line in lines) == 2 * 2 * len(TASKS)
    total = next(line for line in lines if line.split()[:1] == ["sum"]).split()
    counts = release.manifest.counts
    assert total[1:3] == [str(counts["episodes"]), str(counts["steps"])]
    assert total[4] == str(counts["positives"])


def test_names_and_folders(release: ReleaseFolder) -> None:
    assert stats("tiny").stdout == stats(release.path).stdout


def test_blocks_that_are_not_here(release: ReleaseFolder) -> None:
    shutil.rmtree(release.path / "round-1")
    shutil.rmtree(release.path / "round-2" / "push")
    printed = " ".join(stats("tiny").stdout.split())
    assert "not counted: 8 blocks with 36 episodes" in printed
    assert "rema download tiny" in printed
    assert "round 1" not in printed
    shutil.rmtree(release.path / "round-2")
    assert "no block is on this machine" in stats(release.path).stdout


def test_check_paper(release: ReleaseFolder) -> None:
    lines = stats("--check-paper").stdout.splitlines()
    printed = " ".join(" ".join(lines).split())
    assert "grasp 28,533 22,129 50,662 56.32" in printed
    assert "last steps 38,123 80,747 118,870" in printed
    assert "tool picks" in printed and "tool pinches" in printed
    assert f"{release.manifest.counts['steps']}" in next(line for line in lines if "executed steps" in line)
    assert "14,662 more than its 36,000 episodes" in printed


def test_json_and_figure(release: ReleaseFolder, tmp_path: Path) -> None:
    printed = json.loads(stats("--json", "--check-paper", "--plot", "rounds.png").stdout)
    assert sorted(printed) == ["missing", "paper", "release", "sha256", "steps", "tasks"]
    assert printed["release"] == "tiny" and printed["sha256"] == release.manifest.sha256
    assert sum(row["reached"] for row in printed["steps"]) == release.manifest.counts["steps"]
    assert printed["paper"]["total"]["paper"] == {"positives": 38_123, "negatives": 80_747}
    assert (tmp_path / "rounds.png").read_bytes().startswith(b"\x89PNG")
    assert stats("--plot", "other.png").stdout.splitlines()[-1] == "other.png"


def test_a_condition_and_values(release: ReleaseFolder) -> None:
    pytest.importorskip("duckdb", reason="conditions need DuckDB, part of the extra `query`")
    words = ("--task", "grasp_grasp_push", "--where", "step = 1", "--values")
    printed = json.loads(stats(*words, "--json").stdout)
    reached = sum(row["reached"] for row in printed["steps"])
    values = {row["name"]: row for row in printed["values"]["channels"]}
    assert printed["values"]["steps"] == reached == values["x_m"]["count"] > 0
    assert values["scene"]["count"] == reached * 64 * 64 and values["mask_1"]["max"] == 1
    lines = stats(*words).stdout.splitlines()
    assert any(line.endswith("where step = 1, round 1") for line in lines)
    assert f"maps and actions of {reached} steps; q01 and q99 are quantiles" in lines
    assert {"scene", "depth_2", "mask_2", "theta_rad"} <= {line.split()[0] for line in lines if line.strip()}


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--where", "stepp = 1"], "there is no column 'stepp'\nthe nearest names: step"),
        (["--split", "val", "--check-paper"], "the paper's table is of a whole release"),
    ],
)
def test_selections_that_cannot_be(release: ReleaseFolder, words: list[str], says: str) -> None:
    pytest.importorskip("duckdb", reason="conditions need DuckDB, part of the extra `query`")
    result = CliRunner().invoke(cli, ["stats", *words])
    assert result.exit_code == 2 and says in result.stderr and not result.stdout


def test_a_damaged_table_of_a_copy_has_a_fix_that_works(release: ReleaseFolder, tmp_path: Path) -> None:
    """Fetching the release would leave this folder as it is."""
    copy = Path(shutil.copytree(release.path, tmp_path / "data" / "tiny"))
    table = copy / "round-1" / "grasp" / "train" / "steps.parquet"
    table.chmod(0o644)
    table.write_bytes(bytes(len(table.read_bytes())))
    result = CliRunner().invoke(cli, ["stats", str(copy)])
    assert result.exit_code == 6 and f"find all damage: rema verify {copy}" in result.stderr
    assert "open them by their name: rema download tiny" in result.stderr


def test_varied_episodes_are_counted_by_axis(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    varied = make_release(tmp_path, "varied", tasks=("grasp", "push"), episodes=12, varied=True)
    lines = stats(varied.path).stdout.splitlines()
    assert max(map(len, lines)) <= 80
    (start,) = [number for number, line in enumerate(lines) if "what is varied in the last step" in line]
    rows = [line.split() for line in lines[start:] if line.split()[:1] in (["grasp"], ["push"])]
    assert [row[:2] for row in rows] == [
        [t, a] for t in ("grasp", "push") for a in ("clean", "clutter", "mixed", "shape")
    ]
    assert sum(int(row[2]) for row in rows) == varied.manifest.counts["episodes"]
    told = json.loads(stats(varied.path, "--json").stdout)["axes"]
    assert {(row["axis"], row["level"]) for row in told} == {("", 0), ("clutter", 1), ("mixed", 1), ("shape", 1)}


def test_a_clean_release_has_no_axes(release: ReleaseFolder) -> None:
    assert "varied" not in stats().stdout
    assert "axes" not in json.loads(stats("--json").stdout)
