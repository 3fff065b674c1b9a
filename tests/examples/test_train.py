"""examples/train.py: it learns, and what cannot be done is a sentence and an exit code, as of `rema`."""

from __future__ import annotations

from pathlib import Path

import pytest
from safetensors.numpy import load_file

from tests.examples.commands import example, python


def test_equal_trainings_write_equal_weights(tmp_path: Path) -> None:
    words = [example("train"), "--release", "rema-sample", "--batches", "4"]
    for name in ("first", "again"):
        done = python(*words, "--output", name, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        assert "grasp, validation: AUC " in done.stdout and "push, validation: AUC " in done.stdout
    assert (tmp_path / "first").read_bytes() == (tmp_path / "again").read_bytes()
    other = python(*words, "--seed", "1", "--output", "other", cwd=tmp_path)
    assert other.returncode == 0, other.stderr
    assert load_file(tmp_path / "other").keys() == load_file(tmp_path / "first").keys()
    assert (tmp_path / "other").read_bytes() != (tmp_path / "first").read_bytes()


@pytest.mark.parametrize(
    ("words", "sentence", "mend"),
    [
        (("--release", "nosuch"), "'nosuch' is neither a published release nor a folder", "published releases: "),
        (("--release", "rema-sample", "--batch-size", "1"), "a batch of 1 cannot hold", "use a batch of 2 or more"),
    ],
)
def test_bad_input_is_a_sentence(words: tuple[str, ...], sentence: str, mend: str, tmp_path: Path) -> None:
    done = python(example("train"), *words, cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith(sentence) and mend in done.stderr and "Traceback" not in done.stderr
