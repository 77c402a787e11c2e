"""One answer of an interview: what it means, what is allowed, and whether it is; from the models of the robot file."""

import tomllib
from collections.abc import Sequence
from typing import Annotated, Any, Literal, NamedTuple

from annotated_types import Ge, Le, MaxLen, MinLen
from pydantic import BaseModel, TypeAdapter, ValidationError

from gateway.file_keys import allowed

Value = bool | int | float | str


class AnswerError(ValueError):
    """An answer that cannot be; the text says what can."""


class Field(NamedTuple):
    """`allowed`: range and unit in words, empty where everything is."""

    allowed: str
    adapter: TypeAdapter[Any]

    def value(self, given: object) -> Value:
        """The answer, checked. Raises AnswerError."""
        try:
            value: Value = self.adapter.validate_python(given)
        except ValidationError as error:
            words = self.allowed or error.errors()[0]["msg"]
            raise AnswerError(f"{given!r}: must be {words}") from None
        return value

    def read(self, text: str) -> Value:
        """The same from what a person typed: a number, or words without quotes."""
        try:
            given = tomllib.loads(f"answer = {text}")["answer"]
        except tomllib.TOMLDecodeError:
            given = text
        if isinstance(given, bool | int | float | str):
            return self.value(given)
        raise AnswerError(f"{text!r}: must be {self.allowed or 'a number or a word'}")


def field(model: type[BaseModel], key: str) -> Field:
    """The field of a part of the robot file."""
    info = model.model_fields[key]
    kind: Any = info.annotation
    if info.metadata:
        kind = Annotated[(kind, *info.metadata)]
    return Field(allowed(model, [key]) or "", TypeAdapter(kind))


def choice(words: Sequence[str]) -> Field:
    """One of these."""
    kind: Any = Literal[tuple(words)]
    return Field(_or(words), TypeAdapter(kind))


def number(low: float, high: float, unit: str) -> Field:
    """One that is no field by itself."""
    return Field(f"{low:g} to {high:g}, {unit}", TypeAdapter(Annotated[float, Ge(low), Le(high)]))


def whole(low: int, high: int, meaning: str) -> Field:
    """The same without a fraction."""
    return Field(f"{low} to {high}, {meaning}", TypeAdapter(Annotated[int, Ge(low), Le(high)]))


def words(least: int, most: int) -> Field:
    """A text of so many letters."""
    return Field(f"{least} to {most} letters", TypeAdapter(Annotated[str, MinLen(least), MaxLen(most)]))


def _or(words: Sequence[object]) -> str:
    return " or ".join(str(word) for word in words)
