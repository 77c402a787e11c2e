"""What the keys of a file that people write may be: meaning, unit, range, default, read from its model.

How this works
--------------
The fields of the models are the only home: a key's `Field` has range and meaning, `Unit` what it is counted in, `Form`
what a text has to be like. Messages about a wrong value, `drivegate explain` and `drivegate format` all read them here.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from enum import Enum
from types import NoneType, UnionType
from typing import Annotated, Final, Literal, NamedTuple, TypeGuard, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt, MaxLen, MinLen
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails, PydanticUndefined

from gateway.guess import guess
from gateway.sections import Form, Unit

_SAID_BY_US: Final = ("value_error", "assertion_error")  # types of errors whose words are ours already
_UNKNOWN_KIND: Final = ("union_tag_invalid", "union_tag_not_found")
_PLACE: Final = re.compile(r"\[\d*\]")  # of a table in a list, as messages have it: motor[0].id
_KEY: Final = "[key]"  # ends the place of a key that is wrong itself
_FORMS: Final[dict[object, str]] = {
    float: "a number",
    int: "a whole number",
    str: "a text",
    bool: "true or false",
}


class Rule(NamedTuple):
    """What one key may be. `key`: as it is written, without the places of tables in a list, of which `chassis`.

    `allowed`: in words, with range and unit. `default`: as it is written; None: the key is required.
    """

    key: str
    chassis: str | None
    meaning: str
    unit: str | None
    allowed: str
    default: str | None
    table: bool

    @property
    def needed(self) -> str:
        """Whether it may be left out, and what it is then."""
        return "required" if self.default is None else f"default {self.default}"


def rules(model: type[BaseModel]) -> Iterator[Rule]:
    """Every key, tables before what is in them, in the order of the model."""
    yield from _below("", model, None)


def matching(every: Sequence[Rule], word: str) -> list[Rule]:
    """The key and, of a table, the keys in it; else every key that ends so. Names in a table stand for the table."""
    asked = _PLACE.sub("", word)
    exact = {rule.key for rule in every}
    while asked not in exact and "." in asked and asked.rpartition(".")[0] in exact:
        parent = asked.rpartition(".")[0]
        if any(rule.table for rule in every if rule.key == parent):
            break  # a table whose keys are known has no such key
        asked = parent
    found = [rule for rule in every if rule.key == asked or rule.key.startswith(f"{asked}.")]
    return found or [rule for rule in every if rule.key.endswith(f".{asked}")]


def allowed(model: type[BaseModel], location: Sequence[int | str]) -> str | None:
    """What may stand at this place of a document, in words; None where the model does not say."""
    found = _at(model, location)
    return None if found is None else _allowed(found)


def known_keys(model: type[BaseModel], location: Sequence[int | str]) -> list[str]:
    """The keys of the table at this place."""
    found = FieldInfo.from_annotation(model) if not location else _at(model, location)
    inner = None if found is None else _plain(found.annotation)
    return list(inner.model_fields) if _is_model(inner) else []


def choices(model: type[BaseModel], location: Sequence[int | str]) -> list[str]:
    """The texts that may stand at this place, where they can be counted."""
    found = _at(model, location)
    return [] if found is None else [one for one in _choices(_plain(found.annotation)) if isinstance(one, str)]


def kinds(model: type[BaseModel], location: Sequence[int | str]) -> list[str]:
    """The kinds of table that may stand at this place, where there are several."""
    found = _at(model, location)
    inner = None if found is None else _plain(found.annotation)
    return [str(_kind_of(one)) for one in get_args(inner) if _is_model(one)] if _is_union(inner) else []


def problem(found: ErrorDetails, document: object, model: type[BaseModel]) -> str:
    """One error in words: key, value, what is allowed, and what may have been meant."""
    place, missing = found["loc"], found["type"] == "missing"
    key = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in _typed(place, document))
    key += f".{place[-1]}" if missing else ""
    value = found["input"]
    if found["type"] in _UNKNOWN_KIND:
        key, value = f"{key}.kind", value.get("kind") if isinstance(value, dict) else None
    shown = "" if missing or value is None or isinstance(value, dict | list) else f" = {value!r}"
    words = _words(found, model)
    return f"{key.lstrip('.')}{shown}: {words}" if key else words


def _words(found: ErrorDetails, model: type[BaseModel]) -> str:
    kind, place, value = found["type"], found["loc"], found["input"]
    if kind == "extra_forbidden":
        return "unknown key" + guess(str(place[-1]), known_keys(model, place[:-1]))
    if kind in _UNKNOWN_KIND:
        known = kinds(model, place)
        given = value.get("kind") if isinstance(value, dict) else None
        words = f"{'missing:' if given is None else 'must be'} one of {', '.join(known)}"
        return words + (guess(given, known) if isinstance(given, str) else "")
    told = allowed(model, place)
    if kind == "missing":
        return "missing" if told is None else f"missing: {told}"
    if kind in _SAID_BY_US or told is None:
        return found["msg"].removeprefix("Value error, ")
    return f"must be {told}" + (guess(value, choices(model, place)) if isinstance(value, str) else "")


def _typed(location: Iterable[int | str], document: object) -> list[int | str]:
    """Of this location what stands in the file: in between are names of kinds that were tried."""
    kept: list[int | str] = []
    for part in location:
        inside = dict(enumerate(document)) if isinstance(document, list) else document
        if isinstance(inside, dict) and part in inside:
            document = inside[part]
            kept.append(part)
    return kept


def _below(path: str, model: type[BaseModel], chassis: str | None) -> Iterator[Rule]:
    for name, field in model.model_fields.items():
        yield from _rules_of(f"{path}{name}", field, chassis)
    extra = _extra(model)
    if extra is not None:
        yield _rule(f"{path}<axis>", extra, chassis, "further axes of the chassis", table=False)


def _rules_of(key: str, field: FieldInfo, chassis: str | None) -> Iterator[Rule]:
    inner = _plain(field.annotation)
    kinds = [one for one in get_args(inner) if _is_model(one)] if _is_union(inner) else []
    item = _item(field)
    table = inner if item is None else _plain(item.annotation)
    if kinds:
        yield _rule(key, field, None, field.description, table=True)
        for kind in kinds:
            yield from _below(f"{key}.", kind, str(_kind_of(kind)))
    elif _is_model(table):
        yield _rule(key, field, chassis, field.description, table=True)
        yield from _below(f"{key}.", table, chassis)
    else:
        yield _rule(key, field, chassis, field.description, table=False)


def _rule(key: str, field: FieldInfo, chassis: str | None, meaning: str | None, *, table: bool) -> Rule:
    default, unit = None if field.is_required() else _written(field.default), _metadata(field, Unit, "name")
    return Rule(key, chassis, meaning or "", None if unit is None else str(unit), _allowed(field), default, table)


def _kind_of(kind: type[BaseModel]) -> object:
    """The name of a kind of table: the only value of its `kind`; None where it has none."""
    field = kind.model_fields.get("kind")
    return None if field is None else next(iter(get_args(field.annotation)), None)


def _at(model: type[BaseModel], location: Sequence[int | str]) -> FieldInfo | None:
    """The field at a place of a document, as the validator names it."""
    if location and location[-1] == _KEY:
        table = _at(model, location[:-2])
        return None if table is None else FieldInfo.from_annotation(get_args(_plain(table.annotation))[0])
    field: FieldInfo | None = FieldInfo.from_annotation(model)
    for part in location:
        if field is None:
            return None
        field = _into(field, part)
    return field


def _into(field: FieldInfo, part: int | str) -> FieldInfo | None:
    inner = _plain(field.annotation)
    if _is_union(inner):
        kinds = [one for one in get_args(inner) if _is_model(one) and _kind_of(one) == part]
        return FieldInfo.from_annotation(kinds[0]) if kinds else None
    if _is_model(inner) and isinstance(part, str):
        return inner.model_fields.get(part) or _extra(inner)
    item = _item(field)
    if item is None:
        return None
    units = [one for one in field.metadata if isinstance(one, Unit)]  # of each number of the list or table
    item.metadata = [*item.metadata, *units]
    return item


def _item(field: FieldInfo) -> FieldInfo | None:
    """Of what a list or a table of free keys is made."""
    inner = _plain(field.annotation)
    if get_origin(inner) in (list, tuple):
        return FieldInfo.from_annotation(get_args(inner)[0])
    return FieldInfo.from_annotation(get_args(inner)[1]) if get_origin(inner) is dict else None


def _extra(model: type[BaseModel]) -> FieldInfo | None:
    """Of the keys beyond those of the model, where it takes any."""
    given = model.__annotations__.get("__pydantic_extra__")
    return None if given is None else FieldInfo.from_annotation(get_args(given)[1])


def _plain(annotation: object) -> object:
    """Without what only says that it may be left out, or has more to say of it."""
    if get_origin(annotation) is Annotated:
        return _plain(get_args(annotation)[0])
    if _is_union(annotation):
        others = [one for one in get_args(annotation) if one is not NoneType]
        return _plain(others[0]) if len(others) == 1 else annotation
    return annotation


def _is_union(annotation: object) -> bool:
    return get_origin(annotation) in (Union, UnionType)


def _is_model(annotation: object) -> TypeGuard[type[BaseModel]]:
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)


def _choices(inner: object) -> list[object]:
    if get_origin(inner) is Literal:
        return list(get_args(inner))
    if isinstance(inner, type) and issubclass(inner, Enum):
        return [one.value for one in inner]
    return []


def _metadata(field: FieldInfo, kind: type, attribute: str) -> object:
    """Of a field, or of what it may be besides left out."""
    found = [getattr(one, attribute) for one in _every_metadata(field) if isinstance(one, kind)]
    return found[-1] if found else None


def _every_metadata(field: FieldInfo) -> list[object]:
    inner = field.annotation
    inside: list[object] = []
    if _is_union(inner):
        for one in get_args(inner):
            if get_origin(one) is Annotated:
                inside += FieldInfo.from_annotation(one).metadata
    return [*inside, *field.metadata]


def _allowed(field: FieldInfo) -> str:
    inner = _plain(field.annotation)
    form = _metadata(field, Form, "words")
    if form is not None:
        return str(form)
    found = _choices(inner)
    if found:
        return " or ".join(", ".join(map(_written, found)).rsplit(", ", 1))
    item = _item(field)
    if item is not None:
        return _many(field, inner, item)
    if _is_model(inner) or (_is_union(inner) and any(map(_is_model, get_args(inner)))):
        return "a table"
    if inner is str:
        return "a text" + _sizes(field, "characters")
    return _FORMS.get(inner, "a number, a text, true or false") + _range(field)


def _many(field: FieldInfo, inner: object, item: FieldInfo) -> str:
    units = [one for one in field.metadata if isinstance(one, Unit)]
    item.metadata = [*item.metadata, *units]
    if get_origin(inner) is tuple:
        return f"a list of {len(get_args(inner))}, each {_allowed(item)}"
    if get_origin(inner) is dict:
        return f"a table{_sizes(field, 'keys')} of names, each with {_allowed(item)}"
    if _is_model(_plain(item.annotation)):
        return "tables" + _sizes(field, "of them")
    return f"a list{_sizes(field, 'long')}, each {_allowed(item)}"


def _sizes(field: FieldInfo, of: str) -> str:
    low, high = _metadata(field, MinLen, "min_length"), _metadata(field, MaxLen, "max_length")
    if high is None:
        return ""
    return f" of {low} to {high} {of}" if low else f" of up to {high} {of}"


def _range(field: FieldInfo) -> str:
    low, above = _metadata(field, Ge, "ge"), _metadata(field, Gt, "gt")
    high, below = _metadata(field, Le, "le"), _metadata(field, Lt, "lt")
    unit = _metadata(field, Unit, "name")
    least = f"above {_number(above)}" if above is not None else None if low is None else _number(low)
    most = f"below {_number(below)}" if below is not None else None if high is None else _number(high)
    span = "" if least is None or most is None else f", {least} to {most}"
    return f"{span} {unit}" if unit is not None and span else f", {unit}" if unit is not None else span


def _number(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _written(value: object) -> str:
    """As it stands in a file."""
    match value:
        case Enum():
            text = _written(value.value)
        case bool():
            text = str(value).lower()
        case str():
            text = f'"{value}"'
        case list():
            text = f"[{', '.join(map(_written, value))}]"
        case Mapping():
            text = "{ }"
        case BaseModel():
            text = "that of each of its keys"
        case _:
            text = "none" if value in (None, PydanticUndefined) else str(value)
    return text
