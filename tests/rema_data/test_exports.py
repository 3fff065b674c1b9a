"""What `import rema_data` offers, and what it costs."""

from __future__ import annotations

import subprocess
import sys

import pytest

import rema_data


@pytest.mark.parametrize("name", rema_data.__all__)
def test_every_name_is_there(name: str) -> None:
    assert getattr(rema_data, name) is not None
    assert name in dir(rema_data)


def test_unknown_names_are_attribute_errors() -> None:
    with pytest.raises(AttributeError, match="no attribute 'lode'"):
        rema_data.lode  # noqa: B018


def test_import_is_light() -> None:
    code = "import sys, rema_data; print(*sorted({'torch', 'pandas', 'pyarrow', 'zarr'} & set(sys.modules)))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == ""


def test_opening_a_published_release_is_light() -> None:
    code = (
        "import sys; from rema_data.release.registry import load_published; load_published('rema-sample')\n"
        "print(*sorted({'torch', 'pandas', 'pyarrow', 'zarr', 'pydantic'} & set(sys.modules)))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == ""


@pytest.mark.parametrize("first", ["import rema_data.download", "from rema_data.download import download"])
def test_names_do_not_depend_on_the_order_of_imports(first: str) -> None:
    """A submodule imported first must not hide what the package offers under its name."""
    code = f"import rema_data; before = type(rema_data.{{}});\n{first}; print(before is type(rema_data.{{}}))"
    run = subprocess.run([sys.executable, "-c", code.format("download", "download")], capture_output=True, text=True)
    assert run.stdout.strip() == "True", run.stderr
