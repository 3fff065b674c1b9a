"""The cards of the gallery: one an episode, with pictures, maps, the action and the evidence."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from evaluator.render.film import FilmMaker, Take, agreement
from evaluator.render.images import Photographs, draw_action, draw_scores, photograph
from evaluator.render.studio import Studio
from evaluator.render.words import FAILURES, measured_text, touching_text
from evaluator.report.scores import Scored
from evaluator.report.selection import Chosen
from evaluator.run.run import Row, Run
from rema_data.interrupts import check
from rema_data.pictures import action_text
from rema_data.progress import Progress
from rema_data.schema import TASKS, Action, Failure, Scenario

__all__ = ["MARKUP", "Card", "fit", "make_cards", "with_scores"]

MARKUP = 700
"""Bytes of the elements around a picture, at most."""


@dataclass(frozen=True, slots=True)
class Card:
    """An episode to look at."""

    label: str  # this and ``rank`` as in ``Chosen``
    rank: int
    scenario: str
    step: str  # the step that is shown, in words
    facts: Sequence[tuple[str, str]]
    take: Take | None = None  # None where nothing could be played again
    photographs: Photographs | None = None
    action_map: str | None = None  # this and ``score_map`` are ``data:`` addresses
    score_map: str | None = None
    agreement: str = ""  # of this machine with the record (``film.agreement``); empty where nothing was played again
    again: str = ""  # how the step ended this time
    left_out: Sequence[str] = field(default=())  # pictures that there was no room for


def make_cards(run: Run, scenarios: Sequence[Scenario], chosen: Sequence[Chosen], progress: Progress) -> list[Card]:
    """Play the chosen episodes again and picture them."""
    progress.phase("play again", len(chosen))
    faults = {fault["index"]: fault for fault in run.faults()}
    cards = []
    with FilmMaker() as films, Studio() as studio:
        for one in chosen:
            if one.label == Failure.POLICY_ERROR:
                cards.append(_without_action(run, one, faults.get(one.row["index"], {})))
            else:
                take = _played_again(films, run, scenarios[one.row["index"]], one.row)
                cards.append(_card(run, one, take, photograph(studio, take)))
            progress.advance(1)
            check()
    return cards


def _played_again(films: FilmMaker, run: Run, scenario: Scenario, row: Row) -> Take:
    """The step at which an episode was decided, or at which it now goes another way."""
    return films.play(scenario, run.protocol, lambda situation: row[f"step{situation.step}_action"], row["failed_step"])


def _card(run: Run, one: Chosen, take: Take, photographs: Photographs) -> Card:
    again = "success" if take.outcome.failure is None else str(take.outcome.failure.value).replace("_", " ")
    return Card(
        one.label,
        one.rank,
        one.row["scenario"],
        _step_text(run, take.situation.step),
        _facts(one.row, take),
        take,
        photographs,
        draw_action(take.situation, take.action),
        None,
        agreement(one.row, take),
        again,
    )


def _without_action(run: Run, one: Chosen, fault: Mapping[str, str]) -> Card:
    """The card of an episode in which the policy gave no action."""
    step = run.steps[-1] if one.row["failed_step"] is None else one.row["failed_step"]
    facts = [("what happened", str(fault.get("reason", "no action")).replace("_", " "))]
    if fault.get("detail"):
        facts.append(("its message", str(fault["detail"])))
    return Card(one.label, one.rank, one.row["scenario"], _step_text(run, step), facts)


def _step_text(run: Run, step: int) -> str:
    kinds = TASKS[run.task]
    number = f"step {step + 1} of {len(kinds)}: " if len(kinds) > 1 else ""
    return f"{number}{kinds[step].primitive.value}"


def _facts(row: Row, take: Take) -> list[tuple[str, str]]:
    """What was done and what was recorded of it."""
    situation, action = take.situation, Action(take.action)
    spec, step = situation.target.spec, situation.step
    arm = row[f"step{step}_arm"]
    across = f", second bar {spec.arm_m * 100:.1f} cm" if spec.arm_m else ""
    facts = [
        ("target (red)", f"{spec.shape.value}, {spec.length_m * 100:.1f} x {spec.width_m * 100:.1f} cm{across}"),
        ("may touch it", touching_text(situation.kind)),
        ("action", action_text(action.cell, action.pose)),
    ]
    if arm in ("left", "right", "both"):
        facts.append(("acting", "both arms" if arm == "both" else f"{arm} arm"))
    label = row[f"step{step}_failure"]
    if label in FAILURES:
        facts.append(("why it failed", FAILURES[label]))
    measured = {name: row[f"step{step}_{name}"] for name in ("displacement_m", "lift_m", "peak_force_n", "sim_steps")}
    facts.append(("recorded", measured_text(situation.kind, measured)))
    return facts


def with_scores(card: Card, scored: Scored) -> Card:
    """The card with the map of the policy's scores."""
    assert card.take is not None
    words = f"{scored.chosen:.3f} for the chosen action, {np.nanmax(scored.best):.3f} is the highest of the map"
    return replace(
        card, score_map=draw_scores(scored.best, card.take.action), facts=[*card.facts, ("the policy's score", words)]
    )


def fit(cards: Sequence[Card], room: int) -> list[Card]:
    """The cards with as many pictures as fit in ``room`` bytes, with ``MARKUP`` for each.

    Photographs come before maps and maps before animations, and the first cards of every label before the second ones.
    """
    pictures = ((order, card.rank, n, name, size) for n, card in enumerate(cards) for order, name, size in _sizes(card))
    kept: set[tuple[int, str]] = set()
    for _, _, position, name, size in sorted(pictures):
        if size + MARKUP <= room:
            room -= size + MARKUP
            kept.add((position, name))
    return [_keep(card, [name for _, name, _ in _sizes(card) if (n, name) in kept]) for n, card in enumerate(cards)]


def _sizes(card: Card) -> Iterable[tuple[int, str, int]]:
    """Priority, name and bytes of every picture of a card."""
    photographs = card.photographs
    if photographs is not None:
        yield 0, "photographs", len(photographs.before) + len(photographs.after or "")
        if photographs.film is not None:
            yield 2, "animation", len(photographs.film)
    for name, picture in (("map of the action", card.action_map), ("map of the scores", card.score_map)):
        if picture is not None:
            yield 1, name, len(picture)


def _keep(card: Card, names: Sequence[str]) -> Card:
    photographs = card.photographs if "photographs" in names else None
    if photographs is not None and "animation" not in names:
        photographs = replace(photographs, film=None)
    return replace(
        card,
        photographs=photographs,
        action_map=card.action_map if "map of the action" in names else None,
        score_map=card.score_map if "map of the scores" in names else None,
        left_out=[name for _, name, _ in _sizes(card) if name not in names],
    )
