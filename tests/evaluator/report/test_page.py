"""The page: right numbers, nothing from outside, no script of a policy runs, the same bytes twice."""

from __future__ import annotations

import base64
import io
import json
import re
from pathlib import Path

import pytest
from PIL import Image

from evaluator.report import ReportOptions, WrittenReport, write_report
from evaluator.run.reading import read_run
from evaluator.statistics import percent, rate_interval
from tests.evaluator.fakes import fake_backend, fake_config, write_fake_list
from tests.evaluator.report.conftest import EPISODES, HOSTILE_NAME, HOSTILE_WORDS
from tests.evaluator.report.pages import Page


@pytest.fixture(scope="module")
def page(push_report: WrittenReport) -> Page:
    return Page(push_report.path)


def test_nothing_comes_from_outside(push_report: WrittenReport, page: Page) -> None:
    for _, attributes in page.elements:
        for name in ("src", "href", "srcset", "data", "poster", "action", "xlink:href"):
            address = attributes.get(name)
            assert address is None or address.startswith(("data:image/", "#")), address
    text = push_report.path.read_text(encoding="utf-8")
    assert "url(" not in text and "@import" not in text
    policy = next(meta["content"] for meta in page.all("meta") if meta.get("http-equiv") == "Content-Security-Policy")
    assert policy is not None and policy.startswith("default-src 'none'; img-src data:;")
    assert "unsafe" not in policy


def test_links_lead_somewhere(page: Page) -> None:
    places = {attributes.get("id") for _, attributes in page.elements}
    links = [attributes["href"] for attributes in page.all("a")]
    assert links and {link.removeprefix("#") for link in links if link} <= places


def test_numbers_are_those_of_the_summary(push_run: Path, page: Page) -> None:
    summary = json.loads((push_run / "summary.json").read_text())
    assert 0 < summary["successes"] < summary["eligible"] == EPISODES
    low, high = summary["ci95"]
    rate = f"{percent(summary['success_rate'])} % [{percent(low)}, {percent(high)}]"
    assert f"{rate} {summary['successes']} of {summary['eligible']} eligible episodes" in page.text
    assert len(summary["failures"]) >= 3
    for label, count in summary["failures"].items():
        low, high = rate_interval(count, EPISODES)
        numbers = f"{count} {percent(count / EPISODES)} % [{percent(low)}, {percent(high)}]"
        assert re.search(rf"{label.replace('_', ' ')} .{{5,80}} {re.escape(numbers)}", page.text), numbers
    for name in ("policy_digest", "protocol_hash", "scenarios_hash"):
        assert summary[name] in page.text


def test_what_a_policy_said_is_escaped(push_report: WrittenReport, page: Page) -> None:
    assert HOSTILE_NAME in page.text and HOSTILE_WORDS in page.text
    assert len(page.scripts) == 1 and "alert" not in page.scripts[0]
    assert not [attributes for _, attributes in page.elements if any(name.startswith("on") for name in attributes)]
    assert "<img src=x" not in push_report.path.read_text(encoding="utf-8")


def test_every_label_has_a_card_and_every_picture_says_what_it_is(push_run: Path, page: Page) -> None:
    summary = json.loads((push_run / "summary.json").read_text())
    cards = [attributes["data-label"] for attributes in page.all("article")]
    assert sorted(filter(None, cards)) == sorted(["success", *summary["failures"]])
    pictures = page.all("img")
    assert len(pictures) >= 4 * (len(cards) - 1)
    for picture in pictures:
        assert picture["alt"] and picture["width"] and picture["height"]
    assert len({picture["src"] for picture in pictures}) == len(pictures)


def test_every_part_of_the_page_is_there(push_run: Path, page: Page) -> None:
    """Breakdowns that divide all episodes, maps of places, where the time went, and who computed it."""
    for words in ("shape", "yaw", "length", "before", "after", "with the chosen action", "animation"):
        assert words in page.text.lower() or any(words in str(one["alt"]).lower() for one in page.all("img")), words
    for phase in ("observe", "infer", "simulate"):
        assert re.search(rf"{phase}\D{{1,40}}\d", page.text), phase
    segment = json.loads((push_run / "run.json").read_text())["segments"][0]
    for fact in (
        segment["machine"]["processor"],
        f"pybullet {segment['versions']['pybullet']}",
        json.loads((push_run / "run.json").read_text())["seal"],
    ):
        assert fact in page.text


