"""From a run folder to a page: read, play some episodes again, ask the policy where it is named, write."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from evaluator.protocol import protocol_hash
from evaluator.report import content
from evaluator.report.breakdown import breakdowns, place_map
from evaluator.report.selection import choose, spread
from evaluator.run.cells import score
from evaluator.run.plan import scenario_list
from evaluator.run.reading import read_run
from evaluator.run.run import Run
from evaluator.statistics import percent
from rema_data.errors import InputError, RemaError
from rema_data.progress import Progress, Silent
from rema_data.storage import write_atomic

if TYPE_CHECKING:
    from evaluator.policy.loading import PolicySpec
    from evaluator.report.gallery import Card
    from rema_data.schema import Scenario

__all__ = ["PAGE_NAME", "ReportOptions", "WrittenReport", "write_report"]

PAGE_NAME = "report.html"
_SECTIONS = {
    "result": "Result",
    "failures": "Failures",
    "groups": "Groups",
    "place": "Place",
    "suite": "Suite",
    "gallery": "Episodes",
    "scores": "Scores",
    "timings": "Timings",
    "provenance": "Provenance",
}


@dataclass(frozen=True, slots=True)
class ReportOptions:
    """What goes into a page."""

    per_label: int = 3  # episodes of the gallery of every label, at most; 0 for no gallery
    limit_bytes: int = 15_000_000  # of the page: pictures are left out, animations first, where it would be larger
    policy: PolicySpec | None = None  # the policy of the run, to be asked for its scores
    checkpoint: Path | None = None  # this, ``device`` and ``sandbox`` as for ``rema evaluate``
    device: str = "cpu"
    scored: int = 200  # episodes whose scores are compared with their outcomes
    sandbox: str | None = None


@dataclass(frozen=True, slots=True)
class WrittenReport:
    """A page on the disk."""

    path: Path
    size: int  # bytes
    shown: int  # episodes of the gallery
    agreement: Mapping[str, int]  # how many replayed episodes were ``identical``, ``same label`` or ``different``
    scored: int  # episodes of the calibration
    left_out: int  # pictures that there was no room for


def write_report(
    run: Path, output: Path | None = None, options: ReportOptions | None = None, progress: Progress | None = None
) -> WrittenReport:
    """Write the page of a finished run: the same bytes for the same run on the same installation.

    ``output`` is ``report.html`` in the run folder by default. Raises what ``read_run`` raises, MissingFileError
    without the weights, InputError without the extra ``report``, RunMismatchError where the policy is not that of the
    run, and SubmissionError where the policy gives no maps.
    """
    options, progress = options or ReportOptions(), progress or Silent()
    finished = read_run(run)
    try:
        from evaluator.render.images import FILM, MAP_PIXELS, PHOTO
        from evaluator.render.words import FAILURES
        from evaluator.report.gallery import fit
        from evaluator.report.page import render
    except ImportError as error:
        raise InputError(
            f"reports need {error.name}, which is not installed", hint='pip install "rema[report]"'
        ) from error
    cards, said = _pictures(finished, options, progress)
    said |= {**_words(finished), **_gallery_words(finished, cards, options.per_label)}
    said |= {"meaning": FAILURES, "photo": PHOTO, "film": FILM, "map": MAP_PIXELS}
    bare = len(render({**said, "cards": fit(cards, 0)}).encode())
    cards = fit(cards, options.limit_bytes - bare)
    page = render({**said, "cards": cards}).encode()
    path = output or run / PAGE_NAME
    write_atomic(path, page)
    agreement = Counter(card.agreement for card in cards if card.agreement)
    left_out = sum(len(card.left_out) for card in cards)
    return WrittenReport(path, len(page), len(cards), dict(agreement), said["scored"], left_out)


def _words(run: Run) -> dict[str, Any]:
    """Everything on the page that comes from the run's own tables."""
    place = place_map(run)
    lost = Counter(row["infra_error"] for row in run.rows if row["infra_error"] is not None)
    many = (
        "There are many rows: a few of them look unusual by chance alone. The dashed line is the rate of all episodes "
        "of a table."
    )
    if run.end_to_end and len(run.steps) > 1:
        many = (
            "Properties of the target are about the episodes that reached the last step, those of tools about all of "
            f"them. {many}"
        )
    suite = score(run) if run.suite else None
    absent = {key for key, found in (("place", place), ("suite", suite)) if found is None}
    sections = [(key, name) for key, name in _SECTIONS.items() if key not in absent]
    rate = "no rate" if run.counts.rate is None else percent(run.counts.rate) + " %"
    return {
        "title": f"{run.policy} on {run.task}: {rate}",
        "run": run,
        "tag": run.tag,
        "sections": sections,
        "remarks": content.remarks(run),
        "funnel": content.funnel(run),
        "failures": content.failures(run),
        "faults": content.faults(run),
        "lost": sorted(lost.items(), key=lambda item: (-item[1], item[0])),
        "breakdowns": breakdowns(run),
        "groups_note": many,
        "place": place,
        "suite": suite,
        "timings": content.timings(run),
        "provenance": content.provenance(run),
        "segments": content.segments(run),
        "criteria": content.criteria(run),
    }


