"""What is piped: no colour, one record a line, and every path whole, however narrow the terminal is."""

from __future__ import annotations

import io
import json
import logging
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from click.testing import CliRunner, Result
from rich.console import Console

from baselines.rounds.recursion import Stage
from evaluator.cli import output
from evaluator.cli.main import VERBS, cli
from evaluator.policy.check_report import CheckResult, PolicyReport
from evaluator.runner import run_evaluation
from evaluator.scenarios.seeds import commitment
from rema_data.release.registry import register
from rema_data.testing import make_release
from tests.baselines.rounds.fakes import write_plan
from tests.evaluator.fakes import fake_backend, fake_config, fake_fingerprint
from tests.evaluator.runs import EPISODES, solved, write_manifests, write_run

ROOT = Path(__file__).resolve().parents[3]
LONG = "a-folder-whose-name-is-longer-than-a-line with spaces [and brackets] of a terminal"
PACKAGES = ("rema_data", "evaluator", "baselines")

COMMITMENT = commitment(7)

VERB_CASES: dict[str, tuple[str, tuple[str, ...]]] = {
    "download": ("--source {here}/mirror", ("{here}/mirror", "{here}/home/releases/tiny")),
    "stats": ("{here}/mirror/tiny --plot {new}.png", ("{new}.png",)),
    "verify": ("{here}/damaged/tiny", ("in {here}/damaged", "round-1/grasp/train/steps.parquet", LONG)),
    "diff": (
        "{here}/mirror/tiny {here}/home/releases/fetched",
        ("A: tiny (", "B: fetched (", "round-1/push/train", "only in A"),
    ),
    "view": ("{here}/mirror/tiny --output {new}.html --episodes 1", ("{new}.html: ",)),
    "doctor": ("--seconds 0", ("REMA_HOME is {here}/home", "{here}/home/releases/fetched")),
    "preview": ("--release {here}/mirror/tiny --count 1 --table --output {new}.png", ("{new}.png: 1 steps",)),
    "export": ("{here}/mirror/tiny --output {new}", ("{new}/grasp.hdf5", "{new}/push.hdf5")),
    "publish": (
        "{here}/mirror/tiny --to {new} --no-viewer",
        ("{new}: ", "to upload it: hf upload ORG/NAME {new} . --repo-type dataset"),
    ),
    "import": ("{here}/exported --output {new}", ("{new}/tiny: ",)),
    "collect": ("{here}/plan.toml --output {new} --engine inline", ("{new}/planned is sealed",)),
    "train": ("--release {here}/mirror/tiny --tasks push --primitive push --output {new}", ("{new}/push.safetensors",)),
    "rounds": ("{here}/plan.toml --output {new}", ("round 1: train " + LONG + "/push done",)),
    "check": ("random", ("{here}/policy.py", "to fix weights: rema convert {here}/weights.pt", "{here}/policy.log")),
    "evaluate": (
        "random --task grasp --episodes 20 --engine inline --output {new}",
        ("run folder: {new} (`rema replay` checks it)", "warning: {here}/cache is full", "20 actions re-run: "),
    ),
    "fresh": ("commit --seed 7", ("sha256 (publish it):   " + COMMITMENT,)),
    "merge": ("{here}/shard-1 {here}/shard-2 --output {new}", ("run folder: {new} (",)),
    "replay": ("{here}/fake --engine inline --fraction 0.1", ("seal  {seal}",)),
    "leaderboard": (
        "{here}/a {here}/b {here}/unfinished",
        ("{here}/unfinished", f"my_policy_with_a_long_name  submitted     1  182/{EPISODES} "),
    ),
    "report": ("{here}/fake --per-label 0 --output {new}.html", ("{new}.html: ",)),
    "compare": (
        "{here}/a {here}/b",
        ("rema preview --task grasp --split test --protocol conditional --policy POLICY --scenario N",),
    ),
    "submit": ("{here}/a --output {new}.json", ("entry: {new}.json (",)),
    "scenarios": ("v9 --workers 1", ("{here}/lists/v9/manifest.json",)),
}
"""Arguments of every verb, and what must be whole on a line of its output."""
ERROR_CASES: dict[str, tuple[str, ...]] = {
    "download": ("--manifest {gone}", "unknown-release-of-a-rather-long-name"),
    "stats": ("{gone}",),
    "verify": ("{gone}",),
    "diff": ("{gone} {here}/mirror/tiny", "{here}/mirror/tiny {gone}"),
    "view": ("{gone}", "{gone} --output {new}.html"),
    "doctor": (),
    "preview": ("--release {gone}", "--task grasp --scenario 0 --policy {gone}.py"),
    "export": ("{gone} --output {new}",),
    "publish": ("{gone} --to {new}",),
    "import": ("{gone}",),
    "collect": ("{gone}",),
    "train": ("--release {gone} --tasks push --primitive push --output {new}",),
    "rounds": ("{gone}",),
    "check": ("{gone}.py",),
    "evaluate": ("{gone}.py --task grasp", "random --task grasp --checkpoint {gone}"),
    "fresh": (),
    "merge": ("{gone} --output {new}",),
    "replay": ("{gone}",),
    "leaderboard": ("{gone}",),
    "report": ("{gone}", "{here}/fake --policy {gone}.py"),
    "compare": ("{gone} {here}/a",),
    "submit": ("{gone}",),
    "scenarios": ("v9 --picker {gone}.py",),
}
"""A missing file, or a name that does not exist, of every verb that takes one."""
SAME_AGAIN = ("stats", "diff", "verify", "doctor", "leaderboard", "compare")

