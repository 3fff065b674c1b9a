"""The recursion: stage after stage, skipped where its product is there, and plans that cannot be carried out."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from baselines.rounds.recursion import Stage, publish, recurse, train_network
from baselines.rounds.recursion_plan import Published, load_recursion
from baselines.tae.checkpoint import load_checkpoint
from evaluator.policy.shipped import shipped_policies
from evaluator.sim.observation import observe
from evaluator.sim.simulator import Simulator
from rema_data import load
from rema_data.errors import InputError, MissingFileError, RunMismatchError
from rema_data.release.folder import find_release
from rema_data.statistics.count import count
from rema_data.testing import make_release
from rema_data.verify import verify
from tests.baselines.rounds.fakes import tree

PLAIN = 'policy = "tae-joint"'
ROOT = Path(__file__).parents[3]
TINY = ROOT / "examples" / "tiny.toml"


def first(count: int, stages: Iterator[Stage]) -> list[Stage]:
    """Stages up to the ``count``-th that had something to do."""
    done: list[Stage] = []
    while sum(not stage.already for stage in done) < count:
        done.append(next(stages))
    return done


def command(*words: str) -> list[str]:
    return [sys.executable, "-m", "evaluator.cli", *words]


def own_home(cwd: Path) -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT), "REMA_HOME": str(cwd / "home")}


def rema(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command(*words), cwd=cwd, env=own_home(cwd), capture_output=True, text=True, timeout=400)


def killed_after(stages: int, *words: str, cwd: Path) -> None:
    """Run a command that prints a line for every stage, and kill it without warning once so many are done."""
    with subprocess.Popen(command(*words), cwd=cwd, env=own_home(cwd), stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for line in process.stdout:
            stages -= "done in" in line
            if stages == 0:
                break
        process.send_signal(signal.SIGKILL)
    assert process.returncode == -signal.SIGKILL and stages == 0


def test_all_four_rounds_from_the_command_line(tmp_path: Path) -> None:
    """The example as a user runs it, killed in the middle and run again; then its product is scored."""
    killed_after(3, "rounds", str(TINY), "--output", "out", cwd=tmp_path)
    sealed = tree(tmp_path / "out" / "tiny-recursion-round-1")
    done = rema("rounds", str(TINY), "--output", "out", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("was there") == 3 and done.stdout.count("done in") == 7
    assert tree(tmp_path / "out" / "tiny-recursion-round-1") == sealed
    assert [stage.already for stage in recurse(load_recursion(TINY), tmp_path / "out")] == [True] * 10
    release = find_release(tmp_path / "out" / "tiny-recursion")
    assert {block.round: block.holder for block in release.manifest.blocks} == {
        1: "tiny-recursion-round-1",
        2: "tiny-recursion-round-2",
        3: "tiny-recursion-round-3",
        4: "tiny-recursion",
    }
    assert {block.key.task for block in release.manifest.blocks if block.round == 4} == {
        "grasp",
        "push",
        "grasp_grasp",
        "grasp_push",
    }
    networks = tmp_path / "out" / "checkpoints" / "tiny-recursion"
    _, about = load_checkpoint(networks / "joint" / "grasp")
    assert about.release_sha256 == release.manifest.sha256
    checked = rema("verify", "out/tiny-recursion", cwd=tmp_path)
    assert checked.returncode == 0, checked.stdout + checked.stderr
    scored = rema(
        *("evaluate", "tae-joint", "--checkpoint", str(networks / "joint"), "--task", "grasp_push"),
        *("--episodes", "6", "--json"),
        cwd=tmp_path,
    )
    assert scored.returncode == 0, scored.stderr


def written(folder: Path, *changes: tuple[str, str]) -> Path:
    text = TINY.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path = folder / "plan.toml"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('name = "tiny-recursion"', 'nom = "x"'), "nom is not a known field"),
        (('name = "tiny-recursion"', ""), "name is missing"),
        (('name = "tiny-recursion"', 'name = "../x"'), "'../x' cannot name a release"),
        (("tiny-recursion/round-1", "tiny-recursion/round-2"), "no earlier round trains"),
        (("tiny-recursion/round-1", "elsewhere/round-1"), "no earlier round trains"),
        (("updates = 20", "epochs = 20"), "rounds[1].networks[1].epochs is not a known field"),
        (('network = "round-1/grasp"', 'network = "../grasp"'), "rounds[1].networks[1].network is '../grasp'"),
        (('primitive = "grasp"', 'primitive = "throw"'), "rounds[1].networks[1].primitive is 'throw'"),
        (("{ train = 200, val = 80 }", "{ train = 200, test = 80 }"), "rounds[1].tasks.grasp.episodes.test is"),
        (('policy = "random"', 'policy = "randon"'), "no policy is called"),
        (("width = 8", "width = 7"), "width = 7"),
        (("seed = 1", "seed = -1"), "seed"),
        (('policy = "random"', "reuse = true"), "rounds[1].episodes is not a known field"),
        (("[[rounds]]", "[[rounds]]\nreuse = true\n[[rounds]]"), "rounds[1].reuse lacks its source"),
        (("seed = 1", 'seed = 1\npolicies = { tae-joint = ["joint"] }'), "policies.tae-joint"),
        (("seed = 1", 'seed = 1\npolicies = { tae-joint = { juggle = "joint" } }'), "policies.tae-joint.juggle"),
        (
            ("seed = 1", 'seed = 1\npolicies = { tae-joint = { push = "joined" } }'),
            "policies.tae-joint.push is 'joined'",
        ),
        (
            ("seed = 1", 'seed = 1\npolicies = { tae-joint = "joined" }'),
            "policies.tae-joint is 'joined': not a learned policy",
        ),
        (("seed = 1", 'seed = 1\nparent = "older"'), "parent is not a known field"),
        (("[[rounds.networks]]", "networks = 3\n[[rounds]]"), "rounds[1].networks is 3"),
        (("learning_rate = 3e-3", 'learning_rate = "3e-3"'), "learning_rate"),
        (("seed = 1", 'seed = 1\nbegins_with = "older"\n[[rounds]]\nreuse = true\nepisodes = 3'), "rounds[1].episodes"),
        (
            ('network = "round-2/grasp"', 'network = "round-1/pick"'),
            "round-1/pick is trained twice, or into",
        ),
        (('network = "round-3/push"', 'network = "round-3/grasp"'), "round-3/grasp is trained twice"),
        (("seed = 1", "seed = 1\nbegins_with = 5"), "begins_with is 5"),
        (("seed = 1", 'seed = 1\nbegins_with = "older"\ncontinues = "older"'), "begins_with and continues"),
        (
            ("seed = 1", 'seed = 1\npolicies = { tea-joint = "joint" }'),
            "policies.tea-joint is 'joint': not a learned policy",
        ),
        (
            ("{ train = 200, val = 80 }", "{ train = 200 }"),
            "learns grasp, of which no round so far",
        ),
        (
            ('tasks = ["grasp"]\nupdates', 'tasks = ["push", "grasp"]\nupdates'),
            "grasp learns push, of which no",
        ),
        (("width = 8", "width = 8.0"), "architecture.width is 8.0"),
        (("width = 8", "depth = 8"), "architecture.depth is not a known field"),
        (('picks = { code = "tae", checkpoint = "tiny-recursion/round-2" }', 'picks = "tae"'), "rounds[3]"),
    ],
)
def test_plans_that_cannot_be_carried_out(tmp_path: Path, change: tuple[str, str], words: str) -> None:
    """Said before anything is collected, with the file's name."""
    path = written(tmp_path, change)
    with pytest.raises(InputError, match=re.escape(words)) as caught:
        load_recursion(path)
    assert str(path) in caught.value.message and caught.value.hint


