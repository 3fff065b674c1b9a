"""The layout of a preview: two photographs, the scene map with the action, the end-effector maps, a caption.

Imports matplotlib and pillow, which belong to the extra ``report``; ``preview.py`` says so when they are missing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pybullet_data
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from matplotlib.patheffects import withStroke
from PIL import Image

from evaluator.render.preview import EVIDENCE, Played, markers, touching
from evaluator.render.studio import Studio
from evaluator.sim.kinds import kind_of
from evaluator.sim.observation import SLAB_M, end_effector_states, observe
from evaluator.sim.parameters import WORLD
from evaluator.sim.planar import Rect
from rema_data import grid
from rema_data.schema import HEIGHT_STEP_M, Observation

__all__ = ["HEIGHT", "WIDTH", "draw"]

WIDTH, HEIGHT = 1280, 900
_PHOTO = (636, 477)
_OVERSAMPLING = 2
_GREEN, _RED, _INK = "#1a7f37", "#b42318", "#1f2328"
_PIXEL_MM = grid.PIXEL_M * 1000


def draw(played: Played, title: str) -> npt.NDArray[np.uint8]:
    """The picture of a played step.

    Parameters
    ----------
    played : Played
    title : str

    Returns
    -------
    uint8 (900, 1280, 3)
    """
    figure = Figure(figsize=(WIDTH / 100, HEIGHT / 100), dpi=100, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    observation = observe(played.situation)
    photos = _photographs(played)
    captions = ("before", _after(played))
    for number, (photo, caption) in enumerate(zip(photos, captions, strict=True)):
        axes = _axes(figure, 2 + number * 640, 48, *_PHOTO)
        axes.imshow(photo, interpolation="none", aspect="auto")
        axes.set_axis_off()
        _label(figure, 14 + number * 640, 54, caption, size=11, weight="bold", box=True)
    _header(figure, played, title)
    _scene(figure, played, observation)
    _end_effector(figure, observation)
    _caption(figure, played)
    canvas.draw()  # type: ignore[no-untyped-call]
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()  # type: ignore[no-untyped-call]


def _photographs(played: Played) -> list[npt.NDArray[np.uint8]]:
    studio = Studio(pybullet_data.getDataPath())
    size = _PHOTO[0] * _OVERSAMPLING, _PHOTO[1] * _OVERSAMPLING
    shown = markers(played.situation, played.action)
    try:
        return [
            np.asarray(Image.fromarray(studio.photograph(shot, shown, size)).resize(_PHOTO, Image.Resampling.BOX))
            for shot in (played.before, played.after)
        ]
    finally:
        studio.close()


def _after(played: Played) -> str:
    if played.outcome.success:
        return "after"
    label = played.outcome.failure
    return f"after: {'failed' if label is None else str(label).replace('_', ' ')}"


def _header(figure: Figure, played: Played, title: str) -> None:
    outcome = played.outcome
    colour = _GREEN if outcome.success else _RED
    _label(figure, 14, 13, title, size=15, weight="bold")
    word = "SUCCESS" if outcome.success else f"FAILED: {outcome.failure}"
    figure.text(1 - 14 / WIDTH, 1 - 24 / HEIGHT, word, color=colour, size=15, weight="bold", ha="right", va="center")


def _scene(figure: Figure, played: Played, observation: Observation) -> None:
    """Scene map in world directions: x to the right, y up."""
    axes = _axes(figure, 54, 562, 290, 290)
    half = grid.SCENE_HALF_M * 1000
    axes.imshow(
        observation.scene * HEIGHT_STEP_M * 1000,
        origin="lower",
        extent=(-half, half, -half, half),
        cmap="Greys",
        vmin=0,
        vmax=60,
        interpolation="none",
    )
    edge = half - grid.VALID_MARGIN * _PIXEL_MM
    corners = [(-edge, -edge), (edge, -edge), (edge, edge), (-edge, edge)]
    axes.add_patch(Polygon(corners, closed=True, fill=False, ec="#c9372c", lw=1.2, ls=(0, (4, 2))))
    x, y, yaw = (float(value) for value in grid.to_world(played.action))
    way = kind_of(played.situation).reach_shifts(WORLD)[-1]
    for part in end_effector_states(played.situation)[0]:
        colour = "#1f6feb" if part.allowed else "#8b949e"
        _outline(axes, part.rect.moved(x, y, yaw), colour, 1.4)
        if way:
            _outline(axes, part.rect.moved(x + way, y, yaw), colour, 0.8)
    mm = (x * 1000, y * 1000)
    halo = [withStroke(linewidth=3.2, foreground="white")]
    arrow: dict[str, Any] = {"arrowstyle": "-|>", "lw": 1.8, "color": "#d97706", "path_effects": halo}
    if way:
        end = min(mm[0] + way * 1000, half - 2)  # most pushes leave the map
        axes.annotate("", (end, mm[1]), mm, arrowprops=arrow)
        line = (played.situation.target.x_m + WORLD.push_success_m) * 1000
        if line < half:
            axes.plot([line, line], [-half, half], color=_GREEN, lw=1.6)
    tip = (mm[0] + 34 * math.cos(yaw), mm[1] + 34 * math.sin(yaw))
    axes.plot([mm[0], tip[0]], [mm[1], tip[1]], color="#d97706", lw=1.6, path_effects=halo, solid_capstyle="round")
    axes.plot(*mm, marker="o", ms=6, mfc="#d97706", mec="white")
    axes.set_xlim(-half, half)
    axes.set_ylim(-half, half)
    axes.set_xticks([-100, 0, 100])
    axes.set_yticks([-100, 0, 100])
    axes.tick_params(labelsize=8, length=3)
    axes.set_xlabel("x, mm (push direction)", size=8, labelpad=1)
    axes.set_ylabel("y, mm", size=8, labelpad=-4)
    axes.set_title("scene map, 64 x 64, and the action", size=9.5, pad=4)


def _end_effector(figure: Figure, observation: Observation) -> None:
    """The four planes of the end-effector map, at 2 screen pixels a map pixel."""
    half = grid.EE_HALF_M * 1000
    names = ("state 1: depth", "state 1: mask", "state 2: depth", "state 2: mask")
    planes = (observation.depth[0], observation.mask[0], observation.depth[1], observation.mask[1])
    for number, (name, plane) in enumerate(zip(names, planes, strict=True)):
        mask = bool(number % 2)
        axes = _axes(figure, 372 + number * 227, 562, 220, 220)
        axes.imshow(
            plane,
            origin="lower",
            extent=(-half, half, -half, half),
            cmap=ListedColormap(["white", "#1f6feb"]) if mask else "Greys",
            vmin=0,
            vmax=1 if mask else SLAB_M / HEIGHT_STEP_M * 1.3,
            interpolation="none",
        )
        axes.plot(0, 0, marker="+", ms=7, color="#d97706", mew=1.2)
        axes.set_xticks([])
        axes.set_yticks([])
        axes.set_title(f"{name}, 112 x 112", size=9.5, pad=4)
        for side in axes.spines.values():
            side.set_color("#8b949e")


def _caption(figure: Figure, played: Played) -> None:
    situation, outcome = played.situation, played.outcome
    i, j, k = (int(value) for value in grid.decode(played.action))
    x, y, yaw = (float(value) for value in grid.to_world(played.action))
    arm = {"both": "both arms", "none": "no arm"}.get(outcome.arm, f"the {outcome.arm} arm")
    lines = [
        f"step {situation.step + 1}: {situation.kind.primitive}; {touching(situation)} may touch the target "
        f"(red, {situation.target.spec.shape})",
        f"action i={i} j={j} k={k}: x {x * 1000:+.1f} mm, y {y * 1000:+.1f} mm, {math.degrees(yaw):g} degrees; {arm}",
        _evidence(played),
    ]
    for number, text in enumerate(lines):
        _label(figure, 372, 798 + number * 26, text, size=11.5)


def _evidence(played: Played) -> str:
    outcome, situation = played.outcome, played.situation
    if outcome.failure is not None and outcome.failure in EVIDENCE:
        first = EVIDENCE[outcome.failure]
    elif kind_of(situation).measure == "displacement_m":
        first = f"moved {outcome.displacement_m * 100:.1f} cm in +x ({WORLD.push_success_m * 100:.0f} needed)"
    else:
        first = f"lifted {outcome.lift_m * 100:.1f} cm"
    parts = [first]
    if outcome.failure is not None and outcome.displacement_m:
        parts.append(f"moved {outcome.displacement_m * 100:+.1f} cm in x")
    if outcome.failure is not None and outcome.lift_m:
        parts.append(f"lifted {outcome.lift_m * 100:.1f} cm")
    if outcome.peak_force_n >= 0.5:
        parts.append(f"{outcome.peak_force_n:.0f} N at most in the descent")
    parts.append(f"{outcome.sim_steps} simulation steps")
    return "; ".join(parts)


def _axes(figure: Figure, left: float, top: float, width: float, height: float) -> Any:
    """Axes at a place in pixels from the top left corner."""
    return figure.add_axes((left / WIDTH, 1 - (top + height) / HEIGHT, width / WIDTH, height / HEIGHT))


def _label(
    figure: Figure, left: float, top: float, text: str, size: float, weight: str = "normal", box: bool = False
) -> None:
    frame = {"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 3} if box else None
    figure.text(
        left / WIDTH, 1 - top / HEIGHT, text, size=size, weight=weight, color=_INK, ha="left", va="top", bbox=frame
    )


def _outline(axes: Any, rect: Rect, colour: str, width: float) -> None:
    c, s = math.cos(rect.yaw), math.sin(rect.yaw)
    corners: Sequence[tuple[float, float]] = [
        ((rect.x + c * a - s * b) * 1000, (rect.y + s * a + c * b) * 1000)
        for a, b in (
            (rect.half_x, rect.half_y),
            (-rect.half_x, rect.half_y),
            (-rect.half_x, -rect.half_y),
            (rect.half_x, -rect.half_y),
        )
    ]
    axes.add_patch(Polygon(corners, closed=True, fill=False, ec=colour, lw=width))
