"""Policies that answer, and cheat by what they remember, by the order of the questions, or by when they fail."""

from __future__ import annotations

import contextlib
import hashlib
import os
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from tests.evaluator.policy.hostile.base import Hostile, Tries, answer


class Answers(Hostile):
    """Gives other answers to the same question: an audit counts them."""

    ends = "differ"

    def tries(self) -> Tries:
        return ()


class Dawdles(Answers):
    """Takes almost as long as it may, every time."""

    ends = "fault"

    def act(self, observations: Any) -> np.ndarray:
        time.sleep(0.4)
        return answer(len(observations))


class Remembers(Answers):
    """Keeps what it saw, in memory and on disk, and answers how often it was asked before."""

    asked = 0

    def act(self, observations: Any) -> np.ndarray:
        notes = Path(tempfile.gettempdir(), "notes")
        before = max(Remembers.asked, len(notes.read_text()) if notes.exists() else 0)
        Remembers.asked = before + 1
        notes.write_text("x" * Remembers.asked)
        if (observations.scene < 0).any():
            os._exit(1)
        return answer(len(observations), before)


class CountsQuestions(Answers):
    """Looks at nothing: its action says which observation of its process this is, as if that were the scenario."""

    def __init__(self, checkpoint: Path | None, device: str) -> None:
        super().__init__(checkpoint, device)
        self.seen = 0

    def act(self, observations: Any) -> np.ndarray:
        numbers = self.seen + np.arange(len(observations))
        self.seen += len(observations)
        return table_of_actions(numbers)


class RemembersObservations(Answers):
    """Answers by all that its process was shown so far, the observation itself included."""

    def __init__(self, checkpoint: Path | None, device: str) -> None:
        super().__init__(checkpoint, device)
        self.memory = hashlib.sha256()

    def act(self, observations: Any) -> np.ndarray:
        numbers = []
        for scene in observations.scene:
            self.memory.update(np.ascontiguousarray(scene).tobytes())
            numbers.append(int.from_bytes(self.memory.digest()[:4], "big"))
        return table_of_actions(np.array(numbers))


def table_of_actions(numbers: np.ndarray) -> np.ndarray:
    """A valid action for every number, another one for each of 0 to 10,239."""
    return np.stack([20 + numbers // 16 % 20, 16 + numbers // 320 % 32, numbers % 16], axis=1)


class FlipsPrivilege(Answers):
    """Asks for the ground truth from its second process on, and dies whenever it is asked without."""

    ends = "fault"
    privileged = False

    def __init__(self, checkpoint: Path | None, device: str) -> None:
        super().__init__(checkpoint, device)
        notes = Path(checkpoint.read_text() if checkpoint else "")
        FlipsPrivilege.privileged = notes.is_file()
        with contextlib.suppress(OSError):  # in the sandbox it would have to guess, by the clock for instance
            notes.write_text("started before")

    def act(self, observations: Any, situations: Any = ()) -> np.ndarray:
        if not situations:
            os._exit(1)
        return answer(len(observations), 15)


class Erratic(Answers):
    """Fails in another way on every eighth scene or so, and always in the same way on the same scene."""

    ends = "fault"

    def act(self, observations: Any) -> np.ndarray:
        found = answer(len(observations)).astype(float)
        for n, scene in enumerate(observations.scene):
            number = round(float(scene.sum()) * 1e4)
            if number % 61 == 0:
                os._exit(9)
            if number % 61 == 1:
                raise RuntimeError("no idea")
            if number % 61 == 2:
                subprocess.Popen(["sleep", "60"])
            if number % 61 == 3:
                found[n] = np.nan
        return found if np.isnan(found).any() else found.astype(int)


class AnswersByTime(Answers):
    """Takes its answer from a clock."""

    def act(self, observations: Any) -> np.ndarray:
        time.sleep(0.002)
        return table_of_actions(np.full(len(observations), time.monotonic_ns() // 1_000_000 % 10_000))


class AnswersByProcess(Answers):
    """Takes its answer from the number of its process."""

    def act(self, observations: Any) -> np.ndarray:
        return table_of_actions(np.full(len(observations), os.getpid() % 10_000))
