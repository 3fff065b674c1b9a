from __future__ import annotations

from dataclasses import field
from typing import Annotated, Literal

import pydantic
import pytest

from rema_data.errors import InputError, IntegrityError
from rema_data.schema import Shape
from rema_data.validation import plain, record, validated


@record
class Wheel:
    size: Annotated[int, pydantic.Field(ge=1)]
    shape: Shape = Shape.I


@record
class Cart:
    name: str
    wheels: tuple[Wheel, ...]
    tags: dict[str, str] = field(default_factory=dict)

    @pydantic.field_validator("name")
    @classmethod
    def _short(cls, name: str) -> str:
        if len(name) > 5:
            raise ValueError("has more than 5 characters")
        return name


def test_lists_become_tuples_and_text_an_enum() -> None:
    cart = validated(Cart, {"name": "a", "wheels": [{"size": 2, "shape": "T"}]}, "cart.json")
    assert cart == Cart("a", (Wheel(2, Shape.T),))


@pytest.mark.parametrize(
    ("content", "field", "says"),
    [
        ({"name": "a"}, "wheels", "cart.json: wheels is missing"),
        ({"name": "a", "wheels": [], "brake": 1}, "brake", "cart.json: brake is not a known field"),
        ({"name": "a", "wheels": [{"size": "2"}]}, "wheels[0].size", "wheels[0].size is '2': "),
        ({"name": "a", "wheels": [{"size": True}]}, "wheels[0].size", "wheels[0].size is True: "),
        ({"name": "a", "wheels": [{"size": 0}]}, "wheels[0].size", "greater than or equal to 1"),
        ({"name": "a long one", "wheels": []}, "name", "cart.json: name has more than 5 characters"),
        ({"name": 3, "wheels": 4}, "name", "; wheels is 4: "),
        ([], "", "cart.json: is []: "),
    ],
)
def test_an_error_names_the_file_and_the_field(content: object, field: str, says: str) -> None:
    with pytest.raises(InputError) as caught:
        validated(Cart, content, "cart.json", hint="edit it")
    assert says in str(caught.value) and str(caught.value).endswith("\nedit it")
    assert caught.value.facts["field"] == field


def test_a_place_in_the_file_comes_before_the_field() -> None:
    for content, place in ({"size": 0}, "carts[2].size"), ([], "carts[2]"):
        with pytest.raises(InputError) as caught:
            validated(Wheel, content, "carts.toml", at="carts[2]")
        assert caught.value.facts["field"] == place and f"carts.toml: {place} is " in caught.value.message


def test_a_key_that_is_not_allowed_is_named() -> None:
    with pytest.raises(InputError, match="colours.red is 'red'") as caught:
        validated(dict[str, dict[Literal["blue"], int]], {"colours": {"red": 1}}, "cart.json")
    assert caught.value.facts["field"] == "colours.red"


def test_an_error_of_rema_keeps_its_hint() -> None:
    def refuse(name: str) -> str:
        raise InputError("no cart has that name", hint="use another one")

    with pytest.raises(InputError, match="no cart has that name: use another one"):
        validated(Annotated[str, pydantic.AfterValidator(refuse)], "a", "cart.json")  # type: ignore[arg-type]


def test_a_record_as_plain_values() -> None:
    cart = Cart("a", (Wheel(2, Shape.T),))
    assert plain(cart) == {"name": "a", "wheels": [{"size": 2, "shape": "T"}], "tags": {}}
    assert validated(Cart, plain(cart), "cart.json") == cart


def test_the_caller_chooses_the_error() -> None:
    with pytest.raises(IntegrityError):
        validated(Cart, None, "cart.json", error=IntegrityError)
