"""What runs is a private copy, and the digest is that of the copy."""

from __future__ import annotations

import dataclasses
import json
import os
import socket
from collections.abc import Callable
from pathlib import Path

import pytest

from evaluator.policy import PolicyHost, PolicySpec, digest, resolve
from evaluator.policy.sandbox import snapshot, sources
from evaluator.policy.sandbox.private_copy import held
from evaluator.policy.sandbox.snapshot import take_snapshot
from evaluator.policy.sandbox.sources import checkpoint_sources, code_sources
from rema_data.errors import InputError, MissingFileError, RunMismatchError, StorageError
from tests.evaluator.fakes import fake_backend, fake_config
from tests.evaluator.policy.batches import make_batch
from tests.evaluator.policy.conftest import WritePolicy
from tests.evaluator.policy.test_allowlist import filled
from tests.evaluator.policy.test_host_answers import LIMITS, reasons

CODE = """class Policy:
    def __init__(self, checkpoint, device): ...
    def act(self, observations): return [[30, 31, 2]] * len(observations)
"""


@pytest.fixture
def spec(tmp_path: Path) -> PolicySpec:
    """A policy in a folder of its own, with a module and data beside it."""
    filled(tmp_path / "mine", {("parts", "head.py"), ("data", "table.npz"), ("policy.py",)})
    (tmp_path / "mine" / "policy.py").write_text(CODE)
    return resolve(str(tmp_path / "mine" / "policy.py"))


@pytest.mark.parametrize("name", ["policy.py", "parts/head.py", "data/table.npz", "new.txt", "parts/new/deep.bin"])
def test_the_digest_covers_every_file_that_can_be_read(name: str, spec: PolicySpec) -> None:
    before = digest(spec, None)
    path = spec.path.parent / name
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a") as file:
        file.write("# changed\n")
    assert digest(spec, None) != before


def test_the_digest_says_which_file_and_which_class(spec: PolicySpec) -> None:
    (spec.path.parent / "other.py").write_text(CODE)
    found = {digest(resolve(str(spec.path)), None), digest(resolve(f"{spec.path}:Other"), None)}
    assert len(found | {digest(resolve(str(spec.path.parent / "other.py")), None)}) == 3
    os.rename(spec.path.parent / "data", spec.path.parent / "renamed")
    assert digest(spec, None) not in found


@pytest.mark.parametrize(
    ("name", "why"),
    [
        (".git/HEAD", "hidden"),
        ("__pycache__/policy.pyc", "hidden"),
        ("train.log", "log"),
        ("venv/pyvenv.cfg", "environment"),
        ("runs/one/run.json", "run"),
    ],
)
def test_what_is_left_out_is_neither_copied_nor_hashed(name: str, why: str, spec: PolicySpec, tmp_path: Path) -> None:
    before = digest(spec, None)
    filled(spec.path.parent, {tuple(name.split("/")), (*Path(name).parts[:-1], "more.py")} - {("more.py",)})
    assert digest(spec, None) == before
    copy = take_snapshot(spec, None, tmp_path / "copy")
    assert copy.digest == before
    assert any(why in reason for reason in copy.left_out.values())
    assert not list((tmp_path / "copy").rglob(Path(name).name))


def test_the_copy_is_what_runs(write_policy: WritePolicy, tmp_path: Path) -> None:
    """A file that is swapped after the copy was made reaches neither this process nor the next one."""
    weights = tmp_path / "weights.txt"
    weights.write_text("3")
    spec = write_policy(
        "if n > 1: os._exit(1)\ngood[:, 2] = int(open(self.weights).read()) + helper.ONE\nreturn good",
        top="import helper",
        init="self.weights = checkpoint",
    )
    (tmp_path / "helper.py").write_text("ONE = 1\n")
    recorded = digest(spec, weights)
    with PolicyHost(spec, weights, "cpu", LIMITS) as host:
        assert host.digest == recorded
        for path, text in ((weights, "7"), (tmp_path / "helper.py", "ONE = 9\n"), (spec.path, "")):
            path.write_text(text)
        assert reasons(host.act(make_batch(2))) == ["ok"] * 2  # killed by the batch, started again for each
        (answer,) = host.act(make_batch(1))
        assert host.restarts and isinstance(answer, int) and answer % 16 == 4
    assert digest(spec, weights) != recorded


