"""Policies that packages offer by name: found, listed, asked in the sandbox, and shown with their kind."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from evaluator.policy import NamedPolicy, PolicyHost, digest, find_named, kind_of, policy_names, resolve, weights_of
from evaluator.policy.named import KINDS, listing
from evaluator.policy.sandbox.snapshot import own_modules
from rema_data.errors import InputError
from tests.evaluator.policy.batches import make_batch
from tests.evaluator.policy.test_host_answers import LIMITS, reasons

CATALOGUE = """
from pathlib import Path
from evaluator.policy import NamedPolicy
HERE = Path(__file__).parent
CENTRE = NamedPolicy(HERE / "deep" / "centre.py", "Centre", "heuristic", "Always the centre.", HERE / "weights.npy")
NOTHING = "not a policy"
"""
POLICY = """
import numpy as np
from robots.shared import ANSWER
class Centre:
    def __init__(self, checkpoint, device):
        self.answer = np.load(checkpoint)
    def act(self, observations):
        return np.tile(ANSWER + 0 * self.answer, (len(observations), 1))
"""


def install(site: Path, package: str, **points: str) -> None:
    """The metadata of a package, as pip writes it."""
    info = site / f"{package}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
    lines = "".join(f"{name} = {value}\n" for name, value in points.items())
    (info / "entry_points.txt").write_text(f"[rema.policies]\n{lines}")


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of installed packages, one of which offers policies."""
    place = tmp_path / "site"
    files = {"__init__.py": "", "catalogue.py": CATALOGUE, "shared.py": "ANSWER = [30, 31, 2]\n"}
    for name, text in {**files, "deep/__init__.py": "", "deep/centre.py": POLICY}.items():
        (place / "robots" / name).parent.mkdir(parents=True, exist_ok=True)
        (place / "robots" / name).write_text(text)
    import numpy as np

    np.save(place / "robots" / "weights.npy", np.zeros(1, int))
    install(place, "robots", centre="robots.catalogue:CENTRE", nothing="robots.catalogue:NOTHING", gone="robots.no:X")
    monkeypatch.syspath_prepend(str(place))
    monkeypatch.setenv("PYTHONPATH", str(place), prepend=":")
    for name in [name for name in sys.modules if name.split(".")[0] == "robots"]:
        monkeypatch.delitem(sys.modules, name)
    return place


def test_a_policy_of_another_package_is_evaluated_like_a_built_in_one(site: Path) -> None:
    spec = resolve("centre")
    assert (spec.name, spec.class_name, spec.path) == ("centre", "Centre", site / "robots" / "deep" / "centre.py")
    weights = weights_of(spec, None)
    assert weights == site / "robots" / "weights.npy"
    assert {path.name for path in own_modules(spec.path)} == {"__init__.py", "shared.py"}
    assert digest(spec, weights) != digest(spec, None)
    with PolicyHost(spec, weights, "cpu", LIMITS) as host:
        assert reasons(host.act(make_batch(3))) == ["ok"] * 3


def test_the_kind_is_what_its_package_says(site: Path) -> None:
    assert kind_of("centre") == "heuristic"
    assert [kind_of(name) for name in ("nobody", "nothing", "gone")] == [None, None, None]


def test_an_unknown_name_lists_what_is_installed_broken_packages_too(site: Path) -> None:
    with pytest.raises(InputError, match="no policy is called 'nobody'") as caught:
        resolve("nobody")
    assert listing() in caught.value.hint
    assert "centre        Always the centre. (heuristic)" in listing()
    assert "broken: 'gone' of rema.policies (robots.no:X, package robots) cannot be loaded" in listing()
    assert "tae-joint" in listing()


@pytest.mark.parametrize(("name", "words"), [("nothing", "is a str, not a NamedPolicy"), ("gone", "No module named")])
def test_a_broken_package_is_named(site: Path, name: str, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        resolve(name)
    assert "pip uninstall robots" in caught.value.hint


def test_two_packages_with_one_name(site: Path) -> None:
    install(site.parent / "other", "others", centre="others:CENTRE")
    code = "from evaluator.policy import resolve; resolve('centre')"
    path = ":".join([str(site), str(site.parent / "other"), *sys.path])
    done = subprocess.run([sys.executable, "-c", code], env={"PYTHONPATH": path}, capture_output=True, text=True)
    assert "two packages offer 'centre' as one of rema.policies: robots and others" in done.stderr


def test_a_file_does_not_pass_for_an_installed_policy(site: Path, tmp_path: Path) -> None:
    (tmp_path / "centre.py").write_text("class Policy: ...\n")
    spec = resolve(str(tmp_path / "centre.py"))
    assert (spec.name, spec.named) == ("centre.py", None)


def test_the_built_in_policies_come_through_the_same_door() -> None:
    named = {name: find_named(name) for name in policy_names()}
    assert {"random", "scripted", "reference", "tae", "tae-joint", "tae-separate"} <= named.keys()
    assert all(one is not None and one.kind in KINDS and one.file.is_file() for one in named.values())


def test_an_unknown_kind() -> None:
    with pytest.raises(InputError, match="unknown kind of policy 'magic'"):
        NamedPolicy(Path("x.py"), "X", "magic", "")
