"""Conditions over the columns of both tables: they mean what SQL says, and mistakes are named."""

from __future__ import annotations

import operator
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rema_data.errors import InputError
from rema_data.query import COLUMNS, steps_that_meet
from rema_data.release.folder import ReleaseFolder
from rema_data.testing import make_release

pytest.importorskip("duckdb", reason="conditions need DuckDB, part of the extra `query`")

Tables = list[tuple[Any, Any]]
OPERATORS: dict[str, Callable[[Any, Any], Any]] = {
    "<": operator.lt,
    "<=": operator.le,
    "==": operator.eq,
    "=": operator.eq,
    "<>": operator.ne,
    ">": operator.gt,
}
NUMBERS = ("lift_m", "k", "target_length_m", "tool0_length_m", "steps", "failed_step", "episode", "theta_rad")
TEXTS = ("target_shape", "task", "failure", "episode_failure", "skill")


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> Tables:
    folder: ReleaseFolder = make_release(
        tmp_path_factory.mktemp("data"), tasks=("grasp", "grasp_push"), rounds=(1, 2), episodes=10, success=0.6
    )
    return [(reader.episodes(), reader.steps()) for reader in map(folder.block, folder.manifest.blocks)]


@pytest.fixture(scope="module")
def joined(tables: Tables) -> pd.DataFrame:
    """Steps with their episode's columns, joined by pandas."""
    keys = ["task", "round", "split", "episode"]
    steps = pd.concat([steps.to_pandas() for _, steps in tables], ignore_index=True)
    episodes = pd.concat([episodes.to_pandas() for episodes, _ in tables], ignore_index=True)
    episodes = episodes.rename(columns={"success": "episode_success", "failure": "episode_failure"})
    return steps.merge(episodes, on=keys, how="left", validate="many_to_one")


def test_all_columns_of_both_tables_can_be_named(tables: Tables, joined: pd.DataFrame) -> None:
    assert set(COLUMNS) == set(joined.columns)
    for name in COLUMNS:
        met = steps_that_meet(f"{name} is not null", tables)
        assert np.array_equal(met, joined[name].notna()), name


@st.composite
def comparison(draw: st.DrawFn) -> tuple[str, str, str]:
    name = draw(st.sampled_from(NUMBERS + TEXTS))
    return name, draw(st.sampled_from(list(OPERATORS))), draw(st.sampled_from(["first", "last", "middle"]))


@given(one=comparison(), other=comparison(), link=st.sampled_from(["and", "or"]), negated=st.booleans())
def test_conditions_are_those_of_pandas(
    tables: Tables,
    joined: pd.DataFrame,
    one: tuple[str, str, str],
    other: tuple[str, str, str],
    link: str,
    negated: bool,
) -> None:
    """A comparison with null is neither true nor false."""
    texts, truths, knowns = [], [], []
    for name, sign, which in (one, other):
        values = joined[name].dropna().sort_values()
        value = values.iloc[{"first": 0, "last": -1, "middle": len(values) // 2}[which]]
        texts.append(f"{name} {sign} {value!r}" if name in TEXTS else f"{name} {sign} {float(value)!r}")
        known = joined[name].notna().to_numpy()
        truths.append(
            np.array([k and bool(OPERATORS[sign](v, value)) for k, v in zip(known, joined[name], strict=True)])
        )
        knowns.append(known)
    if negated:
        texts[0] = f"not ({texts[0]})"
        truths[0] = knowns[0] & ~truths[0]
    wanted = truths[0] & truths[1] if link == "and" else truths[0] | truths[1]
    assert np.array_equal(steps_that_meet(f" {link} ".join(texts), tables), wanted)


def _earlier(joined: pd.DataFrame) -> pd.Series:
    """The size of the target one step before, in the same task, in the order of seeds and steps."""
    ordered = joined.sort_values(["seed", "round", "split", "episode", "step"])
    return ordered.groupby("task")["target_length_m"].shift(1).reindex(joined.index)


@pytest.mark.parametrize(
    ("where", "as_pandas"),
    [
        (
            "target_x_m > avg(target_x_m) over (partition by task)",
            lambda t: t["target_x_m"] > t.groupby("task")["target_x_m"].transform("mean"),
        ),
        (
            "rank() over (partition by target_shape order by target_y_m desc) <= 3",
            lambda t: t.groupby("target_shape")["target_y_m"].rank(method="min", ascending=False) <= 3,
        ),
        (
            "target_length_m < lag(target_length_m) over "
            "(partition by task order by seed, round, split, episode, step)",
            lambda t: t["target_length_m"] < _earlier(t),
        ),
    ],
)
def test_a_condition_that_compares_a_step_with_others(
    tables: Tables, joined: pd.DataFrame, where: str, as_pandas: Callable[[pd.DataFrame], pd.Series]
) -> None:
    """DuckDB gives the rows of a window function in another order."""
    wanted = as_pandas(joined).to_numpy()
    assert 0 < wanted.sum() < len(wanted)
    assert np.array_equal(steps_that_meet(where, tables), wanted)


@pytest.mark.parametrize(
    ("where", "words"),
    [
        ("lift_mm < 0.1", ["there is no column 'lift_mm'", "lift_m"]),
        ("TARGET_SHAP = 'T'", ["there is no column 'TARGET_SHAP'", "target_shape"]),
        ('target_shape = "T"', ["there is no column 'T'", "single quotes"]),
        ("target_shape < 3", ["VARCHAR", "target_shape is string"]),
        ("lift_m < 'abc'", ["'abc'", "lift_m is float64"]),
        ("success and failure", ["failure is string"]),
        ("lift_m <", ["syntax error"]),
        ("", ["where=''"]),
        ("lift_m", ["not one condition a step: it gives double"]),
        ("success, last", ["not one condition a step"]),
        ("*", ["not one condition a step"]),
        ("avg(lift_m) > 0", ["not one condition a step", "avg(lift_m) over ()"]),
        ("lift_m > avg(lift_m)", ["not one condition a step", "avg(lift_m) over ()"]),
        ("unnest([true, false])", ["not one condition a step"]),
        ("true; select 1", ["where='true; select 1'"]),
        ("true from other", ["where="]),
        ("nonsense(lift_m)", ["nonsense"]),
        ("(select count(*) from read_csv('/etc/passwd')) > 0", ["disabled"]),
        ("(select count(*) from tables) > 0", ["tables"]),
    ],
)
def test_mistakes_are_named(tables: Tables, where: str, words: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        steps_that_meet(where, tables)
    assert all(word in str(caught.value) for word in words), str(caught.value)


def test_a_condition_writes_nothing(tables: Tables, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError):
        steps_that_meet("true); copy (select 1) to 'out.csv'; --", tables)
    assert not list(tmp_path.iterdir())


def test_without_duckdb_the_extra_is_named(tables: Tables, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "duckdb", None)
    with pytest.raises(InputError, match="needs DuckDB") as caught:
        steps_that_meet("last", tables)
    assert caught.value.hint == 'pip install "rema[query]"'