def test_a_run_refuses_a_policy_that_changed_meanwhile(fake_home: Path, spec: PolicySpec) -> None:
    from evaluator.runner import run_evaluation

    backend = fake_backend(open_policy=lambda *given: PolicyHost(spec, None, "cpu", LIMITS), digest="0" * 64)
    with pytest.raises(RunMismatchError, match="its code or its weights changed"):
        run_evaluation(fake_config(fake_home / "run", episodes=4, engine="inline"), backend=backend)


def test_a_run_holds_one_copy_from_its_beginning_to_its_end(fake_home: Path, spec: PolicySpec) -> None:
    """An author may edit the policy while it is evaluated; what is recorded is what ran."""
    from evaluator.runner import run_evaluation

    before, digests = digest(spec, None), []

    def opened(policy: PolicySpec, *given: object) -> PolicyHost:
        host = PolicyHost(policy, None, "cpu", LIMITS)
        spec.path.write_text("")  # between the copy and the first process, and before the audit
        digests.append(digest(policy, None))
        return host

    backend = fake_backend(open_policy=opened, policy_digest=digest, hold_policy=held)
    runs = fake_home / "runs"
    config = dataclasses.replace(fake_config(runs / "one", episodes=8, engine="inline", audit_share=0.5), policy=spec)
    summary = run_evaluation(config, backend=backend).summary
    header = json.loads((runs / "one" / "run.json").read_text())
    assert header["identity"]["policy_digest"] == before and set(digests) == {before} and len(digests) > 1
    assert summary["policy_errors"] == 0 and summary["episodes"] == 8
    with pytest.raises(RunMismatchError, match="policy_digest"):
        run_evaluation(config, backend=backend)


@pytest.mark.parametrize("declared", ["simulator", "adapted"])
def test_what_a_class_declares_is_recorded(fake_home: Path, tmp_path: Path, declared: str) -> None:
    from evaluator.runner import run_evaluation

    runs = fake_home / "runs"
    for name, tag in (("plain", ""), ("said", f"    {declared} = True\n")):
        path = tmp_path / name / "policy.py"
        path.parent.mkdir()
        path.write_text(CODE.replace("Policy:\n", f"Policy:\n{tag}"))
        spec = resolve(str(path))
        backend = fake_backend(
            open_policy=lambda *given, spec=spec: PolicyHost(spec, None, "cpu", LIMITS),
            policy_digest=lambda *given, spec=spec: digest(spec, None),
        )
        run_evaluation(fake_config(runs / name, episodes=4, engine="inline", audit_share=0.0), backend=backend)
        assert json.loads((runs / name / "run.json").read_text())["policy"][declared] is bool(tag)


def test_a_hugging_face_snapshot_as_it_is(write_policy: WritePolicy, tmp_path: Path) -> None:
    cache = tmp_path / "cache" / "models--me--mine"
    filled(cache, {("blobs", "aa11"), ("blobs", "bb22")})
    (cache / "blobs" / "aa11").write_text("5")
    place = cache / "snapshots" / "rev" / "sub"
    place.mkdir(parents=True)
    (place.parent / "model.safetensors").symlink_to("../../blobs/aa11")
    (place / "config.json").symlink_to("../../../blobs/bb22")
    spec = write_policy(
        "good[:, 2] = int(open(self.file).read())\nreturn good",
        init="self.file = checkpoint / 'model.safetensors' if checkpoint.is_dir() else checkpoint\n"
        "assert not os.path.islink(self.file) and self.file.suffix == '.safetensors'",
    )
    for given in (place.parent, place.parent / "model.safetensors"):
        with PolicyHost(spec, given, "cpu", LIMITS) as host:
            assert [int(answer) % 16 for answer in host.act(make_batch(2))] == [5, 5]  # type: ignore[arg-type]
            assert host.digest == digest(spec, given)
    assert [entry.name for entry in checkpoint_sources(place).entries] == ["config.json"]


def test_links_inside_of_a_checkpoint(tmp_path: Path) -> None:
    filled(tmp_path / "weights", {("step_1", "model.npz")})
    (tmp_path / "weights" / "latest").symlink_to("step_1")
    (tmp_path / "weights" / "step_1" / "round").symlink_to("..")
    names = [entry.name for entry in checkpoint_sources(tmp_path / "weights").entries]
    assert names == ["latest/model.npz", "step_1/model.npz"]


def _fifo(path: Path) -> None:
    os.mkfifo(path)


def _socket(path: Path) -> None:
    here = os.getcwd()
    os.chdir(path.parent)  # the name of a socket is short
    try:
        with socket.socket(socket.AF_UNIX) as end:
            end.bind(path.name)
    finally:
        os.chdir(here)


