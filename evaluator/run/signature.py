"""A signature over ``run.json``, and through its seal over the whole run: Ed25519, 64 raw bytes in ``run.json.sig``.

Keys are made by the tools that people have: ``openssl genpkey -algorithm ed25519`` or ``ssh-keygen -t ed25519``.
Nothing here writes one. ``cryptography`` is an extra and imported when it is needed.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rema_data.errors import InputError, MissingFileError

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

__all__ = ["SIGNATURE_FILE", "is_signed_by", "key_name", "read_private_key", "read_public_key"]

SIGNATURE_FILE = "run.json.sig"
_SSH_PRIVATE = b"-----BEGIN OPENSSH PRIVATE KEY-----"
_SSH_PUBLIC = b"ssh-ed25519 "


def read_private_key(path: Path, ask: Callable[[], str] | None = None) -> Ed25519PrivateKey:
    """The key in a PEM (PKCS #8) or OpenSSH file; ``ask`` is called for the passphrase of an encrypted one.

    Raises MissingFileError, or InputError: no Ed25519 private key, another passphrase, or no ``cryptography``.
    """
    _need_cryptography()
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import load_pem_private_key, load_ssh_private_key

    def load(payload: bytes) -> object:
        parse = load_ssh_private_key if payload.startswith(_SSH_PRIVATE) else load_pem_private_key
        try:
            return parse(payload, None)
        except TypeError:  # it is encrypted
            if ask is None:
                raise
            return parse(payload, ask().encode())

    hint = "make one: openssl genpkey -algorithm ed25519 -out key.pem"
    key: Ed25519PrivateKey = _key(path, load, Ed25519PrivateKey, "private", hint)
    return key


def read_public_key(path: Path) -> Ed25519PublicKey:
    """The key in a PEM or OpenSSH (``ssh-ed25519 ...``) file.

    Raises MissingFileError, or InputError: no Ed25519 public key, or no ``cryptography``.
    """
    _need_cryptography()
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
    from cryptography.hazmat.primitives.serialization import load_pem_public_key, load_ssh_public_key

    def load(payload: bytes) -> object:
        return (load_ssh_public_key if payload.startswith(_SSH_PUBLIC) else load_pem_public_key)(payload)

    hint = "take it from the signer's private one: openssl pkey -in key.pem -pubout -out public.pem"
    key: Ed25519PublicKey = _key(path, load, Ed25519PublicKey, "public", hint)
    return key


def is_signed_by(key: Ed25519PublicKey, signature: bytes, payload: bytes) -> bool:
    """Whether ``signature`` was made over ``payload`` with the private half of ``key``."""
    from cryptography.exceptions import InvalidSignature

    try:
        key.verify(signature, payload)
    except InvalidSignature:
        return False
    return True


def key_name(key: Ed25519PublicKey) -> str:
    """Name of a key for people: the sha256 of its 32 raw bytes, hexadecimal."""
    return hashlib.sha256(key.public_bytes_raw()).hexdigest()


def _need_cryptography() -> None:
    try:
        import cryptography  # noqa: F401
    except ImportError as error:
        raise InputError(
            "signatures need the package cryptography, which is not installed", hint="pip install 'rema[sign]'"
        ) from error


def _key(path: Path, load: Callable[[bytes], object], kind: Any, what: str, hint: str) -> Any:
    """The key in a file, parsed by ``load``."""
    if not path.is_file():
        raise MissingFileError(f"key file {path} does not exist", hint="check the path", path=str(path))
    try:
        key = load(path.read_bytes())
    except Exception as error:  # whatever the parsers of foreign formats raise
        raise InputError(f"{path} cannot be used as a {what} key: {error}", hint=hint, path=str(path)) from error
    if not isinstance(key, kind):
        raise InputError(f"{path} holds a {what} key of another kind than Ed25519", hint=hint, path=str(path))
    return key
