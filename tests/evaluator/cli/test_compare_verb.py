"""`rema compare`: what a person sees, what a program gets, and what is refused."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from evaluator.cli.main import cli
from evaluator.cli.preview import preview
from evaluator.cli.view import view
from evaluator.view import Viewer, open_source
from tests.evaluator.runs import EPISODES, solved, use_installation, write_run, write_suite

A, B = solved(0.6, 1), solved(0.5, 2)


@pytest.fixture
def runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Path]:
    use_installation(tmp_path, monkeypatch)
    monkeypatch.setenv("COLUMNS", "100")
    return write_run(tmp_path / "a", A), write_run(tmp_path / "b", B, policy="other")


def compare(*arguments: object) -> Result:
    return CliRunner().invoke(cli, ["compare", *map(str, arguments)], prog_name="rema")


def test_the_page(runs: tuple[Path, Path]) -> None:
    result = compare(*runs)
    assert result.exit_code == 0, result.stderr
    text = " ".join(result.stdout.split())
    assert f"my_policy (submitted): {100 * A.mean():.1f} %" in text and f"{B.sum()}/{EPISODES}" in text
    assert f"{100 * (A.mean() - B.mean()):+.2f} points [" in text
    assert f"A solved {(A & B).sum()} {(A & ~B).sum()}" in text and f"A failed {(B & ~A).sum()}" in text
    assert "exploratory" in text and "0 ± 22.5 deg" in text and "80 % power" in text
    first = np.flatnonzero(A & ~B)
    assert f"solved by A alone: {len(first)}: {', '.join(map(str, first[:10]))} and {len(first) - 10} more" in text


def test_the_hint_shows_the_scenarios_that_were_compared(runs: tuple[Path, Path], tmp_path: Path) -> None:
    """It is a command that `rema preview` takes, with the split and the protocol of the runs."""
    others = [
        write_run(tmp_path / name, solved(rate, 1), split="val", protocol="end-to-end")
        for name, rate in (("c", 0.6), ("d", 0.5))
    ]
    for pair, split, protocol in ((runs, "test", "conditional"), (others, "val", "end-to-end")):
        (hint,) = (line for line in compare(*pair).stdout.splitlines() if line.startswith("look at one: "))
        words = hint.removeprefix("look at one: rema preview ").replace(" N", " 3").split()
        context = preview.make_context("preview", words)
        assert (context.params["split"], context.params["protocol"]) == (split, protocol)
        assert (context.params["tasks"], context.params["index"]) == (("grasp",), 3)


@pytest.mark.parametrize("changes", [{"suite": "tough-v1"}, {"protocol": "blank-scene"}])
def test_the_hint_shows_a_scenario_of_another_list(
    runs: tuple[Path, Path], tmp_path: Path, changes: dict[str, str]
) -> None:
    """`rema preview` has the lists in force alone, and blanks nothing: an episode of the run is shown."""
    count = EPISODES
    if "suite" in changes:
        count = len(write_suite(tmp_path / "manifests", changes["suite"]))
    a, b = solved(0.6, 1)[:count], solved(0.5, 2)[:count]
    pair = [write_run(tmp_path / name, found, **changes) for name, found in (("c", a), ("d", b))]
    (hint,) = (line for line in compare(*pair).stdout.splitlines() if line.startswith("look at one: "))
    first = int(np.flatnonzero(a & ~b)[0])
    said = view.make_context("view", shlex.split(hint.removeprefix("look at one: rema view "))).params
    viewer = Viewer(open_source(said["release_or_run"]))
    assert viewer.source.facts[2] == ("folder", str(pair[0]))
    assert viewer.place(said["episode"]) == first


def test_json_lists_every_discordant_scenario(runs: tuple[Path, Path]) -> None:
    content = json.loads(compare(*runs, "--json").stdout)
    assert content["discordant"] == {
        "only_a": np.flatnonzero(A & ~B).tolist(),
        "only_b": np.flatnonzero(B & ~A).tolist(),
    }
    assert sum(content["table"].values()) == content["n"] == EPISODES
    low, high = content["difference_ci95"]
    assert low < content["difference"] < high and 0 <= content["p"] <= 1


def test_a_policy_does_not_differ_from_itself(runs: tuple[Path, Path]) -> None:
    text = " ".join(compare(runs[0], runs[0]).stdout.split())
    assert "+0.00 points" in text and "p 1.0000" in text and "no difference with 80 % power" in text
    assert "solved by A alone: none" in text


def test_runs_that_do_not_compare(runs: tuple[Path, Path], tmp_path: Path) -> None:
    push = write_run(tmp_path / "push", A, task="grasp_push")
    result = compare(runs[0], push)
    assert result.exit_code == 2 and "task is grasp in" in result.stderr and "grasp_push in" in result.stderr
    assert compare(runs[0], tmp_path / "none").exit_code == 2


def test_another_simulator_is_on_the_page(runs: tuple[Path, Path], tmp_path: Path) -> None:
    other = write_run(tmp_path / "c", B, identity={"fingerprint": {"pybullet": "3.2.8"}})
    assert "ANOTHER SIMULATOR" in compare(runs[0], other).stdout
