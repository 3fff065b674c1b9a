"""Write the leaderboard of the README from the entries in manifests/leaderboard: no number in it is typed.

    python benchmarks/leaderboard.py                    # README.md
    python benchmarks/leaderboard.py --page FILE

Only what stands between the markers of the page is replaced.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.results import ROOT
from evaluator.leaderboard import leaderboard
from evaluator.leaderboard.escape import to_markdown
from evaluator.leaderboard.export import markdown_table, matrix
from evaluator.protocol import PROTOCOLS
from evaluator.run.entry import find_entries
from rema_data.errors import InputError, RemaError

PAGE = ROOT / "README.md"
START = "<!-- leaderboard: made by benchmarks/leaderboard.py -->"
END = "<!-- end of leaderboard -->"
NOTE = (
    "Success, % [95 % interval], over the 10,000 test scenarios of a task. Policies of one column that share a letter "
    "do not differ significantly (paired tests on the same scenarios, adjusted for their number). `privileged`: the "
    "policy saw the ground truth. `learned checkpoint`: one training, not a method "
    "([docs/statistics.md](docs/statistics.md#checkpoints-and-methods)). `published`: the paper's rates, from other "
    "scenes and another simulator. An empty cell: not scored yet. `rema leaderboard` shows the rest."
)
UNVERIFIED = (
    " `not verified`: an entry of an earlier form, without its actions, of networks that were trained on rema-v0. It "
    "cannot be verified, so it has no letters, and does not compare with the row of its name above."
)
HARD = (
    " `hard`: the mean over the axes of [the generalisation suite](docs/suite.md), with letters of its own; `-`: not "
    "played; `adapted`: trained on changed situations, and compared apart."
)


def section() -> str:
    """The text between the markers: one table for each protocol that has a row."""
    board = leaderboard(find_entries())
    for error in board.refused:
        raise error
    parts, notes = [], [NOTE]
    for protocol in PROTOCOLS:
        header, lines = matrix(board, protocol)
        if lines:
            parts += [f"**{protocol.capitalize()}**", markdown_table(header, [map(to_markdown, one) for one in lines])]
            notes += [UNVERIFIED] * any("not verified" in line[1] for line in lines)
            notes += [HARD] * any(name.endswith(" hard") for name in header)
    return "\n\n".join([*parts, "".join(dict.fromkeys(notes))])


def replace_section(text: str, content: str) -> str:
    """``text`` with what stands between the markers replaced.

    Raises
    ------
    InputError
        The markers are not there.
    """
    head, found, rest = text.partition(START)
    _, closed, tail = rest.partition(END)
    if not (found and closed):
        raise InputError("the page has no place for the leaderboard", hint=f"add the lines {START} and {END}")
    return f"{head}{START}\n\n{content}\n\n{END}{tail}"


def main() -> int:
    """Replace the section of the page; says where."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--page", type=Path, default=PAGE)
    arguments = options.parse_args()
    try:
        text = replace_section(arguments.page.read_text(encoding="utf-8"), section())
    except RemaError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    arguments.page.write_text(text, encoding="utf-8")
    print(arguments.page)
    return 0


if __name__ == "__main__":
    sys.exit(main())
