"""``rema replay`` and ``rema proof``: what they print, and their exit codes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
)

import evaluator.replay.play
from evaluator.cli.main import cli
from evaluator.runner import run_evaluation
from evaluator.scenarios import VERSION
from tests.evaluator.fakes import fake_backend, fake_config


@pytest.fixture
def run(fake_home: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A finished run, in the working folder."""
    monkeypatch.setattr(evaluator.replay.play, "default_backend", fake_backend)
    monkeypatch.chdir(fake_home)
    run_evaluation(fake_config(Path("run"), episodes=60, engine="inline"), backend=fake_backend())
    return fake_home / "run"


def rema(*arguments: str, **more: str) -> Result:
    return CliRunner().invoke(cli, arguments, prog_name="rema", **more)


def replay(*arguments: str, **more: str) -> Result:
    return rema("replay", "run", "--engine", "inline", *arguments, **more)


def spoil(run: Path) -> None:
    path = run / "actions.bin"
    path.write_bytes(bytes([path.read_bytes()[0] ^ 1]) + path.read_bytes()[1:])


def test_a_true_run(run: Path) -> None:
    result = replay()
    assert result.exit_code == 0, result.stderr
    assert "nothing is wrong" in result.stdout and "0 of 60" in result.stdout and "its own audit" in result.stdout
    assert "replay: 60/60" in result.stderr
    part = replay("--fraction", "0.25", "--seed", "7")
    assert "15 episodes, drawn with seed 7" in part.stdout and "at most 21.80 % of all" in part.stdout
    shown = json.loads(replay("--json", "--fraction", "0").stdout)
    assert shown["ok"] is True and shown["findings"] == [] and len(shown["merkle_root"]) == 64


def test_a_tampered_run(run: Path) -> None:
    spoil(run)
    result = replay()
    assert result.exit_code == 6
    assert "actions.bin" in result.stdout and f"row 0 ({VERSION}/grasp/test/00000)" in result.stdout.replace("\n", " ")
    assert "nothing is wrong" not in result.stdout
    shown = replay("--json")
    assert shown.exit_code == 6
    (finding,) = json.loads(shown.stdout)["findings"]
    assert finding["file"] == "actions.bin" and finding["where"].startswith("row 0 ")


def test_another_simulator(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("REMA_FAKE_PARAMETERS", "other")
    result = replay()
    assert result.exit_code == 0
    assert "parameters is other here, p in the run" in result.stdout and "flips" in result.stdout


def test_what_is_no_finished_run(run: Path, tmp_path: Path) -> None:
    nothing = rema("replay", str(tmp_path / "nothing"))
    assert nothing.exit_code == 2 and "holds no finished run" in nothing.stderr
    (run / "run.json").write_text("{")
    assert replay().exit_code == 6
    assert rema("replay", "run", "--fraction", "2").exit_code == 2
    alone = replay("--address", "local")
    assert alone.exit_code == 2 and "--address is for an engine on a cluster" in alone.stderr


def test_sign_and_check_with_a_locked_key(run: Path) -> None:
    key = Ed25519PrivateKey.generate()
    locked = BestAvailableEncryption(b"secret")
    Path("key.pem").write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, locked))
    Path("other.pem").write_bytes(
        Ed25519PrivateKey.generate().private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    )
    public = key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)
    Path("public.pem").write_bytes(public)
    assert "is missing" in replay("--fraction", "0", "--public-key", "public.pem", "--json").stdout
    assert replay("--sign", "key.pem", input="wrong\n").exit_code == 2
    signed = replay("--sign", "key.pem", input="secret\n")
    assert signed.exit_code == 0 and "signed: run/run.json.sig" in signed.stderr
    assert "secret" not in signed.output
    checked = replay("--fraction", "0", "--public-key", "public.pem")
    assert checked.exit_code == 0 and "by the key" in checked.stdout
    nothing = replay("--fraction", "0", "--sign", "other.pem")
    assert nothing.exit_code == 2 and "simulates nothing" in nothing.stderr and nothing.stdout == ""
    assert replay("--fraction", "0.02", "--sign", "other.pem").exit_code == 0
    other = replay("--fraction", "0", "--public-key", "public.pem")
    assert other.exit_code == 6 and "not by the key" in other.stdout
    assert "--public-key FILE" in replay("--fraction", "0").stdout


def test_a_tampered_run_is_not_signed(run: Path) -> None:
    key = Ed25519PrivateKey.generate().private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    Path("key.pem").write_bytes(key)
    spoil(run)
    assert replay("--sign", "key.pem").exit_code == 6
    assert not (run / "run.json.sig").exists()


def test_the_proof_of_an_episode(run: Path) -> None:
    root = json.loads((run / "run.json").read_text())["seal"]["merkle_root"]
    made = rema("proof", "run", "--episode", "31")
    assert made.exit_code == 0
    Path("proof.json").write_text(made.stdout)
    good = rema("proof", "proof.json", "--root", root)
    assert good.exit_code == 0 and good.stdout.startswith(f"{VERSION}/grasp/test/00031 is part of the run")
    assert json.loads(rema("proof", "proof.json", "--root", root, "--json").stdout)["index"] == 31
    Path("bent.json").write_text(made.stdout.replace('"index": 31', '"index": 32'))
    bent = rema("proof", "bent.json", "--root", root)
    assert bent.exit_code == 6 and "not part of the run" in bent.stderr
    for words in (("run",), ("run", "--episode", "1", "--root", root), ("run/actions.bin", "--root", root)):
        assert rema("proof", *words).exit_code == 2
    assert rema("proof", "run", "--episode", "60").exit_code == 2
    assert rema("proof", "nothing", "--root", root).exit_code == 2
