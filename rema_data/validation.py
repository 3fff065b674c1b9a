"""Records from JSON and TOML that a person or another program wrote: checked by pydantic, errors in our own form.

Declare a record as ``@record`` dataclass; read it with ``validated``. Unknown fields are refused, and no value is
converted to another type: ``"3"`` is not a number. A list may stand for a tuple and text for a path or an enum, since
JSON and TOML have no such types. Rules of a single record are ``pydantic.field_validator`` and ``model_validator``
methods that raise ValueError with one plain sentence.
"""

from __future__ import annotations

import json
from functools import lru_cache
from typing import Any, TypeVar, dataclass_transform

import pydantic
import pydantic.dataclasses

from rema_data.errors import InputError, RemaError

__all__ = ["plain", "record", "validated"]

T = TypeVar("T")
_STRICT = pydantic.ConfigDict(extra="forbid", strict=True, arbitrary_types_allowed=True)
_MOST_NAMED = 5


@dataclass_transform(frozen_default=True)
def record(kind: type[T]) -> type[T]:
    """Class decorator: a frozen dataclass whose fields are checked when it is made."""
    return pydantic.dataclasses.dataclass(frozen=True, config=_STRICT)(kind)  # type: ignore[return-value]


@lru_cache(maxsize=64)
def _adapter(kind: Any) -> pydantic.TypeAdapter[Any]:
    return pydantic.TypeAdapter(kind)


def validated(
    kind: type[T],
    content: Any,
    where: str,
    *,
    at: str = "",
    hint: str = "fix the file",
    error: type[RemaError] = InputError,
) -> T:
    """``content`` as a ``kind``.

    Parameters
    ----------
    kind : type
        A ``record``, or any type that pydantic understands.
    content : object
        As ``json.loads`` or ``tomllib.loads`` gives it.
    where : str
        The file or address that it came from, for messages.
    at : str
        Its place in that file, such as ``rounds[1]``: comes before the names of fields in messages.
    hint : str
        What to do about an error.
    error : type of RemaError
        Raised where ``content`` is not one.

    Raises
    ------
    RemaError
        Of type ``error``: it names ``where``, every field that is wrong (at most five) and what is wrong with it;
        ``facts["field"]`` is the first of them.
    """
    try:
        text = json.dumps(content, default=str)
    except (RecursionError, ValueError) as failure:
        raise error(f"{where}: {at or 'it'} is nested too deeply", hint=hint, path=where, field=at) from failure
    try:
        found: T = _adapter(kind).validate_json(text)  # type: ignore[arg-type]
        return found
    except pydantic.ValidationError as failure:
        wrong = [(_place((at, *item["loc"])), _reason(item)) for item in failure.errors(include_url=False)]
        lines = [f"{field} {reason}" if field else reason for field, reason in wrong[:_MOST_NAMED]]
        if len(wrong) > _MOST_NAMED:
            lines.append(f"and {len(wrong) - _MOST_NAMED} more")
        raise error(f"{where}: {'; '.join(lines)}", hint=hint, path=where, field=wrong[0][0]) from failure


def plain(value: Any) -> Any:
    """A ``record`` as ``json.loads`` would give it: the inverse of ``validated``."""
    return pydantic.TypeAdapter(type(value)).dump_python(value, mode="json")


def _place(location: tuple[int | str, ...]) -> str:
    """``rounds[0].episodes.train``; pydantic marks an unusable key of a table with ``[key]``."""
    parts = (part for part in location if part not in ("", "[key]"))
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in parts).strip(".")


def _reason(item: Any) -> str:
    kind, value = item["type"], repr(item["input"])
    if kind == "missing":
        return "is missing"
    if kind in ("extra_forbidden", "unexpected_keyword_argument"):
        return "is not a known field"
    shown = value if len(value) <= 60 else f"{value[:57]}..."
    if kind == "value_error":
        return str(item["ctx"]["error"]).replace("\n", ": ")  # a RemaError with its hint
    return f"is {shown}: {item['msg'][0].lower()}{item['msg'][1:]}"
