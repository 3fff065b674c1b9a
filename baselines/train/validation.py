"""Measures of a network on steps that it was not trained on."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from scipy.stats import mannwhitneyu
from torch import Tensor

from baselines.tae.network import TaeNetwork
from baselines.train.data import prepared
from baselines.train.result import DivergedError
from rema_data.interrupts import check
from rema_data.loader.batch import StepBatch
from rema_data.loader.dataset import StepDataset

__all__ = ["log_odds", "pixel_logits", "score", "validate"]

_BATCH = 32
_BINS = 10


def pixel_logits(logits: Tensor, pixel: Tensor) -> Tensor:
    """Logits (N, 2) of failure and success at one place of every map; the others get no gradient."""
    return logits.flatten(2).gather(2, pixel[:, None, None].expand(-1, 2, 1))[..., 0]


def validate(network: TaeNetwork, data: StepDataset, device: torch.device) -> dict[str, Any]:
    """Measures of a network on a dataset, in evaluation mode; its mode is left as it was.

    ``auc`` and ``balanced_accuracy`` are means over the skills with both labels, or over all where there are none (an
    AUC is then 0.5 without both labels); ``calibration_error`` and ``loss`` give both labels equal weight over all
    steps; ``skills`` has the first two and the counts for each. Raises DivergedError where an answer is not finite.
    """
    answers = log_odds(network, data, device)
    wrong = int((~np.isfinite(answers)).sum())
    if wrong:
        raise DivergedError(f"the answers to {wrong} of {len(answers)} validation steps are not numbers")
    return score(answers, data.rows.success, data.table["skill"].astype(str).to_numpy())


@torch.inference_mode()
def log_odds(network: TaeNetwork, data: StepDataset, device: torch.device) -> npt.NDArray[np.float64]:
    """Log odds of success at the recorded action of every step, float64 (N,), in evaluation mode; its mode is kept."""
    was_training = network.training
    network.eval()
    unused = torch.Generator()
    scores = []
    for start in range(0, len(data), _BATCH):
        check()
        batch = data[start : start + _BATCH]
        assert isinstance(batch, StepBatch)
        samples = prepared(batch, None, unused, device)
        pair = pixel_logits(network(samples.scene, samples.end_effector), samples.pixel).float()
        scores.append((pair[:, 1] - pair[:, 0]).cpu())
    network.train(was_training)
    answers: npt.NDArray[np.float64] = torch.cat(scores).double().numpy()
    return answers


def score(logit: npt.NDArray[np.float64], success: npt.NDArray[np.bool_], skills: npt.NDArray[Any]) -> dict[str, Any]:
    """The measures of ``validate``, from the log-odds of success of every step."""
    by_skill = {}
    for name in sorted(set(skills.tolist())):
        won, lost = logit[(skills == name) & success], logit[(skills == name) & ~success]
        by_skill[name] = {
            "successes": len(won),
            "failures": len(lost),
            "auc": _auc(won, lost),
            "balanced_accuracy": (_share(won > 0) + _share(lost <= 0)) / 2,
        }
    telling = [entry for entry in by_skill.values() if entry["successes"] and entry["failures"]] or [*by_skill.values()]
    means = {key: float(np.mean([entry[key] for entry in telling])) for key in ("auc", "balanced_accuracy")}
    weight = np.where(success, 0.5 / max(1, success.sum()), 0.5 / max(1, (~success).sum()))
    weight /= weight.sum()
    chance = 1 / (1 + np.exp(-np.clip(logit, -50, 50)))
    losses = np.logaddexp(0.0, np.where(success, -logit, logit))
    return {
        **means,
        "calibration_error": _calibration_error(chance, success, weight),
        "loss": float(np.sum(losses * weight)),
        "steps": len(logit),
        "skills": by_skill,
    }


def _share(flags: npt.NDArray[np.bool_]) -> float:
    return float(flags.mean()) if len(flags) else 0.5


def _auc(won: npt.NDArray[np.float64], lost: npt.NDArray[np.float64]) -> float:
    """Probability that a success scores higher than a failure."""
    if not len(won) or not len(lost):
        return 0.5
    return float(mannwhitneyu(won, lost).statistic / (len(won) * len(lost)))


def _calibration_error(
    chance: npt.NDArray[np.float64], success: npt.NDArray[np.bool_], weight: npt.NDArray[np.float64]
) -> float:
    """Expected difference between what was predicted and what came, over ten equal bins."""
    which = np.minimum((chance * _BINS).astype(int), _BINS - 1)
    gaps = np.bincount(which, weight * (chance - success), _BINS)
    return float(np.abs(gaps).sum())