Rema = Callable[..., Result]


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Releases and runs in a folder of a long name."""
    folder = tmp_path_factory.mktemp("output") / LONG
    with pytest.MonkeyPatch.context() as patch:
        _environment(patch, folder)
        write_manifests(folder / "manifests")
        made = make_release(folder / "mirror", tasks=("grasp", "push"), episodes=2)
        register(made.manifest)
        make_release(folder / "home" / "releases", name="fetched", tasks=("grasp",), episodes=2)
        damaged = Path(shutil.copytree(made.path, folder / "damaged" / "tiny"))
        (damaged / "round-1" / "grasp" / "train" / "steps.parquet").unlink()
        (damaged / LONG).touch()
        write_run(folder / "a", solved(0.6, 1), policy="my_policy_with_a_long_name")
        write_run(folder / "b", solved(0.5, 2), policy="other")
        (folder / "unfinished").mkdir()
        fields: dict[str, Any] = {"episodes": 40, "engine": "inline"}
        run_evaluation(fake_config(folder / "fake", **fields), backend=fake_backend())
        _light_world(patch, folder)
        for number in (1, 2):
            shard = ("--batch-size", "8", "--shard", f"{number}/2", "--output", str(folder / f"shard-{number}"))
            done = _rema("evaluate", "random", "--task", "grasp", "--episodes", "20", "--engine", "inline", *shard)
            assert done.exit_code == 0, done.output
        _rema("export", str(folder / "mirror" / "tiny"), "--output", str(folder / "exported"))
        write_plan(folder, **{'name = "tiny"': 'name = "planned"'})
    return folder


def _environment(patch: pytest.MonkeyPatch, folder: Path) -> None:
    values = {"REMA_MANIFESTS": folder / "manifests", "REMA_HOME": folder / "home", "COLUMNS": 40, "FORCE_COLOR": 1}
    for name, value in values.items():
        patch.setenv(name, str(value))


def _light_world(patch: pytest.MonkeyPatch, folder: Path) -> None:
    """Without physics, policies and networks: this is about what is printed."""

    def checked(*_: Any, **__: Any) -> PolicyReport:
        results = [
            CheckResult("load", "ok", f"in 0.1 s; its log is {folder}/policy.log"),
            CheckResult("weights", "refused", "a pickle", f"rema convert {folder}/weights.pt"),
        ]
        return PolicyReport("random", folder / "policy.py", "Policy", None, "cpu", ("grasp",), tuple(results))

    def backend(*_: Any, **__: Any) -> Any:
        logging.getLogger("evaluator").warning("%s/cache is full", folder)
        return fake_backend()

    trained = SimpleNamespace(
        folder=folder / "networks",
        name="push",
        already=False,
        checkpoint=SimpleNamespace(metrics={"auc": 0.5, "balanced_accuracy": 0.5}, updates=1),
    )
    for target, value in {
        "evaluator.policy.check.check_policy": checked,
        "baselines.rounds.collect.default_backend": fake_backend,
        "baselines.rounds.collect.call_in_child": lambda target: fake_fingerprint(),
        "baselines.train.loop.train": lambda *args, **_: SimpleNamespace(**vars(trained) | {"folder": args[2]}),
        "baselines.rounds.recursion.recurse": lambda *_, **__: [Stage(1, f"train {LONG}/push", False, 2.0)],
        "evaluator.scenarios.generation.write_lists": lambda *_, **__: folder / "lists" / "v9" / "manifest.json",
        "evaluator.runner.run.default_backend": backend,
        "evaluator.replay.play.default_backend": fake_backend,
        "evaluator.runner.merge.default_backend": fake_backend,
        "evaluator.leaderboard.submission.replay": lambda *_, **__: SimpleNamespace(findings=(), verified=True),
        "evaluator.engines.child.process_pool": lambda _: nullcontext(),
    }.items():
        patch.setattr(target, value)


def _rema(*words: str) -> Result:
    return CliRunner().invoke(cli, words, prog_name="rema")


@pytest.fixture
def rema(here: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Rema:
    """``rema(verb, arguments)`` fills in the names of folders and runs the verb in a narrow, colourful environment."""
    _environment(monkeypatch, here)
    _light_world(monkeypatch, here)
    monkeypatch.chdir(tmp_path)

    def run(verb: str, arguments: str) -> Result:
        if "{gone}" in arguments:
            monkeypatch.undo()
            _environment(monkeypatch, here)
        if verb == "rounds" and "{new}" in arguments:
            monkeypatch.setattr("baselines.rounds.recursion_plan.load_recursion", lambda path: path)
        return _rema(verb, *(_filled(word, here, tmp_path) for word in arguments.split(" ")))

    return run


def _filled(text: str, here: Path, folder: Path) -> str:
    names = {
        "{seal}": json.loads((here / "fake" / "run.json").read_text())["seal"],
        "{here}": here,
        "{new}": folder / "new" / LONG,
        "{gone}": here / "there-is-no-file-of-this-name",
    }
    for name, path in names.items():
        text = text.replace(name, str(path))
    return text


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_in_a_pipe(
    verb: str, rema: Rema, here: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments, expected = VERB_CASES[verb]
    result = rema(verb, arguments)
    assert isinstance(result.exception, SystemExit | None), result.exception
    assert result.exit_code == {"verify": 6, "check": 3, "diff": 6}.get(verb, 0), result.output
    assert "\x1b" not in result.output
    text = result.stdout + result.stderr
    for words in expected:
        assert _filled(words, here, tmp_path) in text, text
    if verb in SAME_AGAIN:
        monkeypatch.setenv("COLUMNS", "400")
        assert rema(verb, arguments).stdout == result.stdout


@pytest.mark.parametrize(("verb", "arguments"), [(verb, words) for verb in VERBS for words in ERROR_CASES[verb]])
def test_errors_of_every_verb_in_a_pipe(verb: str, arguments: str, rema: Rema, here: Path, tmp_path: Path) -> None:
    result = rema(verb, arguments)
    assert result.exit_code == 2 and isinstance(result.exception, SystemExit), result.output
    assert "\x1b" not in result.stderr and result.stdout == ""
    message = next(line for line in result.stderr.splitlines() if line.startswith(("rema: ", "Error: ")))
    wrong = "there-is-no-file-of-this-name" if "{gone}" in arguments else arguments
    assert wrong in message and (wrong == arguments or str(here / wrong) in message), message


def test_a_real_pipe(here: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _environment(monkeypatch, here)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    command = [sys.executable, "-m", "evaluator.cli", "stats", str(here / "mirror" / "tiny")]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=tmp_path)
    rows = [line for line in done.stdout.splitlines() if line.startswith(("grasp ", "push "))]
    assert all(re.fullmatch(r"(grasp|push) +(train|val) +1 last .*\d", row) for row in rows[:4]), done.stdout
    assert "\x1b" not in done.stdout + done.stderr


def in_terminal(monkeypatch: pytest.MonkeyPatch, width: int, **options: Any) -> io.StringIO:
    """Let the verbs print on a terminal of this width; return what they print."""
    stream = io.StringIO()
    terminal = Console(file=stream, force_terminal=True, width=width, _environ={}, **{"color_system": None} | options)
    monkeypatch.setattr(output, "console", lambda err=False: terminal)
    return stream


TABLES: dict[str, str] = {
    **{verb: VERB_CASES[verb][0] for verb in ("verify", "doctor", "leaderboard", "compare", "check", "export")},
    "stats": "{here}/mirror/tiny",
    "preview": "--release {here}/mirror/tiny --count 2 --table",
    "download": "tiny --source {here}/mirror --dry-run",
    "evaluate": "random --task grasp --episodes 20 --engine inline --output {new}",
    "replay": "{here}/false --engine inline",
}
"""Arguments with which a verb prints a table."""


@pytest.mark.parametrize("verb", TABLES)
def test_no_terminal_cuts_a_value_of_a_table(
    verb: str, rema: Rema, here: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    if verb == "replay":
        false_run(here)
    cells: list[str] = []
    for name in ("_print_grid", "_print_records"):
        monkeypatch.setattr(output, name, recorded(getattr(output, name), cells))
    for width in (40, 60, 80):
        cells.clear()
        stream = in_terminal(monkeypatch, width)
        result = rema(verb, TABLES[verb])
        assert isinstance(result.exception, SystemExit | None), result.exception
        printed = stream.getvalue()
        assert cells and "\N{HORIZONTAL ELLIPSIS}" not in printed
        broken = [line[at : at + width] for line in printed.splitlines() for at in range(0, len(line), width)]
        missing = {cell for cell in cells if len(cell) <= width and not any(cell in line for line in broken)}
        assert not missing, f"{missing} at {width}:\n{printed}"
        assert all(cell in printed for cell in cells)
        shutil.rmtree(tmp_path / "new", ignore_errors=True)


def recorded(printer: Callable[..., None], cells: list[str]) -> Callable[..., None]:
    """The printer, which notes the cells of its rows."""

    def spy(names: Any, rows: Any, *more: Any) -> None:
        cells.extend(cell.plain for row in rows for cell in row or () if cell.plain)
        printer(names, rows, *more)

    return spy


def false_run(here: Path) -> None:
    """A run whose results are not what its actions give."""
    if not (here / "false").exists():
        shutil.copytree(here / "fake", here / "false")
        (here / "false" / "summary.json").write_text("{}")


def test_a_narrow_table_says_which_columns_it_leaves_out(monkeypatch: pytest.MonkeyPatch, rema: Rema) -> None:
    stream = in_terminal(monkeypatch, 60)
    rema("leaderboard", VERB_CASES["leaderboard"][0])
    printed = stream.getvalue()
    (told,) = re.findall(r"no room for all of: (.*); a wider terminal", printed)
    header = next(line for line in printed.splitlines() if line.startswith("policy "))
    assert told and not set(told.split(", ")) & set(header.split()) and len(header) <= 60
    stream = in_terminal(monkeypatch, 200)
    rema("leaderboard", VERB_CASES["leaderboard"][0])
    assert "no room" not in stream.getvalue()


def test_rows_become_records(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [("push", "1,234,567", ""), None, ("grasp_grasp_push", "8", "a note that is far too long")]
    for width, lines in (
        (60, ["task               episodes", "push              1,234,567", "8  a note that is far too long"]),
        (30, ["task      push", "episodes  1,234,567", "task      grasp_grasp_push", "a note that is far too long"]),
        (14, ["task", "episodes", "1,234,567", "grasp_grasp_push"]),
    ):
        stream = in_terminal(monkeypatch, width)
        output.print_table(("task", "episodes", ""), rows, right=("episodes",))
        assert all(any(line.endswith(words) for line in stream.getvalue().splitlines()) for words in lines)


def test_a_terminal_wraps_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is longer than a line stays one line, and colours stay."""
    stream = in_terminal(monkeypatch, 40, color_system="standard")
    output.print_table(("file", "state"), [("ok", "fine"), (LONG, output.plain("bad", "red"))], title=LONG)
    output.line(f"look at {LONG}", "yellow")
    output.print_facts([("run", LONG)])
    printed = stream.getvalue()
    assert printed.count(LONG) == 4 and "\x1b[31mbad\x1b[0m" in printed and "ok" in printed
    assert not any(line.endswith(" ") for line in printed.splitlines())


def test_control_characters_are_escaped(capsys: pytest.CaptureFixture[str]) -> None:
    output.line("a\x1b[2Jb")
    output.print_table(("name", ""), [("one\ntwo", "c\rd")])
    output.note("e\x07f")
    printed = capsys.readouterr()
    assert printed.out == "a\\x1b[2Jb\nname\none two  c\\rd\n" and printed.err == "e\\x07f\n"


def test_only_one_module_makes_a_console() -> None:
    makers = [
        path.relative_to(ROOT).as_posix()
        for package in PACKAGES
        for path in (ROOT / package).rglob("*.py")
        if re.search(r"\bConsole\(|import rich\b|rich\.print", path.read_text())
    ]
    assert makers == ["evaluator/cli/output.py"]
