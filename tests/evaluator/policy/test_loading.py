"""References and digests."""

from __future__ import annotations

import contextlib
import dataclasses
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from evaluator.policy import NamedPolicy, PolicyHost, digest, policy_names, resolve
from evaluator.policy.sandbox.snapshot import own_modules
from rema_data.errors import InputError, MissingFileError, SubmissionError

from .batches import make_batch
from .conftest import WritePolicy
from .test_host_answers import LIMITS


def test_a_file_a_class_and_a_built_in(tmp_path: Path) -> None:
    path = tmp_path / "my_policy.py"
    path.write_text("class Policy: ...\n")
    assert (resolve(str(path)).name, resolve(str(path)).class_name) == ("my_policy", "Policy")
    other = resolve(f"{path}:Other")
    assert (other.name, other.class_name, other.path) == ("my_policy-Other", "Other", path.resolve())
    for name in policy_names():
        assert resolve(name).path.is_file()
    (tmp_path / "random.py").write_text("")
    assert resolve(str(tmp_path / "random.py")).name == "random.py"
    for file, reference in (("tae-joint.py", "tae-joint.py"), ("tae.py", "tae.py:joint")):
        (tmp_path / file).write_text("")
        assert ".py" in resolve(str(tmp_path / reference)).name


def test_the_suffix_is_suggested(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text("")
    with pytest.raises(InputError, match=r"write mine\.py"):
        resolve("mine")


def test_named_policies_are_found_without_importing_their_code() -> None:
    code = (
        "import sys; from evaluator.policy import resolve; resolve('tae')\n"
        "sys.exit(bool({'torch', 'scipy', 'baselines.tae_policy'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_the_digest_covers_code_class_and_weights(tmp_path: Path) -> None:
    path, weights = tmp_path / "my_policy.py", tmp_path / "weights"
    path.write_text("class Policy: ...\n")
    weights.write_bytes(b"1")
    seen = {
        digest(resolve(str(path)), None),
        digest(resolve(f"{path}:Other"), None),
        digest(resolve(str(path)), weights),
    }
    weights.write_bytes(b"2")
    seen.add(digest(resolve(str(path)), weights))
    path.write_text("class Policy: pass\n")
    seen.add(digest(resolve(str(path)), weights))
    assert len(seen) == 5
    assert digest(resolve(str(path)), weights) == digest(resolve(str(path)), weights)
    with pytest.raises(MissingFileError):
        digest(resolve(str(path)), tmp_path / "none")


def test_modules_beside_the_policy_can_be_imported(write_policy: WritePolicy, tmp_path: Path) -> None:
    (tmp_path / "my_helper.py").write_text("ANGLE = 5\n")
    with PolicyHost(write_policy("good[:, 2] = my_helper.ANGLE\nreturn good", top="import my_helper"), None) as host:
        answers = host.act(make_batch(2))
    assert all(isinstance(answer, int) and answer % 16 == 5 for answer in answers)


def test_the_digest_of_a_learned_baseline_covers_its_network() -> None:
    names = {path.name for path in own_modules(resolve("tae").path)}
    assert {"network.py", "scoring.py", "correlation.py"} <= names
    assert "schema.py" not in names


def test_an_installed_policy_has_the_digest_of_the_checkout(tmp_path: Path) -> None:
    """Torch and others lie beside it there, and are not its code."""
    spec = resolve("tae")
    shutil.copytree(spec.path.parent, tmp_path / "baselines", ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "rema-0.dist-info").mkdir()
    (tmp_path / "torch").mkdir()
    (tmp_path / "torch" / "__init__.py").write_text("")
    (tmp_path / "numpy.py").write_text("")
    installed = dataclasses.replace(spec, path=tmp_path / "baselines" / spec.path.name)
    assert {path.relative_to(tmp_path).parts[0] for path in own_modules(installed.path)} == {"baselines"}
    assert digest(installed, None) == digest(spec, None)


@pytest.mark.parametrize("deep", ["(" * 100_000, "-" * 100_000 + "1", "[" * 50_000 + "]" * 50_000])
def test_an_expression_that_no_parser_survives(deep: str, tmp_path: Path) -> None:
    """It is parsed by other processes alone, whose end is an error that says what is wrong."""
    path = tmp_path / "deep.py"
    path.write_text(f"x = {deep}\nclass Policy: ...\n")
    spec = resolve(str(path))
    assert digest(spec, None) == digest(spec, None)
    with pytest.raises(SubmissionError, match="cannot be used"), PolicyHost(spec, None, "cpu", LIMITS):
        pass
    named = NamedPolicy(path, "Policy", "learned", "Deep.")
    with contextlib.suppress(InputError):  # what the parser does depends on its version
        digest(dataclasses.replace(spec, named=named), None)


def test_a_name_that_no_table_shows(tmp_path: Path) -> None:
    path = tmp_path / f"{'long' * 12}.py"
    path.write_text("")
    assert resolve(str(path)).name == "long" * 12
    with pytest.raises(InputError, match="more than 80") as caught:
        resolve(f"{path}:{'Class' * 8}")
    assert "shorter name" in caught.value.hint
