"""A small synthetic release, a small real run with a hostile policy name, and their pages."""

from __future__ import annotations

import json
import shutil
import urllib.error
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import pytest

from evaluator.policy import PolicySpec
from evaluator.render import images
from evaluator.view import Viewer, open_source, serving
from rema_data.release.folder import ReleaseFolder
from rema_data.testing import make_release
from tests.evaluator.report.conftest import HOSTILE_NAME, POLICY, evaluate_pushes, write_push_list


@dataclass(frozen=True)
class Client:
    """Asks a server as the page does."""

    address: str

    def get(self, path: str, **parameters: Any) -> tuple[int, Any]:
        """Status, and the content: of JSON what it says, else the bytes."""
        request = f"{self.address}{path}?{urlencode(parameters)}" if parameters else f"{self.address}{path}"
        try:
            with urllib.request.urlopen(request, timeout=60) as answer:
                status, kind, body = answer.status, answer.headers["Content-Type"], answer.read()
        except urllib.error.HTTPError as error:
            status, kind, body = error.code, error.headers["Content-Type"], error.read()
        return status, json.loads(body) if kind == "application/json" else body


@pytest.fixture(scope="session")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> ReleaseFolder:
    """A release of 72 episodes in two rounds; what steps it has never happened."""
    root = tmp_path_factory.mktemp("tiny") / "releases"
    return make_release(root, tasks=("grasp", "grasp_push", "grasp_grasp"), rounds=(1, 2), episodes=10)


@pytest.fixture
def copied(tiny: ReleaseFolder, tmp_path: Path) -> Path:
    """A copy of the release, to be damaged."""
    return Path(shutil.copytree(tiny.path, tmp_path / "copy" / "tiny"))


@pytest.fixture(scope="module")
def viewer(tiny: ReleaseFolder) -> Viewer:
    return Viewer(open_source(str(tiny.path)))


@pytest.fixture(scope="module")
def client(viewer: Viewer) -> Iterator[Client]:
    """A server of the release."""
    with serving(viewer) as address:
        yield Client(address)


@pytest.fixture(scope="module")
def push_run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The folder of a run of real pushes, some of them without an answer; pictures of it are small."""
    folder = tmp_path_factory.mktemp("installation")
    write_push_list(folder / "manifests")
    (folder / "manifests" / "datasets").mkdir()
    (folder / "manifests" / "datasets" / "index.json").write_text('{"releases": []}\n')
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("REMA_MANIFESTS", str(folder / "manifests"))
        patch.setenv("REMA_HOME", str(folder / "home"))
        patch.setattr(images, "PHOTO", (120, 90))
        patch.setattr(images, "FILM", (80, 60))
        patch.setattr(images, "FRAMES", 3)
        evaluate_pushes(folder / "runs" / "push", PolicySpec(HOSTILE_NAME, POLICY, "ScoringPolicy"))
        yield folder / "runs" / "push"