def test_rounds_that_are_reused_come_first(tmp_path: Path) -> None:
    second = next(line for line in TINY.read_text().splitlines() if "# 2: " in line)
    older = ("seed = 1", 'seed = 1\nbegins_with = "older"')
    with pytest.raises(InputError, match=r"rounds\[2\] is reused after a round that is collected"):
        load_recursion(written(tmp_path, older, (second, f"[[rounds]]\nreuse = true\n\n{second}")))


def test_networks_of_another_recursion_are_checked_first(tmp_path: Path) -> None:
    older = ("seed = 1", 'seed = 1\nbegins_with = "older"')
    plan = load_recursion(written(tmp_path, older, ("tiny-recursion/round-2", "older/round-2")))
    with pytest.raises(MissingFileError, match="no networks older/round-2") as caught:
        next(recurse(plan, tmp_path / "out"))
    assert caught.value.hint and not (tmp_path / "out").exists()


def test_a_plan_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError):
        load_recursion(tmp_path / "plan.toml")


def test_the_published_plans_can_be_carried_out() -> None:
    for path in sorted((ROOT / "manifests" / "plans").glob("rema-v*.toml")):
        plan = load_recursion(path)
        assert plan.name == path.stem == plan.rounds[-1].release
        assert {one.policy for one in plan.policies} <= {"tae-joint", "tae-separate"}


