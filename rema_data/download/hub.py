"""Data sets on the Hugging Face Hub, or on a mirror that speaks its API (``HF_ENDPOINT``): ``hf://datasets/ORG/NAME``.

A file is read from its ``resolve`` URL as from any web server: one request, resumed at the byte where it stopped. The
token that ``hf auth login`` or ``HF_TOKEN`` left goes to the hub, and not to the stores that it redirects to.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import cached_property
from http import HTTPStatus
from urllib.parse import quote, unquote, urlsplit

from rema_data.download.failures import Faltered, Refused, answered, retry_after
from rema_data.download.labels import hub_address
from rema_data.download.web import Failure, Response, WebFolder

__all__ = ["HubFolder"]

_LOGIN = "log in with `hf auth login`, or set HF_TOKEN"
_WINDOW = re.compile(r";\s*t=(\d{1,6})\b")
"""Seconds until the hub answers again, in its header ``RateLimit``."""
_TOKEN = re.compile("[!-~]+")


class HubFolder:
    """A folder of releases in a dataset of the hub. Threads share it.

    ``name`` is that of its innermost folder. Raises ValueError where the URL is not that of a dataset.
    """

    def __init__(self, url: str) -> None:
        found = hub_address(url)
        if found is None:
            raise ValueError("it is not hf://datasets/ORG/NAME, hf://datasets/ORG/NAME@REVISION, or a folder in one")
        self._repository = f"{found['organisation']}/{found['name']}"
        self._revision = unquote(found["revision"] or "main")
        self._folder = found["folder"].rstrip("/")
        self.name = self._folder.rpartition("/")[2] or found["name"]

    def check(self) -> None:
        """Raise ImportError without huggingface_hub, and ValueError where ``HF_ENDPOINT`` is not a URL."""
        try:
            WebFolder(self._endpoint).check()
        except ValueError as error:
            raise ValueError(f"HF_ENDPOINT is not the URL of a hub: {error}") from error

    def open(self, location: str, start: int, size: int) -> AbstractContextManager[tuple[int, Callable[[int], bytes]]]:
        """As ``Source.open``; errors of the connection are those of urllib3."""
        return self._web.open(location, start, size)

    def close(self) -> None:
        """Close the connections that are kept for the next file."""
        if "_web" in vars(self):
            self._web.close()

    @cached_property
    def _endpoint(self) -> str:
        """Where the hub is; asked for only when it is needed, as huggingface_hub takes a second to import."""
        from huggingface_hub import constants

        return str(constants.ENDPOINT).rstrip("/")

    @cached_property
    def _web(self) -> WebFolder:
        revision = quote(self._revision, safe="")
        url = f"{self._endpoint}/datasets/{self._repository}/resolve/{revision}{quote(self._folder)}"
        return WebFolder(url, self._authorization, self._refusal)

    @cached_property
    def _authorization(self) -> str:
        from huggingface_hub import constants, get_token

        if constants.HF_HUB_OFFLINE:
            raise Refused("was not asked, as HF_HUB_OFFLINE is set: unset it")
        token = None if constants.HF_HUB_DISABLE_IMPLICIT_TOKEN else get_token()
        if not token:
            return ""
        # The message about a header that cannot be sent would have the token in it.
        if not _TOKEN.fullmatch(token):
            raise Refused(f"was not asked: the token of this machine has characters that none has; {_LOGIN}")
        return f"Bearer {token}"

    @property
    def advice(self) -> str:
        """What helps where the hub does not answer."""
        status = "https://status.huggingface.co says whether the hub is down"
        return f"; {status}, HF_ENDPOINT names a mirror (now {urlsplit(self._endpoint).hostname})"

    def _refusal(self, response: Response) -> Failure:
        """What the hub means by a status of 400 or more: it says more in its headers."""
        status, headers = response.status, response.headers
        code, logged_in = headers.get("X-Error-Code", ""), bool(self._authorization)
        if code == "GatedRepo":
            page = f"{self._endpoint}/datasets/{self._repository}"
            return Refused(f"asks who you are ({status}): accept its conditions at {page}, and {_LOGIN}")
        if code == "RevisionNotFound":
            return Refused(f"has no revision {self._revision}: name one of its branches, tags or commits after the @")
        if code == "RepoNotFound" or (status == HTTPStatus.UNAUTHORIZED and not logged_in):
            way = "log in as somebody who may read it: `hf auth login`, or HF_TOKEN" if logged_in else _LOGIN
            return Refused(f"is not there, or is private ({status}): check its name; if it is private, {way}")
        if status == HTTPStatus.UNAUTHORIZED:
            return Refused(f"refuses the token of this machine ({status}): it was revoked or has expired; {_LOGIN}")
        if status == HTTPStatus.FORBIDDEN and logged_in:
            return Refused(f"does not allow it ({status}): use a token that may read {self._repository}; {_LOGIN}")
        if status == HTTPStatus.TOO_MANY_REQUESTS:
            window = _WINDOW.search(headers.get("RateLimit", ""))
            wait_s = retry_after(headers.get("Retry-After", "") or (window[1] if window else ""))
            when = f"in {wait_s:.0f} s" if wait_s else "in a few minutes"
            more = "" if logged_in else f", or {_LOGIN}, for a higher limit"
            return Faltered(f"limits how often it is asked ({status}): try again {when} with --jobs 2{more}", wait_s)
        found = answered(status, response.reason or "", headers.get("Retry-After", ""))
        if isinstance(found, Faltered):
            return Faltered(f"{found}{self.advice}", found.wait_s)
        return found