def test_animations_move(page: Page) -> None:
    moving = []
    for picture in page.all("img"):
        data = base64.b64decode(str(picture["src"]).partition("base64,")[2])
        with Image.open(io.BytesIO(data)) as image:
            image.load()
            moving.append(getattr(image, "n_frames", 1))
    assert sorted(set(moving))[0] == 1 and sum(frames > 1 for frames in moving) >= 3


def test_real_episodes_come_out_as_recorded(push_run: Path, push_report: WrittenReport) -> None:
    labels = json.loads((push_run / "summary.json").read_text())["failures"]
    assert push_report.agreement == {"identical": len(labels)}  # and one success, less the silent policy
    assert push_report.left_out == 0
    assert push_report.size == push_report.path.stat().st_size


def test_the_same_run_gives_the_same_bytes(push_run: Path, push_report: WrittenReport, tmp_path: Path) -> None:
    again = write_report(push_run, tmp_path / "again.html", ReportOptions(per_label=1))
    assert again.path.read_bytes() == push_report.path.read_bytes()


def test_a_small_page_leaves_pictures_out_and_says_so(
    push_run: Path, push_report: WrittenReport, tmp_path: Path
) -> None:
    limit = push_report.size - 3_000
    small = write_report(push_run, tmp_path / "small.html", ReportOptions(per_label=1, limit_bytes=limit))
    assert small.size <= limit and small.left_out > 0
    assert "Left out to keep the page small: animation" in Page(small.path).text
    tiny = write_report(push_run, tmp_path / "tiny.html", ReportOptions(per_label=1, limit_bytes=1))
    assert not Page(tiny.path).all("img")


def test_no_gallery_on_request(push_run: Path, tmp_path: Path) -> None:
    written = write_report(push_run, tmp_path / "page.html", ReportOptions(per_label=0))
    page = Page(written.path)
    assert written.shown == 0 and not page.all("article") and not page.all("img")
    assert "No episode is shown" in page.text


def test_without_its_scenario_list_the_page_says_why_it_has_no_pictures(
    push_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path / "nothing"))
    written = write_report(push_run, tmp_path / "page.html")
    assert "Episodes cannot be played again here: " in Page(written.path).text


def test_another_scenario_list_is_not_played(push_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_fake_list(tmp_path, "push", EPISODES)
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path))
    written = write_report(push_run, tmp_path / "page.html")
    assert written.shown == 0
    assert "another scenario list than the ones here" in Page(written.path).text


def test_an_episode_that_differs_says_so(fake_home: Path, installation: Path) -> None:
    """The fake world's outcomes are not those of the physics."""
    from evaluator.runner import run_evaluation

    run = fake_home / "run"
    run_evaluation(fake_config(run, engine="inline", audit_share=0.0, episodes=60), backend=fake_backend())
    written = write_report(run, options=ReportOptions(per_label=2))
    assert written.path == run / "report.html"
    page = Page(written.path)
    assert written.agreement["different"] > 0
    assert page.text.count("Played again here, this step differed") == written.agreement["different"]
    assert f"{written.agreement['different']} differed" in page.text
    assert "has another protocol than the run" in page.text


def test_an_end_to_end_run_shows_its_funnel(fake_home: Path) -> None:
    from evaluator.runner import run_evaluation

    run = fake_home / "run"
    config = fake_config(run, "grasp_grasp_push", protocol="end-to-end", engine="inline", audit_share=0.0)
    run_evaluation(config, backend=fake_backend())
    page = Page(write_report(run, options=ReportOptions(per_label=0)).path)
    funnel = json.loads((run / "summary.json").read_text())["funnel"]
    assert len(funnel) == 4
    for step in funnel:
        assert f" {step['attempted']} {step['succeeded']} {percent(step['rate'])} % [" in page.text
    assert read_run(run).steps == (0, 1, 2, 3)
