"""What a policy may read: all that it needs, and nothing of what it must not see, wherever that lies."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evaluator.policy import PolicyHost
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


@settings(max_examples=20, deadline=None)
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
        read = allowed_for([], Path(name, "tmp"), {"PYTHONPATH": str(root)}, [hidden]).read
        for file in files:
            assert readable(file, read) == (not file.is_relative_to(hidden)), file


def test_the_scenario_lists_of_an_installed_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    site = tmp_path / "site-packages"
    files = filled(site, {("rema_data", "_manifests", "list"), ("rema_data", "grid.py"), ("numpy.libs", "blas.so")})
    monkeypatch.setattr(allowlist, "secrets", lambda: [site / "rema_data" / "_manifests"])
    monkeypatch.setattr(sys, "path", [str(site)])
    read = allowed_for([], tmp_path / "tmp", {}).read
    assert [readable(file, read) for file in files] == [True, False, True]


@pytest.mark.parametrize("place", ["", "lib/python3.11/site-packages", "envs/other/lib/python3.12/site-packages"])
def test_another_installation_of_rema_shows_its_packages_and_no_more(place: str, tmp_path: Path) -> None:
    root = tmp_path / "prefix"
    files = filled(
        root / place,
        {
            ("manifests", "scenarios", "list"),
            ("rema_data", "__init__.py"),
            ("rema_data", "_manifests", "scenarios", "list"),
            ("rema_data", "grid.py"),
        },
    )
    read = allowed_for([], tmp_path / "tmp", {"CONDA_PREFIX": str(root)}).read
    shown = {file.relative_to(root / place).as_posix() for file in files if readable(file, read)}
    assert shown == {"rema_data/__init__.py", "rema_data/grid.py"}


def test_of_another_checkout_its_runs_and_its_history_stay_unseen(tmp_path: Path) -> None:
    files = filled(
        tmp_path / "checkout",
        {(".git", "HEAD"), ("runs", "x"), ("manifests", "x"), ("rema_data", "__init__.py"), ("README.md",)},
    )
    read = allowed_for([], tmp_path / "tmp", {"PYTHONPATH": str(tmp_path / "checkout")}).read
    assert sorted(file.name for file in files if readable(file, read)) == ["README.md", "__init__.py"]


def test_the_home_folder_on_the_path_is_not_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = filled(
        tmp_path,
        {("mine", "__init__.py"), ("mine", "x.npz"), ("weights.npz",), (".netrc",), ("photos", "cat"), (".ssh", "key")},
    )
    monkeypatch.setattr(Path, "home", lambda: tmp_path)
    read = allowed_for([], tmp_path / "tmp", {"PYTHONPATH": str(tmp_path)}).read
    assert {file.relative_to(tmp_path).as_posix() for file in files if readable(file, read)} == {
        "mine/__init__.py",
        "mine/x.npz",
        "weights.npz",
    }


def test_manifests_caches_and_runs_beside_the_policy(
    write_policy: WritePolicy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They are not in the copy, and the kernel denies them in their own place; the policy's data are in the copy."""
    hidden = filled(
        tmp_path,
        {("manifests", "list"), ("home", "cache"), ("runs", "now", "run.json"), ("runs", "before", "run.json")},
    )
    own = filled(tmp_path, {("data", "x.npz")})
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path / "manifests"))
    monkeypatch.setenv("REMA_HOME", str(tmp_path / "home"))
    spec = write_policy(
        f"""
        for place in {[str(file) for file in (*hidden, *own)]!r}:
            beside = os.path.join(os.path.dirname(__file__), os.path.relpath(place, {str(tmp_path)!r}))
            for name in (place, beside):
                try:
                    open(name).read()
                    print(name == place, os.path.basename(name))
                except OSError:
                    pass
        return good
        """
    )
    with PolicyHost(spec, None, "cpu", LIMITS, tmp_path / "runs" / "now" / "policy.log") as host:
        skip_without_sandbox(host)
        assert reasons(host.act(make_batch(1))) == ["ok"]
    assert host.output.splitlines() == ["False x.npz"]
