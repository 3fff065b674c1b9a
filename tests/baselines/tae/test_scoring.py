"""Maps of success: quick ways give what the slow way gives, and the policy takes the best valid action."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import torch

from baselines.tae import scoring
from baselines.tae.checkpoint import Checkpoint, save_checkpoint
from baselines.tae.network import Architecture, TaeNetwork
from baselines.tae.rotation import turn_end_effector
from baselines.tae.scoring import Scorer
from baselines.tae_policy import TaePolicy
from evaluator.policy import ObservationBatch
from evaluator.sim.observation import observe
from evaluator.sim.reach import valid_actions
from rema_data.errors import InputError
from rema_data.grid import decode
from rema_data.schema import Situation
from tests.evaluator.sim.test_cameras import SITUATIONS

SMALL = Architecture(width=8)


def settled(seed: int = 0) -> TaeNetwork:
    """A network whose batch normalisations are not the identity."""
    network = TaeNetwork(SMALL, torch.Generator().manual_seed(seed)).train()
    with torch.no_grad():
        for _ in range(3):
            network(torch.rand(4, 1, 64, 64) * 0.05, torch.rand(4, 4, 112, 112))
    return network.eval()


def question(*situations: Situation) -> ObservationBatch:
    seen = [observe(situation) for situation in situations]
    first = situations[0]
    valid = valid_actions(first.task, first.step)
    return ObservationBatch(
        np.stack([one.scene_m() for one in seen]),
        np.stack([one.end_effector() for one in seen]),
        first.kind.primitive.value,
        first.kind.embodiment.value,
        first.task,
        first.step,
        np.broadcast_to(valid, (len(seen), *valid.shape)),
    )


@torch.no_grad()
def plain_log_odds(network: TaeNetwork, batch: ObservationBatch, angles: int) -> np.ndarray:
    """All angles of all observations one by one, without any sharing."""
    out = np.empty((len(batch), 64, 64, angles), np.float32)
    for n in range(len(batch)):
        hand = torch.from_numpy(np.moveaxis(batch.end_effector[n], -1, 0).copy())[None]
        for k in range(angles):
            logits = network(torch.from_numpy(batch.scene[n])[None, None], turn_end_effector(hand, torch.tensor([k])))
            out[n, ..., k] = (logits[0, 1] - logits[0, 0]).numpy()
    return out


@pytest.mark.parametrize("name", ["gripper_grasp", "tool"])
def test_shared_features_and_kept_kernels_change_nothing(name: str) -> None:
    network, batch = settled(), question(SITUATIONS[name], SITUATIONS[name])
    scorer = Scorer(network)
    first, again = (scorer.log_odds(batch.scene, batch.end_effector, 16) for _ in range(2))
    assert np.array_equal(first, again)
    np.testing.assert_allclose(first, plain_log_odds(network, batch, 16), atol=1e-4)


def test_scenes_and_hands_are_encoded_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bare hands and a tool in one batch, twice: every scene once each time, every hand once in all."""
    bare, tool = question(SITUATIONS["gripper_grasp"]), question(SITUATIONS["tool"])
    scene = np.concatenate([bare.scene, tool.scene, bare.scene])
    hands = np.concatenate([bare.end_effector, tool.end_effector, bare.end_effector])
    network = settled()
    scorer, alone = Scorer(network), Scorer(network)
    encoded = {"scene": 0, "hand": 0}

    def counted(name: str, real: Callable[[torch.Tensor], torch.Tensor]) -> Callable[[torch.Tensor], torch.Tensor]:

        def call(given: torch.Tensor) -> torch.Tensor:
            encoded[name] += len(given)
            return real(given)

        return call

    exact = scorer._exact
    monkeypatch.setattr(exact._network, "encode_scene", counted("scene", exact._network.encode_scene))
    monkeypatch.setattr(exact, "_encode", counted("hand", exact._encode))
    found = [scorer.log_odds(scene, hands, 16) for _ in range(2)]
    assert encoded == {"scene": 2 * 3, "hand": 8 + 16}  # a bare hand has half of the angles
    one_by_one = np.concatenate([alone.log_odds(scene[n : n + 1], hands[n : n + 1], 16) for n in range(3)])
    for maps in found:
        np.testing.assert_allclose(maps, one_by_one, atol=1e-5)


