"""Entry points: found by group, also in a checkout that is not installed."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from rema_data import plugins
from rema_data.errors import InputError

ROOT = Path(__file__).resolve().parents[2]
DECLARED = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"]


@pytest.mark.parametrize("group", DECLARED)
def test_every_entry_point_of_the_project_is_found(group: str) -> None:
    assert DECLARED[group].keys() <= plugins.installed(group).keys()
    assert list(plugins.installed(group)) == sorted(plugins.installed(group))


def test_a_checkout_that_is_not_installed_offers_the_same() -> None:
    code = (
        "import importlib.metadata\nimportlib.metadata.entry_points = lambda **_: ()\n"
        "from rema_data import plugins\nprint(*plugins.installed('rema.policies'))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.split() == sorted(DECLARED["rema.policies"])


def test_an_object_of_another_type_is_refused() -> None:
    with pytest.raises(InputError, match="is a NamedPolicy, not a int"):
        plugins.load(plugins.installed("rema.policies")["random"], int)