def test_a_whole_recursion_is_continued() -> None:
    """Its last release, which has its name, is what the first new round continues."""
    plan = load_recursion(ROOT / "manifests" / "plans" / "rema-v1-tool2.toml")
    releases = [entry.release for entry in plan.rounds]
    assert releases[:4] == ["rema-v1-round-1", "rema-v1-round-2", "rema-v1-round-3", "rema-v1"]
    assert releases[4:] == ["rema-v1-tool2-round-5", "rema-v1-tool2"]
    assert plan.policies == (Published("tae-joint", "joint", "grasp_grasp_push"),)


def test_the_papers_plan_has_the_papers_size() -> None:
    """All of it is collected: 36,000 episodes of grasp, 24,000 of each other task, a sixth to validate."""
    made = [one.collection for one in load_recursion(ROOT / "manifests" / "plans" / "rema-v1.toml").rounds]
    assert all(one is not None and one["episodes"] == {"train": 10_000, "val": 2_000} for one in made)
    of_task = Counter(task for one in made if one is not None for task in one["tasks"])
    assert of_task == {"grasp": 3, "push": 2, "grasp_grasp": 2, "grasp_push": 2}


def test_networks_that_ship_are_asked_for_where_a_plan_names_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Round 4 names its own networks for tae-joint: those of the manifest need not be on this machine."""
    files = {"grasp.safetensors": "0" * 64, "grasp.json": "0" * 64}
    content = {"policies": {"tae-joint": {"folder": "gone/joint", "files": files}}}
    (tmp_path / "checkpoints.json").write_text(json.dumps(content))
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path))
    monkeypatch.setenv("REMA_HOME", str(tmp_path / "home"))
    assert load_recursion(TINY).name == "tiny-recursion"
    plain = written(tmp_path, ('policy = { code = "tae-joint", checkpoint = "tiny-recursion/round-3" }', PLAIN))
    with pytest.raises(MissingFileError, match=r"rounds\[4\].*the networks of tae-joint \(gone/joint\)"):
        load_recursion(plain)


def test_networks_are_registered_for_all_tasks_or_for_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a second plan trains for one task leaves the first one's networks of the others as they are."""
    (tmp_path / "manifests").mkdir()
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path / "manifests"))
    made = make_release(tmp_path, "tiny-recursion", ("grasp",), episodes=4)
    for folder in ("round-1", "round-2", "round-3", "joint"):
        place = tmp_path / "checkpoints" / "tiny-recursion" / folder
        place.mkdir(parents=True)
        for name in ("grasp", "push"):
            (place / f"{name}.json").write_text(folder)
            (place / f"{name}.safetensors").write_text(folder)
    for text in ('"round-3"', '{ grasp_grasp_push = "joint" }'):
        plan = written(tmp_path, ("seed = 1", f"seed = 1\npolicies = {{ tae-joint = {text} }}"))
        publish(load_recursion(plan), tmp_path)
    shipped = shipped_policies()["tae-joint"]
    assert shipped.of("push").folder == "tiny-recursion/round-3" and set(shipped.tasks) == {"grasp_grasp_push"}
    assert shipped.of("grasp_grasp_push").folder == "tiny-recursion/joint"
    assert (tmp_path / "manifests" / "datasets" / f"{made.manifest.name}.json").is_file()


def test_a_release_of_another_plan_does_not_count_as_done(tmp_path: Path) -> None:
    small = written(tmp_path, ("{ train = 200, val = 80 }", "{ train = 9, val = 3 }"))
    assert [stage.already for stage in first(1, recurse(load_recursion(small), tmp_path / "out", workers=1))] == [False]
    with pytest.raises(RunMismatchError, match="other episodes"):
        next(recurse(load_recursion(TINY), tmp_path / "out"))


def test_one_network_alone(tmp_path: Path) -> None:
    path = tmp_path / "short.toml"
    text = TINY.read_text().replace("updates = 20", "updates = 4").replace("_every = 10", "_every = 4")
    path.write_text(text.replace("{ train = 200, val = 80 }", "{ train = 80, val = 60 }"))
    plan = load_recursion(path)
    with pytest.raises(MissingFileError, match="not sealed yet"):
        train_network(plan, tmp_path, "round-1/grasp")
    with pytest.raises(InputError, match="no network 'round-1/push'") as caught:
        train_network(plan, tmp_path, "round-1/push")
    assert "joint/push" in caught.value.hint
    first(1, recurse(plan, tmp_path, workers=1))
    assert not train_network(plan, tmp_path, "round-1/grasp").already
    assert train_network(plan, tmp_path, "round-1/grasp").already
    again = first(1, recurse(plan, tmp_path, workers=1))
    assert [(stage.what, stage.already) for stage in again[:2]] == [
        ("collect tiny-recursion-round-1", True),
        ("train round-1/grasp", True),
    ]


