"""The training loop: one labelled pixel a sample, resumable at every saved state, to the same weights."""

from __future__ import annotations

import json
import math
import shutil
import time
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from baselines.devices import training_device
from baselines.tae.checkpoint import Checkpoint, save_checkpoint
from baselines.tae.network import TaeNetwork
from baselines.train.config import TrainingConfig
from baselines.train.data import open_data, prepared
from baselines.train.hard import HardFailures
from baselines.train.report import TrainingReport
from baselines.train.result import DIVERGED, DivergedError, Trained, check_network_name, trained
from baselines.train.state import TrainingState, locked, read_state, state_path, write_state
from baselines.train.validation import pixel_logits, validate
from evaluator.run.environment import code_commit, source_digest
from rema_data import interrupts
from rema_data.augment import Augment
from rema_data.loader.release import Release
from rema_data.progress import Progress, Silent
from rema_data.storage import write_atomic
from rema_data.validation import plain

__all__ = ["DivergedError", "Trained", "train", "trained"]

_MOMENTS = ("exp_avg", "exp_avg_sq")
_BETAS = (0.9, 0.95)
"""Of Adam, as AdaGrasp has them."""
_CODE = ("baselines.tae", "baselines.train", "rema_data")
"""The code that decides the weights: other code does not resume a training."""


def train(
    release: Release,
    config: TrainingConfig,
    folder: Path,
    name: str,
    *,
    device: str = "cpu",
    deterministic: bool = False,
    progress: Progress | None = None,
    save_every: int | None = None,
) -> Trained:
    """Train a network, or go on with a training that was interrupted, and write its best checkpoint.

    ``folder`` gets ``NAME.safetensors``, ``NAME.json`` and ``NAME.metrics.jsonl``; meanwhile ``.NAME.training``.
    ``deterministic`` refuses operations whose result may differ between two runs on one device. ``save_every`` is in
    updates; by default a state is saved with every validation.

    Raises the errors of ``open_data``; InputError where another process runs this training, or the device or name
    cannot be used; RunMismatchError where the folder holds another training of the name; StorageError where the disk
    is full; DivergedError where a loss, weight or answer is not finite: the best weights so far are kept in the folder
    ``diverged`` below ``folder``, and the training does not count as done.
    """
    check_network_name(name)
    where = training_device(device)
    done = trained(release, config, folder, name)
    if done is not None:
        return done
    run = _Training(release, config, folder, name, where, progress or Silent())
    before = torch.are_deterministic_algorithms_enabled()
    torch.use_deterministic_algorithms(deterministic)
    try:
        with locked(run.work):
            # By a process that ended while this one opened the data.
            done = trained(release, config, folder, name) or run.go(save_every or config.validate_every)
    finally:
        torch.use_deterministic_algorithms(before)
    shutil.rmtree(run.work, ignore_errors=True)
    return done


