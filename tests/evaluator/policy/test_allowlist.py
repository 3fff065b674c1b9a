"""What a policy may read: all that it needs, and nothing of what it must not see, wherever that lies."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evaluator.policy import PolicyHost, PolicySpec
from evaluator.policy.sandbox import allowlist
from evaluator.policy.sandbox.allowlist import allowed_for
from tests.evaluator.policy.batches import make_batch
from tests.evaluator.policy.conftest import WritePolicy, skip_without_sandbox
from tests.evaluator.policy.test_host_answers import LIMITS, reasons

NAMES = st.sampled_from(["a", "b", "c", "d.py"])


def readable(path: Path, read: tuple[str, ...]) -> bool:
    return any(path.is_relative_to(allowed) for allowed in read)


def filled(root: Path, paths: set[tuple[str, ...]]) -> list[Path]:
    """Files at the given places, as far as no other file is in the way."""
    made = []
    for parts in sorted(paths):
        place = root.joinpath(*parts)
        if not any(parent.is_file() for parent in place.parents) and not place.exists():
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_text("")
            made.append(place)
    return made


@settings(max_examples=60, deadline=None)
@given(
    paths=st.sets(st.lists(NAMES, min_size=1, max_size=4).map(tuple), min_size=1, max_size=12),
    secret=st.lists(NAMES, min_size=1, max_size=3),
)
def test_everything_but_the_secret(paths: set[tuple[str, ...]], secret: list[str]) -> None:
    with tempfile.TemporaryDirectory() as name:
        root = Path(name).resolve() / "policy"
        root.mkdir()
        files = filled(root, paths)
        hidden = root.joinpath(*secret)
        read = allowed_for(root / "my_policy.py", None, Path(name, "tmp"), {}, [hidden]).read
        for file in files:
            assert readable(file, read) == (not file.is_relative_to(hidden)), file


def test_the_scenario_lists_of_an_installed_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    site = tmp_path / "site-packages"
    files = filled(site, {("rema_data", "_manifests", "list"), ("rema_data", "grid.py"), ("numpy.libs", "blas.so")})
    monkeypatch.setattr(allowlist, "secrets", lambda: [site / "rema_data" / "_manifests"])
    monkeypatch.setattr(sys, "path", [str(site)])
    read = allowed_for(tmp_path / "elsewhere" / "p.py", None, tmp_path / "tmp", {}).read
    assert [readable(file, read) for file in files] == [True, False, True]


def test_a_policy_in_the_home_folder_does_not_open_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = filled(
        tmp_path,
        {("mine", "__init__.py"), ("mine", "x.npz"), ("weights.npz",), (".netrc",), ("photos", "cat"), (".ssh", "key")},
    )
    monkeypatch.setattr(Path, "home", lambda: tmp_path)
    read = allowed_for(tmp_path / "p.py", None, tmp_path / "tmp", {}).read
    assert {file.relative_to(tmp_path).as_posix() for file in files if readable(file, read)} == {
        "mine/__init__.py",
        "mine/x.npz",
        "weights.npz",
    }


def test_a_link_in_the_folder_of_the_weights_opens_nothing(tmp_path: Path) -> None:
    (tmp_path / "weights").mkdir()
    (tmp_path / "secret").write_text("")
    (tmp_path / "weights" / "link").symlink_to(tmp_path / "secret")
    read = allowed_for(tmp_path / "code" / "p.py", tmp_path / "weights", tmp_path / "tmp", {}).read
    assert readable(tmp_path / "weights", read) and not readable(tmp_path / "secret", read)


@pytest.fixture
def reader(write_policy: WritePolicy) -> PolicySpec:
    """A policy that reads every file below its own folder, and prints which it may not."""
    return write_policy(
        """
        for place, _, names in os.walk(os.path.dirname(__file__)):
            for name in names:
                try:
                    open(os.path.join(place, name)).read()
                except PermissionError:
                    print(os.path.join(place, name))
        return good
        """
    )


def test_manifests_caches_and_runs_beside_the_policy(
    reader: PolicySpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The kernel denies them, and not the policy's own data."""
    hidden = filled(
        tmp_path,
        {("manifests", "list"), ("home", "cache"), ("runs", "now", "run.json"), ("runs", "before", "run.json")},
    )
    filled(tmp_path, {("data", "x.npz")})
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path / "manifests"))
    monkeypatch.setenv("REMA_HOME", str(tmp_path / "home"))
    with PolicyHost(reader, None, "cpu", LIMITS, tmp_path / "runs" / "now" / "policy.log") as host:
        skip_without_sandbox(host)
        assert reasons(host.act(make_batch(1))) == ["ok"]
    assert set(host.output.splitlines()) == {str(file) for file in hidden}
