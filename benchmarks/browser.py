"""A headless Chromium that measures and tests drive: it opens pages as wide as asked, presses keys and takes pictures.

It speaks the DevTools protocol over a pair of pipes, so nothing but the browser itself is needed.
"""

from __future__ import annotations

import base64
import itertools
import json
import os
import select
import shutil
import subprocess
import tempfile
import time
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

__all__ = ["CHROMIUM", "Browser"]

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)
"""The browser of this machine; None where there is none."""
_OPTIONS = ("--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--hide-scrollbars")


class Browser:
    """One page in a browser of its own; a context manager."""

    def __init__(self, width: int = 1280, height: int = 900, dark: bool = False, timeout_s: float = 60.0) -> None:
        if CHROMIUM is None:
            raise SystemExit("no Chromium is installed: apt-get install chromium")
        self._timeout_s = timeout_s
        self._folder = tempfile.TemporaryDirectory(prefix="rema-browser-", ignore_cleanup_errors=True)
        (reading, to), (self._from, writing) = os.pipe(), os.pipe()
        self._to = to

        def place() -> None:  # the browser reads descriptor 3 and writes 4
            kept = os.dup(reading), os.dup(writing)
            os.dup2(kept[0], 3)
            os.dup2(kept[1], 4)

        self._process = subprocess.Popen(
            [CHROMIUM, *_OPTIONS, f"--user-data-dir={self._folder.name}", "--remote-debugging-pipe", "about:blank"],
            preexec_fn=place,
            close_fds=False,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(reading)
        os.close(writing)
        self._numbers = itertools.count(1)
        self._rest = b""
        self._session: str | None = None
        targets = self.call("Target.getTargets")["targetInfos"]
        page = next(one["targetId"] for one in targets if one["type"] == "page")
        self._session = self.call("Target.attachToTarget", targetId=page, flatten=True)["sessionId"]
        self.resize(width, height, dark)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(OSError, SystemExit):
            self._session = None
            self.call("Browser.close")
        self._process.wait(self._timeout_s)
        os.close(self._to)
        os.close(self._from)
        self._folder.cleanup()

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """A command of the DevTools protocol, and what it returns."""
        number = next(self._numbers)
        message: dict[str, Any] = {"id": number, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        end = time.monotonic() + self._timeout_s
        while True:
            for answer in self._received(end):
                if answer.get("id") == number:
                    if "error" in answer:
                        raise SystemExit(f"{method}: {answer['error']['message']}")
                    result: dict[str, Any] = answer["result"]
                    return result

    def _received(self, end: float) -> list[dict[str, Any]]:
        ready, _, _ = select.select([self._from], [], [], max(0.0, end - time.monotonic()))
        data = os.read(self._from, 1 << 20) if ready else b""
        if not data:
            raise SystemExit("the browser does not answer")
        *whole, self._rest = (self._rest + data).split(b"\0")
        return [json.loads(one) for one in whole]

    def resize(self, width: int, height: int, dark: bool = False) -> None:
        """Another size of the window in CSS pixels, and the reader's colour scheme."""
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])

    def open(self, address: str, until: str = "document.readyState === 'complete'") -> float:
        """Go to an address, wait until an expression is true there, and give the seconds that it took."""
        began = time.perf_counter()
        self.call("Page.navigate", url="about:blank")
        self.call("Page.navigate", url=address)
        self.wait(until)
        return time.perf_counter() - began

    def wait(self, expression: str) -> None:
        """Wait until a JavaScript expression is true."""
        end = time.monotonic() + self._timeout_s
        while not self.evaluate(f"Boolean({expression})"):
            if time.monotonic() > end:
                raise SystemExit(f"the page never reached: {expression}")
            time.sleep(0.01)

    def evaluate(self, expression: str) -> Any:
        """Value of a JavaScript expression; None where it throws."""
        return self.call("Runtime.evaluate", expression=expression, returnByValue=True)["result"].get("value")

    def press(self, key: str) -> None:
        """Press and release a key, named as in ``KeyboardEvent.key``."""
        text = {"text": key} if len(key) == 1 else {}
        self.call("Input.dispatchKeyEvent", type="keyDown", key=key, **text)
        self.call("Input.dispatchKeyEvent", type="keyUp", key=key)

    def screenshot(self, path: Path) -> None:
        """What the window shows, as a PNG file."""
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))
