"""A path in the home folder of a user whom this machine does not know is a path that does not exist."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from baselines.publish.networks import is_networks, publish_networks
from baselines.rounds.plan import load_plan
from evaluator.policy.loading import check_checkpoint, resolve
from evaluator.view.opening import open_source
from rema_data.download import download
from rema_data.errors import InputError, MissingFileError
from rema_data.release.folder import find_release
from tests.baselines.rounds.fakes import write_plan

ROOT = Path(__file__).resolve().parents[2]
NOBODY = "~nobody-of-this-name"


@pytest.mark.parametrize(
    "open_path",
    [
        lambda: resolve(f"{NOBODY}/policy.py"),
        lambda: check_checkpoint(Path(NOBODY)),
        lambda: open_source(NOBODY),
        lambda: find_release(NOBODY),
        lambda: download(manifest=f"{NOBODY}/manifest.json"),
        lambda: publish_networks(NOBODY, Path("out"), "MIT"),
    ],
)
def test_it_is_not_there(open_path: Callable[[], object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises((InputError, MissingFileError), match=NOBODY):
        open_path()
    assert not is_networks(NOBODY) and not list(tmp_path.iterdir())


@pytest.mark.parametrize("policy", [f'{{ code = "tae", checkpoint = "{NOBODY}" }}', f'"{NOBODY}/policy.py"'])
def test_it_is_not_there_for_a_plan(policy: str, tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match=NOBODY):
        load_plan(write_plan(tmp_path, **{'policy = "random"': f"policy = {policy}"}))


def test_no_path_is_expanded_in_another_way() -> None:
    """``Path.expanduser`` raises a RuntimeError there; ``os.path.expanduser`` leaves such a path as it is."""
    files = [path for name in ("rema_data", "evaluator", "baselines") for path in (ROOT / name).rglob("*.py")]
    assert not [path for path in files if ".expanduser()" in path.read_text(encoding="utf-8")]
