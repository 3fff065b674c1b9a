"""Signatures with keys of both common formats; anything else is refused with the command that makes a key."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
)

from evaluator.run.signature import is_signed_by, key_name, read_private_key, read_public_key
from rema_data.errors import InputError, MissingFileError

PEM = (PrivateFormat.PKCS8, Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)
SSH = (PrivateFormat.OpenSSH, Encoding.OpenSSH, PublicFormat.OpenSSH)


@pytest.mark.parametrize(("private", "encoding", "public"), [PEM, SSH], ids=["openssl", "ssh-keygen"])
@pytest.mark.parametrize("passphrase", [None, "correct horse"])
def test_keys_of_both_formats(
    tmp_path: Path, private: PrivateFormat, encoding: Encoding, public: PublicFormat, passphrase: str | None
) -> None:
    made = Ed25519PrivateKey.generate()
    locked = NoEncryption() if passphrase is None else BestAvailableEncryption(passphrase.encode())
    (tmp_path / "key").write_bytes(made.private_bytes(Encoding.PEM, private, locked))
    (tmp_path / "key.pub").write_bytes(made.public_key().public_bytes(encoding, public))
    key = read_private_key(tmp_path / "key", lambda: str(passphrase))
    known = read_public_key(tmp_path / "key.pub")
    assert key_name(known) == key_name(made.public_key())
    signature = key.sign(b"run")
    assert len(signature) == 64
    assert is_signed_by(known, signature, b"run")
    assert not is_signed_by(known, signature, b"ran")
    assert not is_signed_by(known, signature[:-1], b"run")
    assert not is_signed_by(Ed25519PrivateKey.generate().public_key(), signature, b"run")


def test_a_wrong_passphrase_is_bad_input(tmp_path: Path) -> None:
    locked = BestAvailableEncryption(b"right")
    key = Ed25519PrivateKey.generate().private_bytes(Encoding.PEM, PrivateFormat.PKCS8, locked)
    (tmp_path / "key").write_bytes(key)
    for ask in (None, lambda: "wrong"):
        with pytest.raises(InputError, match="cannot be used as a private key"):
            read_private_key(tmp_path / "key", ask)


def test_what_is_no_key(tmp_path: Path) -> None:
    (tmp_path / "text").write_text("hello")
    other = ec.generate_private_key(ec.SECP256R1())
    (tmp_path / "ec").write_bytes(other.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    (tmp_path / "ec.pub").write_bytes(other.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo))
    for read, name in ((read_private_key, "ec"), (read_public_key, "ec.pub")):
        with pytest.raises(InputError, match="another kind than Ed25519"):
            read(tmp_path / name)
        with pytest.raises(InputError) as caught:
            read(tmp_path / "text")
        assert "openssl" in caught.value.hint
        with pytest.raises(MissingFileError):
            read(tmp_path / "nothing")


def test_without_the_extra_the_command_that_installs_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cryptography", None)
    for read in (read_private_key, read_public_key):
        with pytest.raises(InputError, match="not installed") as caught:
            read(tmp_path / "key")
        assert "rema[sign]" in caught.value.hint
