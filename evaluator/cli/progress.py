"""Progress on stderr: bars with rate and time left on a terminal, a line now and then in a log file."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterable
from types import TracebackType
from typing import Self

from rich.filesize import decimal
from rich.progress import (
    BarColumn,
    DownloadColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
    TransferSpeedColumn,
)
from rich.table import Table
from rich.text import Text

from evaluator.cli import output

__all__ = ["StderrProgress"]

_LINE_EVERY_S = 30.0
_LEAST_BAR = 8


class _Rate(ProgressColumn):
    """Items a second, over the whole phase once it is done."""

    def render(self, task: Task) -> Text:
        speed = task.finished_speed or task.speed
        return Text("" if speed is None else f"{speed:,.1f}/s", style="progress.data.speed")


class _Bars(Progress):
    """Bars whose numbers are never cut: a narrow terminal does without the bar, the detail, the time or the rate."""

    def make_tasks_table(self, tasks: Iterable[Task]) -> Table:
        tasks, whole = list(tasks), self.columns
        description, bar, _, rate, left, detail = whole
        dispensable = [bar, detail, left, rate, description]

        def width(column: ProgressColumn | str) -> int:
            if column is bar:
                return _LEAST_BAR
            rendered = [column(task) for task in tasks if not isinstance(column, str)]
            return max((text.cell_len for text in rendered if isinstance(text, Text)), default=0)

        kept = list(whole)
        while tasks and dispensable and sum(width(column) + 1 for column in kept) > self.console.width:
            kept.remove(dispensable.pop(0))
        self.columns = tuple(kept)
        try:
            return super().make_tasks_table(tasks)
        finally:
            self.columns = whole


class StderrProgress(logging.Handler):
    """``rema_data.progress.Progress`` on stderr, as a context manager; ``in_bytes``: the phases count bytes.

    Warnings of the library appear above the bars meanwhile.
    """

    def __init__(self, in_bytes: bool = False) -> None:
        super().__init__()
        self._console = output.console(err=True)
        self._in_bytes = in_bytes
        columns = (DownloadColumn(), TransferSpeedColumn()) if in_bytes else (MofNCompleteColumn(), _Rate())
        more = (TimeRemainingColumn(elapsed_when_finished=True), TextColumn("{task.fields[detail]}"))
        self._bars = _Bars(
            TextColumn("{task.description:>14}"), BarColumn(None), *columns, *more, console=self._console
        )
        self._bar: TaskID | None = None
        self._live = self._console.is_terminal
        self._begin("", 0)

    def _begin(self, name: str, total: int) -> None:
        self._name, self._total, self._done, self._before, self._detail = name, total, 0, 0, ""
        self._began = self._line = time.monotonic()

    def __enter__(self) -> Self:
        logging.getLogger("evaluator").addHandler(self)
        if self._live:
            self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end_phase()
        if self._live:
            self._bars.stop()
        logging.getLogger("evaluator").removeHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        """A warning of the library."""
        self.note(f"{record.levelname.lower()}: {record.getMessage()}")

    def phase(self, name: str, total: int) -> None:
        """A phase of ``total`` items begins."""
        self._end_phase()
        self._begin(name, total)
        if self._live:
            self._bar = self._bars.add_task(name, total=total, detail="")

    def advance(self, n: int) -> None:
        """``n`` more items are done."""
        self._done += n
        if self._bar is not None:
            self._bars.advance(self._bar, n)
        elif time.monotonic() - self._line > _LINE_EVERY_S:
            self._line = time.monotonic()
            self._write_line()

    def resume(self, n: int) -> None:
        """``n`` items were done by an earlier process: they do not count in the rate."""
        self._done = self._before = n
        if self._bar is not None:
            self._bars.reset(self._bar, completed=n)

    def tell(self, detail: str) -> None:
        """The state of this phase in a few words, beside the bar and in its lines."""
        self._detail = detail
        if self._bar is not None:
            self._bars.update(self._bar, detail=detail)

    def note(self, text: str) -> None:
        """A message on a line of its own, above the bars."""
        self._console.print(output.plain(text), soft_wrap=True)

    def result(self, text: str) -> None:
        """A line of the result while work goes on: on stdout, or above the bars where both are on a terminal."""
        if self._live and output.console().is_terminal:
            self.note(text)
        else:
            output.line(text)

    def _end_phase(self) -> None:
        if self._name and not self._live:
            self._write_line()
        self._name = ""

    def _write_line(self) -> None:
        seconds = time.monotonic() - self._began
        speed = (self._done - self._before) / seconds if seconds > 0 else None
        done, total = str(self._done), str(self._total)
        rate = "" if speed is None else f", {decimal(int(speed)) if self._in_bytes else f'{speed:,.1f}'}/s"
        if self._in_bytes:
            done, total = decimal(self._done), decimal(self._total)
        detail = f", {self._detail}" if self._detail else ""
        self.note(f"{self._name}: {done}/{total} in {seconds:.1f} s{rate}{detail}")
