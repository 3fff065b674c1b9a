"""``iter_episodes``: the records of ``episode``, one after the other."""

from __future__ import annotations

import itertools
from typing import Any

import pytest

import rema_data
from rema_data.errors import InputError, MissingFileError
from rema_data.loader import episodes as module
from rema_data.release.folder import ReleaseFolder
from rema_data.schema import Episode


def name(episode: Episode) -> tuple[int, str, str, int]:
    return episode.round, episode.task, episode.split, episode.index


@pytest.mark.parametrize("piece", [1, 3, 256])
def test_every_episode_whole_and_in_order(
    release: rema_data.Release, monkeypatch: pytest.MonkeyPatch, piece: int
) -> None:
    monkeypatch.setattr(module, "_PIECE", piece)
    found = list(release.iter_episodes())
    rows = release.episodes[["round", "task", "split", "episode"]].itertuples(index=False)
    assert [name(episode) for episode in found] == [tuple(row) for row in rows]
    for episode in found:
        assert equal(episode, release.episode(*name(episode)))


def equal(a: Episode, b: Episode) -> bool:
    """Whether two records are the same, with the bytes of their observations."""
    return repr(a) == repr(b) and all(
        one.observation.scene.tobytes() == other.observation.scene.tobytes()
        and one.observation.depth.tobytes() == other.observation.depth.tobytes()
        and one.observation.mask.tobytes() == other.observation.mask.tobytes()
        for one, other in zip(a.steps, b.steps, strict=True)
    )


@pytest.mark.parametrize(
    "options", [{"tasks": ["grasp"]}, {"split": "val"}, {"rounds": 2}, {"tasks": ["grasp_push"], "rounds": [1]}]
)
def test_filters_are_those_of_steps(release: rema_data.Release, options: dict[str, Any]) -> None:
    table = release.steps(**options, which="all").table
    wanted = dict.fromkeys(zip(table["round"], table["task"], table["split"], table["episode"], strict=True))
    assert [name(episode) for episode in release.iter_episodes(**options)] == list(wanted)


def test_a_condition_keeps_whole_episodes(release: rema_data.Release) -> None:
    pytest.importorskip("duckdb", reason="conditions need DuckDB, part of the extra `query`")
    picked = [name(episode) for episode in release.iter_episodes(where="step = 1 and success", split="train")]
    wanted = [
        name(episode)
        for episode in release.iter_episodes(split="train")
        if len(episode.steps) > 1 and episode.steps[1].outcome.success
    ]
    assert picked == wanted and len(picked) > 0
    assert list(release.iter_episodes(where="k > 15")) == []
    with pytest.raises(InputError, match="no column 'sucess'"):
        release.iter_episodes(where="sucess")


def test_it_is_lazy(release: rema_data.Release, monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[str] = []
    plain = ReleaseFolder.block

    def block(self: ReleaseFolder, entry: Any) -> Any:
        read.append(entry.key.path)
        return plain(self, entry)

    release.cache  # noqa: B018
    monkeypatch.setattr(ReleaseFolder, "block", block)
    episodes = release.iter_episodes()
    assert len(list(itertools.islice(episodes, 3))) == 3 and len(read) == 1


def test_mistakes_are_errors_at_once(small: ReleaseFolder) -> None:
    release = rema_data.Release(small, cache="memory")
    with pytest.raises(InputError, match="has no task fly"):
        release.iter_episodes(tasks=["fly"])
    (small.path / "round-1" / "push" / "val" / "steps.parquet").unlink()
    with pytest.raises(MissingFileError, match="1 blocks of tiny are missing or not whole on this machine"):
        release.iter_episodes()
    assert len(list(release.iter_episodes(tasks=["grasp"]))) > 0
