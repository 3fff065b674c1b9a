"""The paper's figure of the data by round: positives and negatives accumulated over the rounds, for every task.

Beside our last bar stands the paper's, from its Table 2.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rema_data.errors import InputError
from rema_data.repair import install
from rema_data.statistics.count import Statistics
from rema_data.statistics.paper import Counts, published_counts
from rema_data.storage import write_atomic

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["accumulated", "plot_rounds"]

_POSITIVE, _NEGATIVE, _INK = "#1a7f37", "#c9ccd1", "#1f2328"


def accumulated(statistics: Statistics) -> dict[str, dict[int, tuple[int, int]]]:
    """Positives and negatives of the last steps of every task, up to every round of the release, by task and round."""
    rounds = sorted({row.round for row in statistics.steps})
    sums: dict[str, dict[int, tuple[int, int]]] = {}
    for total in statistics.totals():
        last = [row for row in statistics.steps if row.task == total.task and row.last]
        kept = {number: [row for row in last if row.round <= number] for number in rounds}
        sums[total.task] = {
            number: (sum(row.positives for row in rows), sum(row.negatives for row in rows))
            for number, rows in kept.items()
        }
    return sums


def plot_rounds(statistics: Statistics, path: Path) -> None:
    """Draw the figure into a PNG file.

    Raises
    ------
    InputError
        matplotlib is not installed, the file name has another suffix, or there is nothing to draw.
    StorageError
        The file cannot be written.
    """
    if path.suffix.lower() != ".png":
        raise InputError(f"{path} is not a PNG file", hint=f"write --plot {path.with_suffix('.png')}", path=str(path))
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise InputError(f"figures need {error.name}, which is not installed", hint=install("rema[report]")) from error
    sums, paper = accumulated(statistics), published_counts()
    if not sums:
        raise InputError(f"no block of {statistics.release} is on this machine", hint=statistics.fix)
    figure = Figure(figsize=(2.6 * len(sums) + 0.6, 3.4), dpi=150, facecolor="white", layout="constrained")
    panels = figure.subplots(1, len(sums), squeeze=False)[0]
    for axes, (task, counts) in zip(panels, sums.items(), strict=True):
        _panel(axes, counts, paper.get(task))
        axes.set_title(task, fontsize=9, color=_INK)
    panels[0].set_ylabel("last steps, accumulated", color=_INK)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False, fontsize=8)
    absent = f", {len(statistics.missing)} blocks not counted (not on this machine)" if statistics.missing else ""
    figure.suptitle(f"{statistics.release}: data by round{absent}", fontsize=10, color=_INK)
    buffer = io.BytesIO()
    FigureCanvasAgg(figure).print_png(buffer)  # type: ignore[no-untyped-call]
    write_atomic(path, buffer.getvalue())


def _panel(axes: Axes, counts: dict[int, tuple[int, int]], paper: Counts | None) -> None:
    bars = {str(number): pair for number, pair in counts.items()}
    if paper is not None:
        bars["paper"] = (paper.positives, paper.negatives)
    place = np.arange(len(bars))
    positives, negatives = np.array(list(bars.values())).T
    axes.bar(place, positives, 0.7, color=_POSITIVE, label="positive")
    axes.bar(place, negatives, 0.7, bottom=positives, color=_NEGATIVE, label="negative")
    for x, good, bad in zip(place, positives, negatives, strict=True):
        if good + bad:
            share = f"{100 * good / (good + bad):.1f} %"
            axes.annotate(
                share, (x, good + bad), (0, 2), textcoords="offset points", ha="center", fontsize=7, color=_INK
            )
    axes.set_xticks(place, list(bars))
    axes.set_xlabel("round", color=_INK)
    axes.margins(y=0.18)
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:,.0f}")
    axes.tick_params(labelsize=7, colors=_INK)
    axes.spines[["top", "right"]].set_visible(False)
