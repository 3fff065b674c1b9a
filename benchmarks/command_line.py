"""Write docs/command_line.md: every verb of ``rema`` and every option, from the commands themselves.

A test holds the page equal to them; after a change of the commands:

python benchmarks/command_line.py
"""

from __future__ import annotations

import argparse
import inspect
import sys
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import click

from benchmarks.results import ROOT
from evaluator.cli.main import VERBS, cli
from rema_data.storage import write_atomic

PAGE = ROOT / "docs" / "command_line.md"
HEAD = """# The command line

Made by `python benchmarks/command_line.py`. Results go to stdout, progress to stderr; `--json` prints one object alone.
Every verb says the same with `--help`.
"""


def page() -> str:
    """The whole page."""
    context = click.Context(cli)
    parts = [HEAD]
    for name in VERBS:
        command = cli.get_command(context, name)
        assert command is not None
        parts.append("\n".join(_verb(name, command)))
        if isinstance(command, click.Group):
            parts += ["\n".join(_verb(f"{name} {word}", own, "###")) for word, own in command.commands.items()]
    return "\n".join(parts)


def _verb(name: str, command: click.Command, heading: str = "##") -> Iterator[str]:
    arguments = [parameter for parameter in command.params if isinstance(parameter, click.Argument)]
    options = [parameter for parameter in command.params if isinstance(parameter, click.Option)]
    rest = "COMMAND" if isinstance(command, click.Group) else "[OPTIONS]" if options else ""
    yield f"{heading} rema {name}\n"
    yield f"    rema {' '.join(filter(None, [name, *(_argument(one) for one in arguments), rest]))}\n"
    yield f"{inspect.cleandoc(command.help or '')}\n"
    if not options:
        return
    yield "| option | values | what |"
    yield "|---|---|---|"
    for option in options:
        yield f"| {_names(option)} | {_values(option)} | {_cell(option.help or '')} |"
    yield ""


def _argument(argument: click.Argument) -> str:
    word = (argument.name or "").upper() + ("..." if argument.nargs == -1 else "")
    return word if argument.required else f"[{word}]"


def _names(option: click.Option) -> str:
    return " ".join(f"`{name}`" for name in (*option.opts, *option.secondary_opts))


def _values(option: click.Option) -> str:
    """Choices or the name of a value, and what holds where it is not given."""
    if option.is_flag:
        chosen = option.opts if option.default else option.secondary_opts
        return f"by default `{chosen[0]}`" if option.secondary_opts else ""
    kind = option.type
    shown = ", ".join(f"`{choice}`" for choice in kind.choices) if isinstance(kind, click.Choice) else ""
    shown = shown or (option.metavar or kind.name.split()[0].upper())
    default = "" if not option.show_default or option.default is None else f"; by default `{option.default}`"
    return shown + ("; required" if option.required else default)


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def main() -> None:
    """Write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--page", type=Path, default=PAGE)
    arguments = parser.parse_args()
    write_atomic(arguments.page, page())
    print(arguments.page)


if __name__ == "__main__":
    main()
