"""The door for formats: built-in ones and those of other packages, by name."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from evaluator.cli.main import cli
from rema_data.convert import export_release, find_format
from rema_data.convert.hdf5 import Hdf5
from rema_data.errors import InputError
from rema_data.plugins import installed
from rema_data.release.folder import ReleaseFolder
from rema_data.testing.formats import FormatContract

BUILT_IN = sorted(name for name, point in installed("rema.formats").items() if point.value.startswith("rema_data."))

for _name in BUILT_IN:
    _contract = f"Test{_name.capitalize()}"
    globals()[_contract] = type(_contract, (FormatContract,), {"format": find_format(_name), "__module__": __name__})


class Copied(Hdf5):
    """A format of another package."""


class Broken:
    def __init__(self) -> None:
        raise RuntimeError("it needs libfoo")


PLACES = {"copied": f"{__name__}:Copied", "broken": f"{__name__}:Broken", "gone": "no_package:Format"}


def install(folder: Path, formats: dict[str, str]) -> None:
    """A package that offers formats, as far as its metadata say."""
    metadata = folder / f"{folder.name}-1.0.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {folder.name}\nVersion: 1.0\n")
    lines = [f"{name} = {place}" for name, place in formats.items()]
    (metadata / "entry_points.txt").write_text("\n".join(["[rema.formats]", *lines]))


@pytest.fixture(autouse=True)
def package(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """An installed package with a format, and with two that do not work."""
    folder = tmp_path_factory.mktemp("site") / "morefor"
    install(folder, PLACES)
    monkeypatch.syspath_prepend(folder)


def test_a_package_adds_a_format_without_an_edit_here(release: ReleaseFolder, tmp_path: Path) -> None:
    (made,) = export_release(release, tmp_path, "copied", tasks=["grasp"])
    assert made.path == tmp_path / "grasp.hdf5"


def test_two_packages_with_one_name_are_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path / "site" / "another", {"copied": "another:Copied"})
    monkeypatch.syspath_prepend(tmp_path / "site" / "another")
    with pytest.raises(InputError, match="two packages offer 'copied'"):
        find_format("copied")


def test_an_unknown_format_lists_what_is_installed(release: ReleaseFolder, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="unknown format 'zip'") as caught:
        export_release(release, tmp_path, "zip")
    names = f"installed formats: {', '.join(sorted([*BUILT_IN, *PLACES]))}"
    assert caught.value.hint == names
    for arguments in (["export", str(release.path)], ["import", str(tmp_path)]):
        done = CliRunner().invoke(cli, [*arguments, "--format", "zip", "--output", str(tmp_path / "out")])
        assert done.exit_code == 2 and names in done.stderr


@pytest.mark.parametrize(("name", "why"), [("broken", "it needs libfoo"), ("gone", "no_package")])
def test_a_format_that_cannot_be_loaded_is_an_error(name: str, why: str) -> None:
    with pytest.raises(InputError, match=f"'{name}' .*cannot be .*{why}") as caught:
        find_format(name)
    assert caught.value.hint
