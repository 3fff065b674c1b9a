"""The board in other formats: well-formed, complete, and safe to paste."""

from __future__ import annotations

import csv
import io
import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import pytest

from evaluator.leaderboard import Board, Row
from evaluator.leaderboard.export import COLUMNS, cells, export, matrix
from evaluator.run.audit import Audit
from evaluator.run.counts import FunnelStep

HOSTILE = "a|b<script>&\\_%$#{x}^~"
ROW = Row(
    policy="mine",
    tag="submitted",
    task="grasp_push",
    protocol="conditional",
    split="test",
    successes=450,
    episodes=1000,
    rate=0.45,
    ci95=(0.4194, 0.481),
    failures={"missed": 500, "slipped": 49, "policy_error": 1},
    policy_errors=1,
    funnel=(FunnelStep(1, 1000, 450),),
    audit=Audit(30, 0, 30, 0),
    rank=1,
    verified="here",
    ties="a",
    end_to_end=0.31,
    policy_digest="d" * 64,
    scenarios_hash="5" * 64,
    protocol_hash="6" * 64,
    source="runs/mine",
    link="https://example.org/?a=1&b=2",
)
WHOLE = replace(ROW, protocol="end-to-end", funnel=(FunnelStep(0, 1000, 800), FunnelStep(1, 800, 310)), end_to_end=None)
ODD = replace(ROW, policy=HOSTILE, ties="", rank=None, unranked="200 of 10,000 scenarios", rate=None, ci95=None)
PAPER = replace(
    ROW, policy="joint", tag="published", successes=None, rate=0.4549, link="", rank=None, unranked="published"
)
BOARD = Board((ROW, PAPER, ODD, WHOLE), ("first remark", "100 % & more"))


def shown(row: Row) -> dict[str, str]:
    return dict(zip(COLUMNS, cells(row), strict=True))


def test_cells() -> None:
    row = shown(ROW)
    assert (row["k/n"], row["rate %"], row["95 %"], row["ties"], row["rank"]) == (
        "450/1000",
        "45.0",
        "41.9, 48.1",
        "a",
        "1",
    )
    assert row["end-to-end %"] == "31.0" and row["funnel %"] == "" and row["errors"] == "1 policy"
    assert row["failures"] == "missed 500, slipped 49, policy_error 1"
    assert shown(WHOLE)["funnel %"] == "80.0 > 31.0"
    assert (shown(PAPER)["k/n"], shown(PAPER)["rank"]) == ("> 1000", "-")
    assert (shown(ODD)["rate %"], shown(ODD)["95 %"]) == ("-", "-")
    flipped = replace(ROW, policy_errors=0, audit=Audit(30, 2, 30, 0), infra_errors=3, bounds=(0.44, 0.46))
    assert shown(flipped)["errors"] == "3 infra, rate in 44.0, 46.0, 2 of 30 repeated actions flipped"


def test_a_learned_row_is_one_checkpoint() -> None:
    """And not the method whose name it may have; a program that reads the tag still finds it."""
    learned = replace(ROW, policy="tae-joint", tag="learned")
    assert shown(learned)["tag"] == "learned checkpoint" and shown(ROW)["tag"] == "submitted"
    _, lines = matrix(Board((ROW, learned, replace(learned, verified="", unranked="unverified")), ()), "conditional")
    assert [line[1] for line in lines][:2] == ["submitted", "learned checkpoint"]
    assert json.loads(export(Board((learned,), ()), "json"))["rows"][0]["tag"] == "learned"


def test_markdown_has_one_cell_for_every_column() -> None:
    lines = [line for line in export(BOARD, "md").splitlines() if line.startswith("|")]
    assert len(lines) == 2 + len(BOARD.rows)
    for line in lines:
        assert line.replace("\\|", "").count("|") == len(COLUMNS) + 1
    assert "first remark" in export(BOARD, "md") and "grasp_push" in export(BOARD, "md")


