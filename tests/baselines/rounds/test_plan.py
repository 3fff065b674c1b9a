"""Plans: what they mean, and what is said about those that mean nothing."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from baselines.rounds.plan import load_plan
from evaluator.policy import NamedPolicy
from evaluator.policy.loading import PolicySpec
from evaluator.scenarios.varied import Vary
from rema_data.errors import InputError, MissingFileError, RemaError
from rema_data.store.block import BlockKey
from tests.baselines.rounds.fakes import PLAN, write_plan

ROOT = Path(__file__).parents[3]


def test_a_plan_is_a_list_of_blocks(tmp_path: Path) -> None:
    plan = load_plan(write_plan(tmp_path))
    assert [(block.key.path, block.episodes) for block in plan.blocks] == [
        ("round-1/grasp/train", 12),
        ("round-1/grasp/val", 3),
        ("round-2/grasp_grasp_push/train", 11),
    ]
    names = [tuple(use.spec.name for use in block.policies) for block in plan.blocks]
    assert names[0] == ("random",)
    assert names[2] == ("reference", "reference", "reference", "scripted")
    assert (plan.about.name, plan.seed, plan.parent, plan.reused) == ("tiny", 7, None, ())


def test_a_task_can_have_its_own_values(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("")
    (tmp_path / "weights").write_bytes(b"1")
    tasks = """
    [rounds.tasks]
    grasp = { policy = { code = "mine.py:Mine", checkpoint = "weights", device = "cuda:0" } }
    push = { episodes = { val = 2 } }
    """
    head, _, _ = PLAN.rpartition("[[rounds]]")
    plan = load_plan(write_plan(tmp_path, head.replace('tasks = ["grasp"]', tasks)))
    counts = {block.key: block.episodes for block in plan.blocks}
    assert counts == {
        BlockKey(1, "grasp", "train"): 12,
        BlockKey(1, "grasp", "val"): 3,
        BlockKey(1, "push", "val"): 2,
    }
    (mine,) = plan.blocks[0].policies
    assert (mine.spec.path, mine.spec.class_name) == ((tmp_path / "mine.py").resolve(), "Mine")
    assert (mine.checkpoint, mine.device) == ((tmp_path / "weights").resolve(), "cuda:0")
    assert plan.blocks[-1].policies[0].spec.name == "random"


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ('name = "tiny"', 'name = "../tiny"', "name"),
        ('title = "Tiny"', "", "title"),
        ('license = "CC-BY-4.0"', 'license = ""', "license"),
        ('license = "CC-BY-4.0"', 'license = "do what you like"', "license"),
        ('license = "CC-BY-4.0"', 'license = "CC-BY"', "license"),
        ("seed = 7", "seed = -1", "seed"),
        ("seed = 7", "seed = true", "seed"),
        ("seed = 7", 'seed = 7\nsources = "http://here"', "sources"),
        ("seed = 7", "seed = 7\ncolour = 1", "colour"),
        ('policy = "random"', "", "rounds[1].tasks.grasp.policy"),
        ('policy = "random"', 'policy = "rnadom"', "rounds[1].tasks.grasp.policy"),
        ('policy = "random"', "policy = 3", "rounds[1].tasks.grasp.policy"),
        ('policy = "random"', 'policy = { code = "random", weights = "w" }', "rounds[1].tasks.grasp.policy.weights"),
        ('policy = "random"', 'policy = "gone.py"', "rounds[1].tasks.grasp.policy"),
        ('policy = "random"', 'policy = "tae"', "rounds[1].tasks.grasp.policy"),
        ('policy = "random"', 'policy = { code = "random", checkpoint = "gone" }', "rounds[1].tasks.grasp.policy"),
        ('picks = "reference"', "", "rounds[2].tasks.grasp_grasp_push.picks"),
        ("episodes = { train = 12, val = 3 }", "", "rounds[1].tasks.grasp.episodes"),
        ("{ train = 12, val = 3 }", "{}", "rounds[1].tasks.grasp.episodes"),
        ("{ train = 12, val = 3 }", "{ train = 0 }", "rounds[1].tasks.grasp.episodes.train"),
        ("{ train = 12, val = 3 }", "{ train = 2.5 }", "rounds[1].tasks.grasp.episodes.train"),
        ("{ train = 12, val = 3 }", "{ test = 4 }", "rounds[1].tasks.grasp.episodes.test"),
        ('["grasp"]', '["grasp", "throw"]', "rounds[1].tasks"),
        ('["grasp"]', '["grasp", "grasp"]', "rounds[1].tasks"),
        ('["grasp"]', "[]", "rounds[1].tasks"),
        ('["grasp"]', "{ grasp = 3 }", "rounds[1].tasks"),
        ('["grasp"]', '["grasp"]\nspeed = 2', "rounds[1].speed"),
        ('tasks = ["grasp_grasp_push"]', "", "rounds[2].tasks"),
        ('policy = "scripted"', "reuse = true", "rounds[2].picks"),
        ('policy = "random"', 'policy = "random"\nvary = []', "rounds[1].tasks.grasp.vary.axes"),
        ('policy = "random"', 'policy = "random"\nvary = ["weather"]', "rounds[1].tasks.grasp.vary.axes"),
        ('policy = "random"', 'policy = "random"\nvary = ["act", "act"]', "rounds[1].tasks.grasp.vary.axes"),
        ('policy = "random"', 'policy = "random"\nvary = "act"', "rounds[1].tasks.grasp.vary"),
        ('policy = "random"', 'policy = "random"\nvary = { clean = 0.5 }', "rounds[1].tasks.grasp.vary.axes"),
        (
            'policy = "random"',
            'policy = "random"\nvary = { axes = ["act"], clean = 1 }',
            "rounds[1].tasks.grasp.vary.clean",
        ),
        ('policy = "random"', 'policy = "random"\nvary = ["act", "tool"]', "rounds[1].vary"),
    ],
)
def test_errors_name_the_field(tmp_path: Path, old: str, new: str, key: str) -> None:
    path = write_plan(tmp_path, **{old: new + "\n"})
    with pytest.raises((InputError, MissingFileError)) as caught:
        load_plan(path)
    assert caught.value.facts["field"] == key
    assert str(path) in caught.value.message and key in caught.value.message
    assert caught.value.hint


def test_a_round_may_vary_its_episodes(tmp_path: Path) -> None:
    """Each task by the axes that it has; half of the episodes are clean unless the plan says otherwise."""
    tasks = """
    vary = ["clutter", "sense", "tool"]
    [rounds.tasks]
    grasp = {}
    push = { vary = { axes = ["act"], clean = 0.25 } }
    grasp_push = { picks = "reference" }
    """
    head, _, _ = PLAN.rpartition("[[rounds]]")
    plan = load_plan(write_plan(tmp_path, head.replace('tasks = ["grasp"]', tasks)))
    assert {block.key.task: block.vary for block in plan.blocks} == {
        "grasp": Vary(("clutter", "sense"), 0.5),
        "push": Vary(("act",), 0.25),
        "grasp_push": Vary(("sense", "tool"), 0.5),
    }
    assert [block.vary for block in load_plan(write_plan(tmp_path)).blocks] == [None] * 3
    own = head.replace('tasks = ["grasp"]', 'vary = ["clutter"]\ntasks = ["grasp", "push"]')
    assert [block.vary for block in load_plan(write_plan(tmp_path, own)).blocks][2:] == [None] * 2


def test_an_axis_that_no_task_of_the_round_has_is_named(tmp_path: Path) -> None:
    vary = 'policy = "random"\nvary = ["act", "tool"]'
    with pytest.raises(InputError, match=r"rounds\[1\].vary has the axis 'tool', which grasp does not have") as caught:
        load_plan(write_plan(tmp_path, **{'policy = "random"': vary}))
    assert "grasp_push" in caught.value.hint
    with pytest.raises(InputError, match="has the axis 'weather': use some of clutter, shape"):
        load_plan(write_plan(tmp_path, **{'policy = "random"': 'policy = "random"\nvary = ["weather"]'}))


def test_reuse_needs_a_parent_and_something_to_collect(tmp_path: Path) -> None:
    head = PLAN[: PLAN.index("[[rounds]]")]
    with pytest.raises(InputError, match=r"rounds\[1\].reuse has no parent"):
        load_plan(write_plan(tmp_path, head + "[[rounds]]\nreuse = true\n"))
    with pytest.raises(InputError, match="rounds collect nothing"):
        load_plan(write_plan(tmp_path, 'parent = "older"\n' + head + "[[rounds]]\nreuse = true\n"))
    with pytest.raises(InputError, match=r"rounds\[1\].reuse is 1"):
        load_plan(write_plan(tmp_path, 'parent = "older"\n' + head + "[[rounds]]\nreuse = 1\n"))


def test_a_file_that_is_not_a_plan(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match="no plan"):
        load_plan(tmp_path / "gone.toml")
    with pytest.raises(InputError, match="is a folder"):
        load_plan(tmp_path)
    for content in (b"name = ", b"\xff\xfe\x00", b"[[rounds]\n"):
        (tmp_path / "bad.toml").write_bytes(content)
        with pytest.raises(InputError, match="is not TOML"):
            load_plan(tmp_path / "bad.toml")


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, len(PLAN)), st.integers(0, 30), st.text(alphabet='[]{}="\n a1.,', max_size=8))
def test_every_edit_of_a_plan_raises_only_our_errors(tmp_path: Path, at: int, cut: int, text: str) -> None:
    (tmp_path / "edited.toml").write_text(PLAN[:at] + text + PLAN[at + cut :])
    with suppress(RemaError):
        plan = load_plan(tmp_path / "edited.toml")
        assert plan.blocks and all(block.episodes > 0 for block in plan.blocks)


@pytest.mark.parametrize(
    "name", ["examples/collect_plan.toml", "manifests/plans/rema-mini.toml", "manifests/plans/rema-sample.toml"]
)
def test_the_plans_that_come_with_rema(name: str) -> None:
    plan = load_plan(ROOT / name)
    assert plan.about.license == "CC-BY-4.0"
    assert len({block.key for block in plan.blocks}) == len(plan.blocks)
    assert "\n" not in plan.about.description


def test_a_named_policy_plays_with_the_weights_of_its_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    weights = tmp_path / "weights.bin"
    weights.write_bytes(b"1")
    file = tmp_path / "policy.py"
    file.write_text("class Policy:\n    pass\n")
    named = NamedPolicy(file, "Policy", "learned", "Carries its weights.", checkpoint=weights)
    monkeypatch.setattr("baselines.rounds.plan.resolve", lambda name: PolicySpec("carrier", file, "Policy", named))
    assert {use.checkpoint for block in load_plan(write_plan(tmp_path)).blocks for use in block.policies} == {weights}
