"""No part of a password is shown, whatever characters it has."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rema_data.download.labels import label
from rema_data.download.sources import Source
from rema_data.errors import InputError


@pytest.mark.parametrize(
    ("url", "shown"),
    [
        ("/data/me@home/releases", "/data/me@home/releases"),
        ("file:///data/releases", "file:///data/releases"),
        ("https://host:8443/releases?token=x#y", "https://host:8443/releases"),
        ("https://me:secret@host/releases", "https://host/releases"),
        ("https://me:se@cret@host/releases", "https://host/releases"),
        ("https://host/gh/repo@v1/releases", "https://host"),
        ("https://me:se/cret@host/releases", "https://me"),
        ("https://me:12/cret@host/releases", "https://me"),
        ("https://me:se?cret@host/releases", "https://me"),
        ("https://me:se#cret@host/releases", "https://me"),
        ("https://me:se[cret@host/releases", "https://..."),
        ("https://me:12::cret@host/releases", "https://me::..."),
        ("s3://KEY:a/b+c@bucket/releases", "s3://key"),
        ("zip://::https://me:secret@host/all.zip", "zip://::https://host/all.zip"),
        ("memory://bucket/releases", "memory://bucket/releases"),
    ],
)
def test_labels(url: str, shown: str) -> None:
    assert label(url) == shown


@given(st.text(min_size=6, max_size=12), st.sampled_from(["https", "http", "s3", "simplecache::https"]))
def test_no_characters_of_a_password_are_shown(word: str, protocol: str) -> None:
    """Every run of five characters of it counts as a part; the host and the path have none of them."""
    url = f"{protocol}://user:{word}@mirror.example/releases"
    texts = [label(url)]
    try:
        source = Source(url)
        texts += [source.label, repr(source)]
        source.check()
        texts.append(str(source._failure(ValueError(f"cannot parse {url}"))))
    except InputError as error:
        texts.append(str(error))
    known = "user mirror.example releases https http s3 simplecache cannot be used the source host"
    for text in texts:
        for start in range(len(word) - 4):
            part = word[start : start + 5]
            if not re.search(re.escape(part), known, re.IGNORECASE):
                assert part not in text, (url, text)


def test_what_a_library_says_about_a_url_with_a_secret_is_not_repeated() -> None:
    source = Source("https://me:secret@host/releases")
    for error in (ValueError("secret"), OSError(111, "Connection refused", "secret"), KeyError("secret")):
        assert "secret" not in str(source._failure(error))
    assert "Connection refused" in str(source._failure(OSError(111, "Connection refused")))