class Parser(HTMLParser):
    """Open tags, everything that is fetched or run, and the cells."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.links: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [value or "" for name, value in attrs if name in ("href", "src")]
        if tag != "meta":
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def test_html_is_whole_and_runs_nothing() -> None:
    parser = Parser()
    parser.feed(export(BOARD, "html"))
    assert parser.open == [] and "script" not in parser.tags and parser.tags.count("table") == 2
    assert HOSTILE in parser.text and set(parser.links) == {ROW.link}
    assert "grasp_push, conditional (scenarios 55555555, protocol 66666666)" in parser.text


TRICKS = (
    "<img src=x onerror=alert(1)>",
    "[click](javascript:alert(1))",
    "![x](https://evil.example/p.png)",
    "a\nb | c\r\n# heading",
    "`code` **bold** __init__ &lt;",
    '=HYPERLINK("https://evil.example")',
    "\t@SUM(1)",
    "x\n\\input{/etc/passwd}",
)


@pytest.mark.parametrize("trick", TRICKS)
def test_names_from_files_stay_text(trick: str) -> None:
    board = Board((replace(ROW, policy=trick, link=f"javascript:{trick}"), ROW), (trick,))
    markdown = export(board, "md").splitlines()
    assert len(markdown) == 2 + 2 + 2 and len([line for line in markdown if line.startswith("|")]) == 4
    for line in (markdown[2], markdown[-1]):
        plain = re.sub(r"\\[\\`*_<>|&~(\[:!#]", "", line)
        assert not re.search(r"[<`*&]|\]\(|!\[", plain)
    parser = Parser()
    parser.feed(export(board, "html"))
    assert parser.open == [] and set(parser.links) == {ROW.link} and not {"img", "script"} & {*parser.tags}
    latex = export(board, "tex").splitlines()
    assert not any(line.startswith("\\input") for line in latex) and latex[-1].startswith("% ")
    table = list(csv.DictReader(io.StringIO(export(board, "csv"))))
    assert not table[0]["policy"].lstrip().startswith(("=", "@", "+", "-")) and table[0]["successes"] == "450"
    assert json.loads(export(board, "json"))["rows"][0]["policy"] == trick


def test_latex_escapes_what_latex_reads() -> None:
    text = export(BOARD, "tex")
    assert (
        r"a|b\textless{}script\textgreater{}\&\textbackslash{}\_\%\$\#\{x\}\textasciicircum{}\textasciitilde{}" in text
    )
    assert text.count("\\begin{tabular}") == text.count("\\end{tabular}") == 2
    body = [line for line in text.splitlines() if line.endswith(r" \\")]
    assert {line.replace(r"\&", "").count("&") for line in body} == {len(COLUMNS) - 3}


def test_csv_and_json_carry_every_field() -> None:
    table = list(csv.DictReader(io.StringIO(export(BOARD, "csv"))))
    whole = json.loads(export(BOARD, "json"))
    assert whole["remarks"] == list(BOARD.remarks)
    assert len(table) == len(whole["rows"]) == len(BOARD.rows)
    for line, row in zip(table, whole["rows"], strict=True):
        for name, value in row.items():
            if isinstance(value, str):
                assert line[name] == value
    assert (table[0]["ci95_low"], table[0]["successes"]) == ("0.4194", "450")
    assert json.loads(table[0]["failures"])["missed"] == 500 and table[2]["rate"] == ""
    assert json.loads(table[3]["funnel"])[1]["succeeded"] == 310


@pytest.mark.parametrize("form", ["md", "html", "tex", "csv", "json"])
def test_every_format_of_an_empty_board(form: str) -> None:
    assert export(Board((), ()), form).endswith("\n")


def test_the_matrix_has_a_line_for_every_ranked_policy() -> None:
    header, lines = matrix(BOARD, "conditional")
    assert header == ["policy", "kind", "grasp_push"]
    assert lines == [["mine", "submitted", "45.0 [41.9, 48.1] a"], ["joint", "published", "45.5"]]
    twins = Board((ROW, replace(ROW, rate=0.3, task="grasp"), replace(ROW, rate=0.2)), ())
    _, lines = matrix(twins, "conditional")
    assert [line[0] for line in lines] == ["mine", "mine (2)"] and lines[1][2] == ""