def test_rounds_of_another_recursion_are_shared(tmp_path: Path) -> None:
    """A recursion that begins with another one's rounds names its releases, and collects from there on."""
    text = TINY.read_text().replace('name = "tiny-recursion"', 'name = "second"\nbegins_with = "tiny-recursion"')
    head, first, rest = text.partition("[[rounds]]")
    second = rest.index("[[rounds]]")
    path = tmp_path / "second.toml"
    path.write_text(f"{head}{first}\nreuse = true\n\n{rest[second:]}")
    plan = load_recursion(path)
    assert [entry.release for entry in plan.rounds] == [
        "tiny-recursion-round-1",
        "second-round-2",
        "second-round-3",
        "second",
    ]
    with pytest.raises(MissingFileError, match="tiny-recursion-round-1"):
        next(recurse(plan, tmp_path / "out"))


BEFORE = """
name = "tiny"
title = "Tiny"
description = "What the varied rounds continue."
license = "CC-BY-4.0"
citation = "Nobody."
seed = 1

[[rounds]]
policy = "scripted"
picks = "reference"
episodes = { train = 24, val = 24 }
tasks = ["grasp", "push", "grasp_push"]
"""
"""Scripted grasps and pushes with a tool fail often enough to learn from."""
NETWORK = """
[[rounds.networks]]
network = "joint/{primitive}"
primitive = "{primitive}"
tasks = ["{task}"]
on_empty = "renormalise"
updates = 2
validate_every = 2
validation_steps = 4
architecture = {{ width = 8 }}
"""


def small(text: str) -> str:
    """The plan of rema-v1-hard at toy size: after one round instead of four, tools picked by the reference policy."""
    text = text.replace("[[rounds]]\nreuse = true\n\n" * 4, "[[rounds]]\nreuse = true\n\n").replace("rema-v1", "tiny")
    text = re.sub(r"train = \d+, val = \d+", "train = 12, val = 8", text).replace("round > 4", "round > 1")
    text = re.sub(r"picks = \{.*\}", 'picks = "reference"', text).replace('"grasp_grasp", ', "")
    text = re.sub(r"grasp_grasp = .*\n", "", text)
    short = 'on_empty = "renormalise"\nupdates = 2\nvalidation_steps = 8\narchitecture = { width = 8 }\n'
    text = text.replace("updates = 4000\n", short).replace("validate_every = 1000", "validate_every = 2")
    return text.replace('precision = "bfloat16"\n', "")


def test_varied_rounds_continue_a_clean_recursion(tmp_path: Path) -> None:
    """The plan of rema-v1-hard, small: collected, trained on both, and whole."""
    pytest.importorskip("duckdb", reason="conditions need DuckDB, part of the extra `query`")
    networks = [NETWORK.format(primitive=one, task=task) for one, task in (("grasp", "grasp"), ("push", "grasp_push"))]
    (tmp_path / "tiny.toml").write_text(BEFORE + "".join(networks))
    hard = (ROOT / "manifests" / "plans" / "rema-v1-hard.toml").read_text()
    (tmp_path / "hard.toml").write_text(small(hard))
    for name, stages in (("tiny", 3), ("hard", 4)):
        plan = load_recursion(tmp_path / f"{name}.toml")
        made = list(recurse(plan, tmp_path / "out", workers=2))
        assert sum(not stage.already for stage in made) == stages
    release = find_release(tmp_path / "out" / "tiny-hard")
    assert {block.round: release.block(block).version() for block in release.manifest.blocks} == {1: 1, 2: 2, 3: 2}
    assert verify(release).ok
    axes = {row.axis for row in count(release).axes}
    assert len(axes - {""}) > 5
    _, about = load_checkpoint(tmp_path / "out" / "checkpoints" / "tiny-hard" / "robust" / "grasp")
    assert about.release_sha256 == release.manifest.sha256
    episodes = [one for one in load(release.path, cache="memory").iter_episodes(rounds=[2]) if one.variation]
    simulator = Simulator()
    for episode in episodes[:20]:
        step = episode.steps[-1]
        assert np.array_equal(observe(step.situation).scene, step.observation.scene)
        assert np.array_equal(observe(step.situation).depth, step.observation.depth)
        assert simulator.run(step.situation, step.action.index).evidence() == step.outcome.evidence()
    simulator.close()
    assert all(stage.already for stage in recurse(load_recursion(tmp_path / "hard.toml"), tmp_path / "out"))