class _Training:
    def __init__(
        self,
        release: Release,
        config: TrainingConfig,
        folder: Path,
        name: str,
        device: torch.device,
        progress: Progress,
    ) -> None:
        self.release, self.config, self.folder, self.name = release, config, folder, name
        self.device = device
        self.report = TrainingReport(progress, f"train {folder.name}/{name}", config.updates)
        self.work = state_path(folder, name)
        self.data = open_data(release, config)
        self.hard = HardFailures(self.data.train, config) if config.hard_share else None
        self.augment = Augment(self.data.train, rotate=config.rotate, mirror=config.mirror)
        self.network = TaeNetwork(config.architecture, torch.Generator().manual_seed(config.seed))
        self.network.placed(device).train()
        self.optimiser = torch.optim.Adam(self.network.parameters(), lr=config.learning_rate, betas=_BETAS)
        self.random = torch.Generator().manual_seed(config.seed + 1)
        self.update = 0
        self.losses: list[Tensor] = []  # since the last validation
        self.history: list[dict[str, Any]] = []
        self.best: dict[str, Any] | None = None
        self.best_weights: dict[str, Tensor] = {}
        self.identity = {
            "training": plain(config),
            "release": release.fingerprint,
            "device": device.type,
            "code": {name: source_digest(name) for name in _CODE},
        }
        self.threads = {torch.get_num_threads()}  # equal weights need equal sums, which the threads cut in parts

    def go(self, save_every: int) -> Trained:
        self.resume()
        batches = self.data.batches(None if self.hard is None else self.hard.replaced)
        started, waiting, before = time.perf_counter(), 0.0, self.update
        while self.update < self.config.updates:
            interrupts.check()
            asked = time.perf_counter()
            samples = prepared(next(batches), self.augment, self.random, self.device)
            waiting += time.perf_counter() - asked
            self.losses.append(self.step(samples))
            self.update += 1
            self.report.updated(self.losses[-1], self.config.batch_size)
            last = self.update == self.config.updates
            validating = last or self.update % self.config.validate_every == 0
            if validating or self.update % save_every == 0:
                self.check()
            if validating:
                took = time.perf_counter() - started
                speed = (self.update - before) * self.config.batch_size / took
                self.report.validated(self.validate(), speed, waiting / took)
                started, waiting, before = time.perf_counter(), 0.0, self.update
            if self.hard is not None and self.update % self.config.hard_every == 0 and not last:
                with self.precision():
                    self.hard.look(self.network, self.device)
            if validating or self.update % save_every == 0:
                self.save()
        return Trained(self.folder, self.name, self.save_best(self.folder), already=False)

    def step(self, samples: Any) -> Tensor:
        """One update; the loss, still on the device."""
        for group in self.optimiser.param_groups:
            group["lr"] = self.config.learning_rate * self.rate()
        with self.precision():
            logits = self.network(samples.scene, samples.end_effector)
        pair = pixel_logits(logits, samples.pixel).float()
        loss = torch.nn.functional.cross_entropy(pair, samples.success.long())
        self.optimiser.zero_grad()
        torch.autograd.backward(loss)
        self.optimiser.step()
        return loss.detach()

    def precision(self) -> torch.autocast:
        """In which the layers compute while they learn."""
        return torch.autocast(self.device.type, torch.bfloat16, enabled=self.config.precision == "bfloat16")

    def rate(self) -> float:
        """Share of the learning rate at the present update."""
        if self.config.schedule == "constant":
            return 1.0
        return 0.5 * (1 + math.cos(math.pi * self.update / self.config.updates))

    def check(self) -> None:
        """Raise where a loss or a weight is not finite, before it is saved or validated."""
        wrong = (~torch.isfinite(torch.stack(self.losses))).nonzero()
        if len(wrong):
            update = self.update - len(self.losses) + int(wrong[0]) + 1
            raise self.diverged(f"the loss of update {update} is not a number", update)
        for name, tensor in self.weights().items():
            if not bool(torch.isfinite(tensor).all()):
                raise self.diverged(f"update {self.update} left weights that are not numbers ({name})", self.update)

    def diverged(self, what: str, update: int) -> DivergedError:
        """The end of a training without a network; the best weights so far are kept."""
        kept = "no weights were good enough to keep"
        if self.best is not None:
            place = self.folder / DIVERGED
            self.save_best(place)
            kept = f"the best weights, those after update {self.best['update']}, are kept as {place / self.name}"
        return DivergedError(
            f"{what}; {kept}",
            hint="train with a smaller learning rate, or another seed: choose another --output for it, or delete "
            f"{self.work}",
            update=update,
        )

    def validate(self) -> dict[str, Any]:
        """Measures of the present weights, which may become the best ones."""
        try:
            measures = validate(self.network, self.data.validation, self.device)
        except DivergedError as error:
            raise self.diverged(f"after update {self.update} {error.message}", self.update) from error
        entry = {"update": self.update, "training_loss": float(torch.stack(self.losses).mean()), **measures}
        self.losses = []
        self.history.append(entry)  # without speeds: its file is part of a policy, equal for equal trainings
        if self.best is None or _rank(measures) > _rank(self.best):
            self.best = {"update": self.update, **measures, "threads": sorted(self.threads)}
            self.best_weights = {key: tensor.detach().cpu().clone() for key, tensor in self.weights().items()}
        lines = "".join(json.dumps(row) + "\n" for row in self.history)
        write_atomic(self.folder / f"{self.name}.metrics.jsonl", lines)
        return entry

    def weights(self) -> dict[str, Tensor]:
        return dict(self.network.state_dict())

    def save(self) -> None:
        parameters = dict(self.network.named_parameters())
        moments = {
            f"{key}/{name}": self.optimiser.state[parameter][key]
            for name, parameter in parameters.items()
            for key in _MOMENTS
        }
        tensors = {f"model/{name}": tensor for name, tensor in self.weights().items()} | moments
        tensors |= {f"best/{name}": tensor for name, tensor in self.best_weights.items()}
        tensors |= {"generator": self.random.get_state()}
        facts = {
            "sampler": self.data.sampler.state_dict(),
            "hard": None if self.hard is None else self.hard.state_dict(),
            "losses": torch.stack(self.losses).tolist() if self.losses else [],
            "history": self.history,
            "best": self.best,
            "threads": sorted(self.threads),
        }
        kept = {key: tensor.detach().cpu().contiguous() for key, tensor in tensors.items()}
        write_state(self.work, self.identity, TrainingState(self.update, kept, facts))

    def resume(self) -> None:
        state = read_state(self.work, self.identity)
        if state is None:
            return
        parts: dict[str, dict[str, Tensor]] = {prefix: {} for prefix in ("model", *_MOMENTS, "best")}
        for key, tensor in state.tensors.items():
            prefix, _, name = key.partition("/")
            if name:
                parts[prefix][name] = tensor
        self.network.load_state_dict(parts["model"])
        for name, parameter in self.network.named_parameters():
            moments = {key: parts[key][name].to(parameter.device) for key in _MOMENTS}
            if parameter.ndim == 4:
                moments = {key: value.contiguous(memory_format=torch.channels_last) for key, value in moments.items()}
            self.optimiser.state[parameter] = {"step": torch.tensor(float(state.update)), **moments}
        self.random.set_state(state.tensors["generator"])
        self.data.sampler.load_state_dict(state.facts["sampler"])
        if self.hard is not None:
            self.hard.load_state_dict(state.facts["hard"])
        self.losses = list(torch.tensor(state.facts["losses"], device=self.device))
        self.update, self.history, self.best = state.update, state.facts["history"], state.facts["best"]
        self.best_weights = parts["best"]
        self.threads |= set(state.facts["threads"])
        self.report.resumed(self.update, sorted(self.threads))

    def save_best(self, folder: Path) -> Checkpoint:
        """Write the best weights, with their card."""
        assert self.best is not None
        present = set(self.data.train.table["skill"])
        skills = tuple(name for name in self.config.learned_skills if name in present)
        commit = code_commit()
        about = Checkpoint(
            primitive=self.config.primitive,
            skills=skills,
            architecture=self.config.architecture,
            release=self.release.name,
            release_sha256=self.release.fingerprint,
            training=plain(self.config),
            metrics={key: value for key, value in self.best.items() if key != "update"},
            updates=self.best["update"],
            commit=f"{commit['commit'] or ''}{'+' if commit['dirty'] else ''}",
        )
        return save_checkpoint(folder, self.name, self.best_weights, about)


def _rank(measures: dict[str, Any]) -> tuple[float, float]:
    """The better weights have the higher one: by AUC, which is often 1 more than once, then by loss."""
    return measures["auc"], -measures["loss"]