def _gallery_words(run: Run, cards: Sequence[Card], per_label: int) -> dict[str, Any]:
    """What the page says about the cards."""
    from rema_data.pictures import LEGEND

    totals = {"success": run.counts.successes, **run.counts.failures}
    shown = Counter(card.label for card in cards)
    seen = Counter(card.agreement for card in cards if card.agreement)
    note = (
        f"Up to {per_label} of every label, spread over the list, played again from the recorded actions where this "
        f"page was made: of {seen.total()}, {seen['identical']} were the same to the last digit"
    )
    if seen["same label"]:
        note += f", {seen['same label']} had the same label with other measurements"
    note += f", and {seen['different']} differed."
    if protocol_hash(run.task, run.protocol) != run.provenance.protocol_hash:
        note += " This installation has another protocol than the run: expect differences."
    return {
        "gallery_note": note,
        "labels": [(label, count, totals.get(label, count)) for label, count in shown.items()],
        "legend": [("#{:02x}{:02x}{:02x}".format(*colour), text) for colour, text in LEGEND],
        "animated": any(card.photographs and card.photographs.film for card in cards),
    }


def _pictures(run: Run, options: ReportOptions, progress: Progress) -> tuple[list[Card], dict[str, Any]]:
    """The cards of the gallery, and the calibration for the page; or why they are missing."""
    from evaluator.policy.loading import weights_of
    from evaluator.report.gallery import make_cards
    from evaluator.report.scores import check_policy

    if (policy := options.policy) is not None:
        options = replace(options, checkpoint=weights_of(policy, options.checkpoint, run.task))
        check_policy(run, policy, options.checkpoint)
    said: dict[str, Any] = {"gallery_reason": "", "bins": [], "scored": 0}
    try:
        scenarios = scenario_list(run.header).scenarios
    except RemaError as error:
        reason = f"Episodes cannot be played again here: {error.message}."
        return [], {**said, "gallery_reason": reason, "scores_note": reason}
    chosen = choose(run, options.per_label)
    cards = make_cards(run, scenarios, chosen, progress) if chosen else []
    if not chosen:
        said["gallery_reason"] = "No episode is shown: none was asked for, or none was measured."
    if policy is not None:
        return cards, said | _scores(run, scenarios, options, policy, cards, progress)
    said["scores_note"] = (
        "A run records actions and no scores. Name its policy (--policy, and --checkpoint where it has one) to see "
        "the maps and the calibration of one that has them."
    )
    return cards, said


def _scores(
    run: Run,
    scenarios: Sequence[Scenario],
    options: ReportOptions,
    policy: PolicySpec,
    cards: list[Card],
    progress: Progress,
) -> dict[str, Any]:
    """The calibration for the page; the cards get their maps."""
    from evaluator.report.gallery import with_scores
    from evaluator.report.scores import ask_scores, calibration

    step = run.steps[0]  # its situation depends on the scenario alone
    rows = [row for row in run.measured if row[f"step{step}_action"] is not None]
    rows = spread([row for row in rows if row[f"step{step}_success"] is not None], options.scored)
    questions = [(card.take.situation, card.take.action) for card in cards if card.take is not None]
    shown = len(questions)
    for row in rows:
        scenario = scenarios[row["index"]]
        situation = scenario.first_situation() if run.end_to_end else scenario.last_situation()
        questions.append((situation, row[f"step{step}_action"]))
    progress.phase("ask", len(questions))
    answers = []
    if questions:
        policy_options = (options.checkpoint, options.device, options.sandbox)
        answers = ask_scores(
            policy, questions, *policy_options, protocol=run.protocol, run=run.source, note=progress.note
        )
    progress.advance(len(questions))
    for n, answer in zip((n for n, card in enumerate(cards) if card.take is not None), answers, strict=False):
        cards[n] = with_scores(cards[n], answer)
    scores = [answer.chosen for answer in answers[shown:]]
    if not all(0 <= score <= 1 for score in scores):
        note = "The policy's scores are not shares between 0 and 1: there is no calibration to show."
        return {"scores_note": note}
    note = (
        f"The run recorded no scores: the policy was asked again about {len(rows):,} episodes, spread over the list, "
        f"and about those above. The scores are those of step {content.step_name(run.task, step)}."
    )
    return {"bins": calibration(rows, step, scores), "scores_note": note, "scored": len(rows)}
