"""Weights of a pickle as safetensors: ``python -m evaluator.policy.conversion weights.pt [--trust] [--key NAME]``.

The owner of the file runs it; the evaluator never does. With ``--trust`` it opens the whole pickle, which runs the code
in it. The file may hold a state dict, a network, or a dictionary that has one of them under some name.
"""

from __future__ import annotations

import pickle
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rema_data.errors import InputError, MissingFileError, RemaError
from rema_data.storage import write_atomic

if TYPE_CHECKING:
    import torch

__all__ = ["convert"]


def convert(path: Path, output: Path | None = None, *, key: str | None = None, trust: bool = False) -> Path:
    """Write the tensors of a pickle of ``torch.save`` as safetensors, and return the path of the new file.

    ``output`` must not exist; by default it is ``path`` with the suffix ``.safetensors``. ``key`` names the state dict
    where the file holds more than one, and ``trust`` says whether the pickle may run code.

    Raises MissingFileError without the file, StorageError where the output cannot be written, and InputError where it
    exists, where the pickle cannot be opened (or not without ``trust``), or where it has no state dict, or several and
    no ``key``.
    """
    from safetensors.torch import save

    target = output or path.with_suffix(".safetensors")
    if target.exists():
        raise InputError(f"{target} exists already", hint="remove it, or name another: --output FILE", path=target)
    tensors = _state_dict(_opened(path, trust), path, key)
    # Tensors that share memory are refused by the format; each is written by itself.
    write_atomic(target, save({name: tensor.detach().cpu().clone().contiguous() for name, tensor in tensors.items()}))
    return target


def _opened(path: Path, trust: bool) -> Any:
    import torch

    if not path.is_file():
        raise MissingFileError(f"{path} does not exist", hint="check the path", path=path)
    try:
        return torch.load(path, map_location="cpu", weights_only=True)
    except pickle.UnpicklingError as error:
        if not trust:
            raise InputError(
                f"{path} holds more than tensors: {str(error).splitlines()[0]}",
                hint="if you know who made it, open it as the program that it is: add --trust",
                path=path,
            ) from None
    try:
        return torch.load(path, map_location="cpu", weights_only=False)
    except Exception as error:  # code in a pickle may raise anything
        raise InputError(
            f"{path} cannot be opened: {type(error).__name__}: {error}",
            hint="run this in the folder of the code that saved it",
            path=path,
        ) from error


def _state_dict(found: Any, path: Path, key: str | None) -> Mapping[str, torch.Tensor]:
    """The tensors by name: of the whole file, or of the one entry that is a state dict."""
    if key is not None:
        entry = found.get(key) if isinstance(found, Mapping) else None
        tensors = _tensors(entry)
        if tensors is None:
            raise InputError(f"{path} has no state dict under {key!r}", hint="leave --key out to see what it has")
        return tensors
    whole = _tensors(found)
    if whole is not None:
        return whole
    entries = found if isinstance(found, Mapping) else {}
    inside = {str(name): tensors for name, entry in entries.items() if (tensors := _tensors(entry)) is not None}
    if len(inside) == 1:
        return next(iter(inside.values()))
    if inside:
        raise InputError(
            f"{path} has more than one state dict: {', '.join(inside)}", hint=f"name one: --key {next(iter(inside))}"
        )
    what = f"a dictionary of {', '.join(map(str, entries)) or 'nothing'}" if entries else type(found).__name__
    raise InputError(f"{path} has no state dict: it is {what}", hint="save one: torch.save(network.state_dict(), FILE)")


def _tensors(found: Any) -> Mapping[str, torch.Tensor] | None:
    """``found`` as a state dict, if it is one or is a network."""
    import torch

    content = found.state_dict() if isinstance(found, torch.nn.Module) else found
    if not isinstance(content, Mapping) or not content:
        return None
    if not all(isinstance(name, str) and isinstance(value, torch.Tensor) for name, value in content.items()):
        return None
    return content


@click.command()
@click.argument("path", type=click.Path(path_type=Path))
@click.option("--output", type=click.Path(path_type=Path), help="[default: PATH with the suffix .safetensors]")
@click.option("--key", help="Name of the state dict in a file that has several.")
@click.option("--trust", is_flag=True, help="Open it even if it is a program, which is then run.")
def _main(path: Path, output: Path | None, key: str | None, trust: bool) -> None:
    """Write the weights in PATH, a pickle, as safetensors."""
    try:
        click.echo(str(convert(path, output, key=key, trust=trust)))
    except RemaError as error:
        click.echo(str(error), err=True)
        sys.exit(error.exit_code)


if __name__ == "__main__":
    _main()
