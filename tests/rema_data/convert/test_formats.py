"""The door for formats: built-in ones and those of other packages, by name."""

from __future__ import annotations

import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from click.testing import CliRunner

from evaluator.cli.main import cli
from rema_data.convert import export_release, find_format, formats, installed_formats
from rema_data.convert.hdf5 import Hdf5
from rema_data.errors import InputError
from rema_data.release.folder import ReleaseFolder
from rema_data.testing.formats import FormatContract


class TestHdf5(FormatContract):
    format = Hdf5()


class Copied(Hdf5):
    """A format of another package."""


class Broken:
    def __init__(self) -> None:
        raise RuntimeError("it needs libfoo")


@pytest.fixture(autouse=True)
def packages(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two formats of other packages, and one that would replace ours."""
    places = {"copied": f"{__name__}:Copied", "broken": f"{__name__}:Broken", "gone": "no_package:Format"}
    entries = [EntryPoint(name, place, "rema.formats") for name, place in {**places, "hdf5": "evil:Hdf5"}.items()]
    monkeypatch.setattr(formats, "entry_points", lambda group: entries if group == "rema.formats" else [])


def test_a_package_adds_a_format_without_an_edit_here(release: ReleaseFolder, tmp_path: Path) -> None:
    (made,) = export_release(release, tmp_path, "copied", tasks=["grasp"])
    assert made.path == tmp_path / "grasp.hdf5"


def test_a_package_does_not_replace_a_built_in_format() -> None:
    assert type(find_format("hdf5")) is Hdf5


def test_an_unknown_format_lists_what_is_installed(release: ReleaseFolder, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="unknown format 'zip'") as caught:
        export_release(release, tmp_path, "zip")
    assert caught.value.hint == "installed formats: broken, copied, gone, hdf5"
    for arguments in (["export", str(release.path)], ["import", str(tmp_path)]):
        done = CliRunner().invoke(cli, [*arguments, "--format", "zip", "--output", str(tmp_path / "out")])
        assert done.exit_code == 2 and "installed formats: broken, copied, gone, hdf5" in done.stderr


@pytest.mark.parametrize(("name", "why"), [("broken", "it needs libfoo"), ("gone", "no_package")])
def test_a_format_that_cannot_be_loaded_is_an_error(name: str, why: str) -> None:
    with pytest.raises(InputError, match=f"the format '{name}' .* cannot be loaded: .*{why}") as caught:
        find_format(name)
    assert "pip install" in caught.value.hint


def test_the_built_in_formats_are_declared_as_entry_points(monkeypatch: pytest.MonkeyPatch) -> None:
    declared = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text())
    monkeypatch.setattr(formats, "entry_points", lambda group: [])
    built_in = {name: entry.value for name, entry in installed_formats().items()}
    assert declared["project"]["entry-points"]["rema.formats"] == built_in