def looking_first(network: TaeNetwork, monkeypatch: pytest.MonkeyPatch) -> Scorer:
    """A scorer that looks in bfloat16 first, whatever the processor."""
    monkeypatch.setattr(scoring, "multiplies_bfloat16", lambda: True)
    return Scorer(network)


@pytest.mark.parametrize("name", sorted(SITUATIONS))
def test_a_first_look_leaves_the_best_action_and_its_score(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    batch = question(SITUATIONS[name])
    angles = 8 if not batch.valid[..., 8:].any() else 16
    for seed in range(3):
        scorer = looking_first(settled(seed), monkeypatch)
        whole = scorer.log_odds(batch.scene, batch.end_effector, angles)
        looked = scorer.log_odds(batch.scene, batch.end_effector, angles, batch.valid)
        left_out = np.isneginf(looked)
        np.testing.assert_allclose(looked[~left_out], whole[~left_out], atol=1e-5)
        valid = batch.valid[..., :angles]
        assert np.where(valid, looked, -np.inf).argmax() == np.where(valid, whole, -np.inf).argmax()


def test_a_first_look_does_not_decide_what_bfloat16_cannot_tell_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of angles whose best scores are this near, all are scored in float32."""
    batch = question(SITUATIONS["tool"])
    scorer = looking_first(settled(), monkeypatch)
    asked: list[list[int]] = []
    rough = np.full((16, 64, 64), -9.0, np.float32)
    rough[3, 30, 30], rough[9, 20, 20], rough[12, 40, 40] = 8.0, 7.7, 7.5  # the margin is 0.25 + 8 / 64
    rough[5, 0, 0] = 99.0  # not a valid place
    assert scorer._rough is not None
    real = scorer._exact.log_odds
    monkeypatch.setattr(scorer._rough, "log_odds", lambda *_: rough)
    monkeypatch.setattr(scorer._exact, "log_odds", lambda *given: (asked.append(given[2].tolist()), real(*given))[1])
    scorer.log_odds(batch.scene, batch.end_effector, 16, batch.valid)
    assert asked == [[3, 9]]


def test_what_was_asked_before_changes_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Kernels of a hand that are computed at different times, in different company, are the same."""
    batch, other = question(SITUATIONS["gripper_push"]), question(SITUATIONS["tool"])
    network = settled()
    fresh, used = (looking_first(network, monkeypatch) for _ in range(2))
    for angles in ([5], [1, 5, 2]):
        used._exact.log_odds(other.scene[0], batch.end_effector[0], np.array(angles))
    answers = [one.log_odds(batch.scene, batch.end_effector, 16, batch.valid) for one in (fresh, used)]
    assert np.array_equal(*answers)


def compare_openvino(joint: Path) -> None:
    ours, theirs = TaePolicy(joint), TaePolicy(joint, "openvino")
    for situation in SITUATIONS.values():
        batch = question(situation)
        np.testing.assert_allclose(ours.maps(batch), theirs.maps(batch), atol=2e-5)
        assert np.array_equal(ours.act(batch), theirs.act(batch))


@pytest.mark.skipif(find_spec("openvino") is None, reason="OpenVINO is not installed")
def test_openvino_scores_the_same_and_decides_the_same(joint: Path) -> None:
    # In a process of its own, as a policy has: one that has run OpenVINO may crash when it starts others later.
    code = f"from tests.baselines.tae.test_scoring import *; compare_openvino(Path({str(joint)!r}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_openvino_that_is_missing_is_named(joint: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "openvino", None)
    with pytest.raises(InputError, match="OpenVINO is not installed") as caught:
        TaePolicy(joint, "openvino")
    assert caught.value.hint == 'pip install "rema[openvino]"'


def write_policy(folder: Path, *networks: tuple[str, str, tuple[str, ...], int]) -> Path:
    for name, primitive, skills, seed in networks:
        about = Checkpoint(primitive, skills, SMALL, "tiny", "0" * 64)
        save_checkpoint(folder, name, settled(seed).state_dict(), about)
    return folder


@pytest.fixture
def joint(tmp_path: Path) -> Path:
    return write_policy(
        tmp_path, ("grasp", "grasp", ("grasp", "grasp_grasp"), 0), ("push", "push", ("push", "grasp_push"), 1)
    )


@pytest.mark.parametrize("name", SITUATIONS)
def test_the_best_valid_action_is_taken(joint: Path, name: str) -> None:
    policy, batch = TaePolicy(joint), question(SITUATIONS[name])
    (action,) = policy.act(batch)
    i, j, k = decode(int(action))
    assert batch.valid[0, i, j, k]
    maps = policy.maps(batch)
    assert maps.shape[-1] == (8 if name in ("sticks", "pinched") else 16)
    assert maps[0, i, j, k] >= maps[0][batch.valid[0][..., : maps.shape[-1]]].max() - 1e-4


def test_ties_go_to_the_lowest_index(joint: Path) -> None:
    policy, batch = TaePolicy(joint), question(SITUATIONS["gripper_grasp"])
    policy._log_odds = lambda observations, best=False: np.full((1, 64, 64, 16), 0.5, np.float32)  # type: ignore[method-assign]
    assert policy.act(batch)[0] == np.flatnonzero(batch.valid[0].reshape(-1))[0]


def test_rounding_does_not_decide_between_equal_scores(joint: Path) -> None:
    policy, batch = TaePolicy(joint), question(SITUATIONS["gripper_grasp"])
    first, other = np.flatnonzero(batch.valid[0].reshape(-1))[[100, 200]]
    scores = np.zeros((1, 64, 64, 16), np.float32)
    scores.reshape(-1)[[first, other]] = 5.0, 5.00001
    policy._log_odds = lambda observations, best=False: scores  # type: ignore[method-assign]
    assert policy.act(batch)[0] == first
    scores.reshape(-1)[other] = 5.001
    assert policy.act(batch)[0] == other


def test_a_sure_network_still_prefers_one_action(joint: Path) -> None:
    policy, batch = TaePolicy(joint), question(SITUATIONS["gripper_grasp"])
    first, other = np.flatnonzero(batch.valid[0].reshape(-1))[[100, 200]]
    scores = np.zeros((1, 64, 64, 16), np.float32)
    scores.reshape(-1)[[first, other]] = 40.0, 41.0  # both are probabilities of 1 in float32
    policy._log_odds = lambda observations, best=False: scores  # type: ignore[method-assign]
    assert policy.act(batch)[0] == other


def test_every_skill_has_its_network(tmp_path: Path) -> None:
    separate = write_policy(
        tmp_path / "separate",
        *((name, name.split("_")[-1], (name,), seed) for seed, name in enumerate(("grasp", "grasp_grasp", "push"))),
    )
    policy, alone = (
        TaePolicy(separate),
        {name: TaePolicy(separate / f"{name}.safetensors") for name in ("grasp", "push")},
    )
    for name, network in (("gripper_grasp", "grasp"), ("gripper_push", "push"), ("tool", "push")):
        batch = question(SITUATIONS[name])  # no network was trained for a held tool: the one of its primitive answers
        assert np.array_equal(policy.maps(batch), alone[network].maps(batch))
    batch = question(SITUATIONS["sticks"])
    assert not np.array_equal(policy.maps(batch), alone["grasp"].maps(batch))


def test_a_policy_without_a_network_for_it(joint: Path) -> None:
    (joint / "push.safetensors").unlink()
    with pytest.raises(InputError, match="no network for push"):
        TaePolicy(joint).act(question(SITUATIONS["gripper_push"]))
    with pytest.raises(InputError, match="needs its networks"):
        TaePolicy(None)
