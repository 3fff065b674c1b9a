"""What a network sees in some steps: the best score of every place, over the scene. Needs the extra ``report``."""

from __future__ import annotations

import io
import math
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from scipy.special import expit

from baselines.tae.network import TaeNetwork
from baselines.tae.scoring import Scorer
from rema_data.errors import InputError
from rema_data.grid import ANGLES, decode, inside_valid_square
from rema_data.loader.batch import StepBatch
from rema_data.loader.dataset import StepDataset
from rema_data.schema import Embodiment, Primitive, StepKind
from rema_data.storage import write_atomic

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_maps", "require_matplotlib"]

_ROWS, _COLUMNS = 3, 4
_ARROW = 8
"""Pixels of the line that shows the yaw of an action, to both sides."""
_GREEN, _RED, _BLUE = "#1a7f37", "#b42318", "#0969da"


def require_matplotlib() -> None:
    """Raise an InputError where pictures cannot be drawn: to be asked before hours of training, too."""
    if find_spec("matplotlib") is None:
        raise InputError("pictures need matplotlib, which is not installed", hint='pip install "rema[report]"')


def draw_maps(network: TaeNetwork, data: StepDataset, path: Path) -> None:
    """Draw predicted maps over the scenes of twelve steps, evenly spread, into a PNG file.

    Every panel shows the scene, the score of the best angle at every place, the best action (blue) and the recorded one
    (green for a success, red for a failure). Raises InputError without matplotlib.
    """
    require_matplotlib()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows = np.unique(np.linspace(0, len(data) - 1, min(len(data), _ROWS * _COLUMNS)).astype(int))
    batch = data[rows]
    assert isinstance(batch, StepBatch)
    maps, table = batch.float(), data.table.iloc[rows]
    scorer = Scorer(network)
    figure = Figure(figsize=(2.5 * _COLUMNS, 2.9 * _ROWS), dpi=110, facecolor="white", layout="constrained")
    for axes in figure.subplots(_ROWS, _COLUMNS).flat:
        axes.set_axis_off()
    hands = torch.movedim(maps.end_effector, 1, -1).numpy()
    for n, (axes, (_, row)) in enumerate(zip(figure.axes, table.iterrows(), strict=False)):
        angles = StepKind(Primitive(row["primitive"]), Embodiment(row["embodiment"])).angles
        scores = expit(scorer.log_odds(maps.scene[n].numpy(), hands[n : n + 1], angles)[0])
        scores[~inside_valid_square()] = 0.0
        axes.imshow(maps.scene[n, 0].numpy(), cmap="Greys", vmin=0, vmax=0.08, origin="lower")
        shown = axes.imshow(scores.max(-1), cmap="inferno", vmin=0, vmax=1, origin="lower", alpha=0.55)
        i, j, k = np.unravel_index(int(scores.argmax()), scores.shape)
        _mark(axes, (int(i), int(j), int(k)), _BLUE)
        taken = tuple(int(part) for part in decode(int(row["action"])))
        _mark(axes, taken, _GREEN if row["success"] else _RED)
        said = float(scores[taken])
        axes.set_title(
            f"{row['task']}, step {row['step'] + 1}: {'success' if row['success'] else row['failure']}\n"
            f"recorded {said:.2f}, best {scores.max():.2f}",
            fontsize=7,
        )
    figure.colorbar(shown, ax=figure.axes[: _ROWS * _COLUMNS], shrink=0.4, label="score of the best angle")
    buffer = io.BytesIO()
    FigureCanvasAgg(figure).print_png(buffer)  # type: ignore[no-untyped-call]
    write_atomic(path, buffer.getvalue())


def _mark(axes: Axes, action: tuple[int, ...], colour: str) -> None:
    """The place of an action, and a line along its yaw."""
    i, j, k = action
    dx, dy = (_ARROW * f(2 * math.pi * k / ANGLES) for f in (math.cos, math.sin))
    axes.plot([j - dx, j + dx], [i - dy, i + dy], color=colour, linewidth=1.4)
    axes.plot([j], [i], "o", color=colour, markersize=3)