@pytest.mark.parametrize(
    ("make", "what"),
    [
        (_fifo, "not a regular file"),
        (_socket, "not a regular file"),
        (lambda path: path.symlink_to("/dev/zero"), "not a regular file"),
        (lambda path: path.symlink_to("/etc/passwd"), "leads outside of it, to /etc/passwd"),
        (lambda path: path.symlink_to("/proc/kmsg"), "leads outside of it"),
        (lambda path: path.symlink_to("nowhere"), "leads nowhere"),
    ],
)
def test_what_a_checkpoint_must_not_hold(
    make: Callable[[Path], None], what: str, spec: PolicySpec, tmp_path: Path
) -> None:
    """Refused by name, at once, with the way out; beside a policy it is left out."""
    filled(tmp_path / "weights", {("model.npz",)})
    make(tmp_path / "weights" / "odd")
    for refused in (digest, lambda *given: take_snapshot(*given, tmp_path / "copy")):
        with pytest.raises(InputError, match=what) as caught:
            refused(spec, tmp_path / "weights")
        assert str(tmp_path / "weights" / "odd") in caught.value.message and "cp -rL" in caught.value.hint
    make(spec.path.parent / "odd")
    assert spec.path.parent / "odd" in code_sources(spec.path).left_out


def test_a_pipe_as_the_checkpoint_itself_does_not_wait(spec: PolicySpec, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="not a regular file"):
        digest(spec, tmp_path / "pipe")
    with pytest.raises(MissingFileError, match="does not exist"):
        digest(spec, tmp_path / "absent")


def test_a_folder_that_is_too_large(spec: PolicySpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sources, "CODE_FILES", 5)
    filled(spec.path.parent, {("data", str(number)) for number in range(5)})
    with pytest.raises(InputError, match="more than 5 files") as caught:
        digest(spec, None)
    assert "--checkpoint" in caught.value.hint
    monkeypatch.setattr(sources, "CODE_FILES", 100)
    with (spec.path.parent / "large").open("wb") as file:
        file.truncate(sources.CODE_BYTES + 1)
    with pytest.raises(InputError, match="2 GiB"):
        digest(spec, None)


def test_no_space_for_the_copy(spec: PolicySpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    usage = snapshot.shutil.disk_usage(tmp_path)
    monkeypatch.setattr(snapshot.shutil, "disk_usage", lambda place: usage._replace(free=10))
    with pytest.raises(StorageError, match="a private copy") as caught, PolicyHost(spec, None, "cpu", LIMITS):
        pass
    assert "TMPDIR" in caught.value.hint


def test_in_a_crowded_folder_only_files_and_packages_are_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    filled(
        tmp_path,
        {
            ("mine", "__init__.py"),
            ("mine", "x.npz"),
            ("w.npz",),
            (".netrc",),
            ("photos", "cat"),
            (".ssh", "key"),
            ("p.py",),
        },
    )
    monkeypatch.setattr(Path, "home", lambda: tmp_path)
    names = [entry.name for entry in code_sources(tmp_path / "p.py").entries]
    assert names == ["mine/__init__.py", "mine/x.npz", "p.py", "w.npz"]


def test_a_package_is_imported_from_the_copy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where the original is on the path: its files must not be read beside the copy."""
    package = tmp_path / "my_package"
    filled(package, {("__init__.py",), ("inner", "__init__.py")})
    (package / "shared.py").write_text("ANGLE = 6\n")
    (package / "inner" / "policy.py").write_text(
        "from my_package import shared\n" + CODE.replace("[30, 31, 2]", "[30, 31, shared.ANGLE]")
    )
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([os.environ.get("PYTHONPATH", ""), str(tmp_path)]))
    spec = resolve(str(package / "inner" / "policy.py"))
    with PolicyHost(spec, None, "cpu", LIMITS) as host:
        (package / "shared.py").write_text("ANGLE = 9\n")
        assert [int(answer) % 16 for answer in host.act(make_batch(1))] == [6]  # type: ignore[arg-type]


def test_of_an_installed_policy_only_the_weights_are_copied(tmp_path: Path) -> None:
    weights = tmp_path / "weights"
    weights.write_bytes(b"x")
    named = resolve("random")
    copy = take_snapshot(named, weights, tmp_path / "copy")
    assert copy.policy == named.path and copy.checkpoint != weights
    assert copy.digest == digest(named, weights)
    assert copy.checkpoint is not None and copy.checkpoint.stat().st_mode & 0o222 == 0
    file = dataclasses.replace(named, named=None)
    assert digest(file, weights) != copy.digest
