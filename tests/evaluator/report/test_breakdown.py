"""Groups, places, the choice of episodes, and what fits into a page."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from evaluator.render.images import Photographs
from evaluator.report.breakdown import breakdowns, place_map, reached
from evaluator.report.gallery import MARKUP, Card, fit
from evaluator.report.scores import calibration
from evaluator.report.selection import SUCCESS, choose, spread
from evaluator.run.reading import read_run
from evaluator.run.run import Run
from evaluator.statistics import rate_interval


@pytest.fixture(scope="module")
def run(push_run: Path) -> Run:
    return read_run(push_run)


def test_every_table_divides_all_episodes(run: Run) -> None:
    rows = reached(run)
    tables = breakdowns(run)
    assert {"shape of the target", "length of the target's main bar", "yaw of the target's main bar"} <= {
        table.title for table in tables
    }
    for table in tables:
        assert sum(group.n for group in table.groups) == len(rows), table.title
        assert sum(group.successes for group in table.groups) == run.summary["successes"]
        assert table.reference == run.summary["success_rate"]
        for group in table.groups:
            assert (group.low, group.high) == rate_interval(group.successes, group.n)


def test_shapes_are_counted_one_by_one(run: Run) -> None:
    (table,) = [table for table in breakdowns(run) if table.title == "shape of the target"]
    for group in table.groups:
        rows = [row for row in run.rows if row["target_shape"] == group.label]
        assert (group.n, group.successes) == (len(rows), sum(row["success"] for row in rows))


def test_the_place_map_has_every_episode_in_its_cell(run: Run) -> None:
    found = place_map(run)
    assert found is not None
    assert sum(group.n for _, _, group in found.cells) == len(run.rows)
    size = 2 * found.half_m / found.bins
    for across, down, group in found.cells:
        left, top = across * size - found.half_m, found.half_m - down * size
        inside = [
            row for row in run.rows if left <= row["target_x_m"] < left + size and top - size <= row["target_y_m"] < top
        ]
        assert group.n == len(inside)


@given(st.integers(0, 200), st.integers(0, 20))
def test_spread_takes_rows_in_order_and_from_everywhere(length: int, count: int) -> None:
    rows = [{"index": number} for number in range(length)]
    chosen = [row["index"] for row in spread(rows, count)]
    assert len(chosen) == min(length, count)
    assert chosen == sorted(set(chosen))
    if 0 < count <= length:
        assert chosen[0] < length / count and chosen[-1] >= length - length / count - 1


def test_successes_come_first_then_the_commonest_failure(run: Run) -> None:
    chosen = choose(run, 2)
    labels = list(dict.fromkeys(one.label for one in chosen))
    assert labels == [SUCCESS, *run.summary["failures"]]
    for one in chosen:
        assert one.label == (SUCCESS if one.row["success"] else one.row["failure"])
    assert choose(run, 0) == []
    assert choose(run, 2) == chosen


@given(
    st.lists(st.tuples(st.integers(0, 3), st.integers(1, 50), st.integers(1, 50)), max_size=8), st.integers(0, 20_000)
)
def test_pictures_fit_and_stills_come_before_films(sizes: list[tuple[int, int, int]], room: int) -> None:
    cards = [
        Card("missed", rank, str(n), "push", (), None, Photographs("s" * still, None, "f" * film), "m")
        for n, (rank, still, film) in enumerate(sizes)
    ]
    kept = fit(cards, room)
    total = 0
    for card, before in zip(kept, cards, strict=True):
        shown = card.photographs
        total += len(card.action_map or "") + (0 if shown is None else len(shown.before) + len(shown.film or ""))
        assert (card.photographs is None) == ("photographs" in card.left_out)
        assert (shown is not None and shown.film is None) <= ("animation" in card.left_out)
        assert card.facts == before.facts and card.scenario == before.scenario
    assert total <= room
    if any(card.left_out for card in kept):
        assert room < sum(still + film + 1 + 3 * MARKUP for _, still, film in sizes)


@given(st.lists(st.tuples(st.floats(0, 1), st.booleans()), max_size=60))
def test_calibration_puts_every_episode_into_one_bin(answers: list[tuple[float, bool]]) -> None:
    rows = [{"step0_success": success} for _, success in answers]
    bins = calibration(rows, 0, [score for score, _ in answers])
    assert sum(bin_.group.n for bin_ in bins) == len(answers)
    assert sum(bin_.group.successes for bin_ in bins) == sum(success for _, success in answers)
    assert all(0 <= bin_.score <= 1 for bin_ in bins)
    means = [bin_.score for bin_ in bins]
    assert means == sorted(means)
