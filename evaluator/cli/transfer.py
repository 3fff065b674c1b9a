"""Progress of a transfer on stderr, in bytes."""

from __future__ import annotations

import time

from rich.filesize import decimal
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeRemainingColumn, TransferSpeedColumn

from evaluator.cli.progress import StderrProgress

__all__ = ["TransferProgress"]


class TransferProgress(StderrProgress):
    """As ``StderrProgress``, with bytes for items (``rema_data.download.Progress``)."""

    def __init__(self) -> None:
        super().__init__()
        self._bars = Progress(
            TextColumn("{task.description:>14}"),
            BarColumn(None),
            DownloadColumn(),
            TransferSpeedColumn(),
            TimeRemainingColumn(elapsed_when_finished=True),
            console=self._console,
        )

    def _write_line(self) -> None:
        seconds = time.monotonic() - self._began
        rate = f", {decimal(int(self._done / seconds))}/s" if seconds > 0 else ""
        self.note(f"{self._name}: {decimal(self._done)} of {decimal(self._total)} in {seconds:.1f} s{rate}")
