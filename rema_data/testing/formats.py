"""The tests that every export format must pass, as a pytest mixin."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from rema_data.convert import ExportOptions, export_release, import_release
from rema_data.convert.base import Format
from rema_data.errors import InputError, IntegrityError, MissingFileError, RemaError, RunMismatchError, StorageError
from rema_data.progress import Silent
from rema_data.release.folder import ReleaseFolder
from rema_data.testing.releases import make_release

__all__ = ["FormatContract"]

_OPTIONS = pytest.mark.parametrize(
    "options", [ExportOptions(), ExportOptions("quantised"), ExportOptions(next_obs=True)], ids=str
)


def _files(folder: Path) -> dict[str, bytes]:
    """Every file below a folder, with its bytes."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@lru_cache
def _release(root: Path) -> ReleaseFolder:
    return make_release(root / "release", tasks=("grasp", "grasp_grasp_push"), episodes=5)


class _Stop(Silent):
    """Progress of a user who presses Ctrl-C."""

    def advance(self, n: int) -> None:
        raise KeyboardInterrupt


class FormatContract:
    """What ``rema_data.convert.base.Format`` promises. Inherit it in a test class, and supply the format.

    Attributes
    ----------
    format : Format
        The format under test. The subclass sets it.
    damages : int
        Bytes that are flipped, one at a time, in ``test_a_flipped_byte_never_passes_for_the_release``.

    Notes
    -----
    A format that has no use for an option refuses it with an InputError before it writes anything: the tests accept
    that. One that cannot keep what is varied in an episode refuses the release in the same way. Formats of directories
    are fine: the tests compare all files below the folder of an export.

    Examples
    --------
    ::

        from my_package import MyFormat
        from rema_data.testing.formats import FormatContract

        class TestMyFormat(FormatContract):
            format = MyFormat()
    """

    format: Format
    damages: int = 8

    @pytest.fixture
    def release(self, tmp_path_factory: pytest.TempPathFactory) -> ReleaseFolder:
        """Five training episodes and one for validation of two tasks, of one and of up to four steps."""
        return _release(tmp_path_factory.getbasetemp() / "formats")

    @pytest.fixture
    def exported(self, release: ReleaseFolder) -> Path:
        """The whole release with the default options."""
        folder = release.root.parent / type(self).__name__
        export_release(release, folder, self.format)  # what is there already is left as it is
        return folder

    @pytest.fixture
    def export(self, exported: Path, tmp_path: Path) -> Path:
        """An export that may be damaged."""
        return shutil.copytree(exported, tmp_path / "export")

    def _refused(self, sources: Sequence[Path], folder: Path, kind: type[RemaError]) -> RemaError:
        """The error of an import, which has a hint and leaves nothing behind."""
        with pytest.raises(kind) as caught:
            import_release(sources, folder, format=self.format)
        assert caught.value.hint
        assert not folder.exists() or list(folder.iterdir()) == []
        return caught.value

    @_OPTIONS
    def test_out_and_back_is_the_same_release(
        self, options: ExportOptions, release: ReleaseFolder, tmp_path: Path
    ) -> None:
        """The manifest has the same hash, every file the same bytes, and every file is read-only."""
        if not self._takes(options, release, tmp_path / "export"):
            return
        imported = import_release([tmp_path / "export"], tmp_path / "back", format=self.format)
        assert imported.identical and imported.differences == () and imported.notes == ()
        assert _files(tmp_path / "back") == _files(release.root)
        assert not any(path.stat().st_mode & 0o222 for path in (tmp_path / "back").rglob("*") if path.is_file())

    def _takes(self, options: ExportOptions, release: ReleaseFolder, folder: Path) -> bool:
        """Export with these options; False where the format refuses them, before it has written anything."""
        try:
            export_release(release, folder, self.format, options)
        except InputError:
            assert not folder.exists() or _files(folder) == {}
            return False
        return True

    def test_varied_episodes_come_back_or_are_refused(self, tmp_path: Path) -> None:
        """A format that cannot keep what is varied says so, and writes nothing."""
        varied = make_release(tmp_path / "release", tasks=("grasp_push",), episodes=6, varied=True)
        if not self._takes(ExportOptions(), varied, tmp_path / "export"):
            return
        imported = import_release([tmp_path / "export"], tmp_path / "back", format=self.format)
        assert imported.identical and imported.notes == ()
        assert _files(tmp_path / "back") == _files(varied.root)

    def test_a_selection_has_the_bytes_of_its_blocks(self, release: ReleaseFolder, tmp_path: Path) -> None:
        """A release of one block of another is named as such, and its block has the same files."""
        export_release(release, tmp_path / "export", self.format, tasks=["grasp"], split="val")
        imported = import_release([tmp_path / "export"], tmp_path / "back", "part", self.format)
        assert not imported.identical and len(imported.differences) == 4
        block = "round-1/grasp/val"
        assert [entry.key.path for entry in imported.release.manifest.blocks] == [block]
        assert _files(imported.release.path / block) == _files(release.path / block)

    def test_what_was_exported_is_reported(self, release: ReleaseFolder, tmp_path: Path) -> None:
        """The files that are reported are those that are there, with their sizes, and all steps are in one of them."""
        made = export_release(release, tmp_path, self.format)
        counts = release.manifest.counts
        for name in ("episodes", "steps"):
            assert sum(getattr(file, name) for file in made) == counts[name]
        assert sum(file.bytes for file in made) == sum(len(data) for data in _files(tmp_path).values())
        assert all(file.new for file in made)

    def test_equal_exports_are_equal_bytes_and_are_not_written_twice(
        self, release: ReleaseFolder, export: Path, exported: Path
    ) -> None:
        """What is there is left alone."""
        before = {path: path.stat().st_mtime_ns for path in export.rglob("*")}
        assert not any(file.new for file in export_release(release, export, self.format))
        assert {path: path.stat().st_mtime_ns for path in export.rglob("*")} == before
        shutil.rmtree(export)
        export_release(release, export, self.format)
        assert _files(export) == _files(exported)

    def test_another_export_is_not_overwritten(self, release: ReleaseFolder, export: Path, exported: Path) -> None:
        """A file of other blocks or of another release is in the way."""
        with pytest.raises(RunMismatchError) as caught:
            export_release(release, export, self.format, split="val")
        assert caught.value.hint
        assert _files(export) == _files(exported)

    def test_an_interrupted_export_leaves_nothing_half_written(
        self, release: ReleaseFolder, exported: Path, tmp_path: Path
    ) -> None:
        """What the interruption leaves is finished by the same call."""
        with pytest.raises(KeyboardInterrupt):
            export_release(release, tmp_path, self.format, progress=_Stop())
        assert _files(tmp_path).items() <= _files(exported).items()
        export_release(release, tmp_path, self.format)
        assert _files(tmp_path) == _files(exported)

    def test_an_interrupted_import_leaves_nothing(self, exported: Path, tmp_path: Path) -> None:
        """Neither a release nor a temporary folder."""
        with pytest.raises(KeyboardInterrupt):
            import_release([exported], tmp_path / "back", format=self.format, progress=_Stop())
        assert not (tmp_path / "back").exists()

    @pytest.mark.parametrize("limit", [3_000, 30_000])
    def test_a_full_disk_is_an_error_and_leaves_nothing(
        self, limit: int, release: ReleaseFolder, exported: Path, tmp_path: Path
    ) -> None:
        """No file may grow beyond ``limit`` bytes."""
        resource = pytest.importorskip("resource")
        soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
        try:
            with pytest.raises(StorageError) as caught:
                export_release(release, tmp_path / "export", self.format)
            assert str(tmp_path) in caught.value.message
            if limit < 10_000:  # of a release, the datasheet is larger
                with pytest.raises(StorageError):
                    import_release([exported], tmp_path / "back", format=self.format)
                assert not (tmp_path / "back").exists()
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        assert _files(tmp_path / "export").items() <= _files(exported).items()

    def _largest(self, export: Path) -> Path:
        return max((path for path in export.rglob("*") if path.is_file()), key=lambda path: path.stat().st_size)

    @pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.99])
    def test_a_truncated_file_is_named(self, share: float, export: Path, tmp_path: Path) -> None:
        """However much of it is left."""
        path = self._largest(export)
        data = path.read_bytes()
        path.write_bytes(data[: int(share * len(data))])
        assert path.name in self._refused([export], tmp_path / "back", IntegrityError).message

    def test_a_file_of_another_kind_is_named(self, export: Path, tmp_path: Path) -> None:
        """Such as the web page that a download brought instead."""
        path = self._largest(export)
        path.write_bytes(b"<!DOCTYPE html>" * 100)
        assert path.name in self._refused([export], tmp_path / "back", IntegrityError).message

    def test_a_flipped_byte_never_passes_for_the_release(self, release: ReleaseFolder, tmp_path: Path) -> None:
        """The import is refused, or its identity is another one, or the byte meant nothing."""
        export_release(release, tmp_path / "export", self.format, tasks=["grasp"])
        path = self._largest(tmp_path / "export")
        data = bytearray(path.read_bytes())
        expected = _files(release.path / "round-1" / "grasp")
        for number, place in enumerate(np.random.default_rng(0).integers(0, len(data), self.damages)):
            damaged = data.copy()
            damaged[place] ^= 0xFF
            path.write_bytes(damaged)
            try:
                imported = import_release([tmp_path / "export"], tmp_path / f"{number}", "part", self.format)
            except RemaError:
                continue
            changed = _files(imported.release.path / "round-1" / "grasp") != expected
            assert not changed or any("grasp" in text for text in imported.differences)

    def test_what_is_not_there_is_named(self, tmp_path: Path) -> None:
        """Files, the content of folders, and anything at all."""
        (tmp_path / "empty").mkdir()
        for sources in ([tmp_path / "missing"], [tmp_path / "empty"], []):
            error = self._refused(sources, tmp_path / "back", MissingFileError)
            assert all(str(source) in error.message for source in sources)

    def test_a_release_is_never_overwritten(self, exported: Path, tmp_path: Path) -> None:
        """The second import of the same export is refused."""
        import_release([exported], tmp_path, format=self.format)
        before = _files(tmp_path)
        with pytest.raises(RunMismatchError):
            import_release([exported], tmp_path, format=self.format)
        assert _files(tmp_path) == before
