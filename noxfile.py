"""One command for each check of this repository: ``nox -s NAME``; ``nox --list`` names them all.

``.ci/run`` runs the same sessions, all in one environment that it makes (``--no-venv --no-install``).
"""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path

import nox

nox.options.sessions = ["lint", "types", "imports", "tests"]
nox.options.reuse_existing_virtualenvs = True


@nox.session
def lint(session: nox.Session) -> None:
    """Style and formatting: ruff."""
    session.install("ruff>=0.6")
    session.run("ruff", "check", ".")
    session.run("ruff", "format", "--check", ".")


@nox.session
def types(session: nox.Session) -> None:
    """Types: mypy, strict."""
    session.install(".[test]")
    session.run("mypy")


@nox.session
def imports(session: nox.Session) -> None:
    """Which room may import which: import-linter with the contracts in pyproject.toml."""
    session.install("import-linter>=2.12")
    session.run("lint-imports", "--no-cache")


@nox.session
def tests(session: nox.Session) -> None:
    """The test suite; arguments after ``--`` go to pytest."""
    session.install(".[test]")
    session.run("pytest", *session.posargs)


@nox.session
def slow(session: nox.Session) -> None:
    """The proofs that take minutes each."""
    session.install(".[test,ray]")
    session.run("pytest", "-m", "slow", *session.posargs)


@nox.session
def benchmarks(session: nox.Session) -> None:
    """Every benchmark at a reduced size."""
    session.install(".[test]")
    session.run("pytest", "-m", "benchmark", *session.posargs)


@nox.session
def contracts(session: nox.Session) -> None:
    """The README, the pages in docs/ and the docstrings against the code."""
    session.install(".[test]")
    session.run("pytest", "tests/contracts", *session.posargs)


@nox.session
def docs(session: nox.Session) -> None:
    """The documentation site in build/docs, with its tutorials run and every warning an error."""
    session.install(".[docs]")
    session.run("python", "-m", "sphinx", "-M", "html", "docs", "build/docs", "-W", "--keep-going", *session.posargs)


@nox.session
def recipes(session: nox.Session) -> None:
    """The recipes for JAX and Grain in docs/dataset.md; without these two the tests skip them."""
    session.install(".[test]", "jax", "grain")
    session.run("pytest", "tests/contracts/test_array_recipes.py", *session.posargs)


@nox.session
def harnesses(session: nox.Session) -> None:
    """The tasks in the runners of vla-evaluation-harness and Inspect Robots; without these the tests skip them."""
    session.install(".[test]", "vla-eval>=0.8", "inspect-robots>=0.60")
    session.run("pytest", "tests/evaluator/harness", *session.posargs)


@nox.session
def newest(session: nox.Session) -> None:
    """The tests with the newest versions of all dependencies."""
    session.install("--upgrade", "--upgrade-strategy", "eager", ".[test]")
    session.run("pytest", *session.posargs)


@nox.session(python="3.11")
def lowest(session: nox.Session) -> None:
    """The tests with the lowest versions that pyproject.toml allows for what rema itself imports."""
    session.install("uv")
    session.run("uv", "pip", "install", "--upgrade", "--resolution", "lowest-direct", ".[test]")
    session.run("pytest", *session.posargs)


@nox.session
def dist(session: nox.Session) -> None:
    """What a release uploads: built, checked by twine, and each of both files installed and used in an empty folder."""
    session.install("build>=1.0", "twine>=5.1")
    made = Path(session.create_tmp()) / "dist"
    shutil.rmtree(made, ignore_errors=True)
    # Both from the checkout: a wheel that is built from the sdist would not know its commit.
    session.run("python", "-m", "build", "--sdist", "--wheel", "--outdir", str(made))
    files = sorted(made.iterdir())
    session.run("twine", "check", "--strict", *map(str, files))
    for file in files:
        with tempfile.TemporaryDirectory() as empty:
            place = Path(empty) / "venv"
            session.run("python", "-m", "venv", str(place))
            bin_folder = place / ("Scripts" if os.name == "nt" else "bin")
            session.run(str(bin_folder / "pip"), "install", "--quiet", str(file), external=True)
            with session.chdir(empty):
                environment = {"REMA_HOME": str(Path(empty) / "home"), "PYTHONPATH": ""}
                for arguments in (
                    ["verify", "rema-sample"],
                    ["evaluate", "random", "--task", "grasp", "--episodes", "5"],
                ):
                    session.run(str(bin_folder / "rema"), *arguments, env=environment, external=True)
    for file in files:
        Path("dist").mkdir(exist_ok=True)
        shutil.copy(file, "dist")


def _on(version: str) -> None:
    @nox.session(name=f"py{version.replace('.', '')}", python=version)
    def session_of_a_version(session: nox.Session) -> None:
        session.install(".[test]")
        session.run("pytest", *session.posargs)

    session_of_a_version.__doc__ = f"The tests on Python {version}."


for _version in ("3.11", "3.12", "3.13"):
    _on(_version)
