"""Puts numbers into the text of a robot file, everything else as it was. Pure."""

from collections.abc import Iterable, Mapping
from difflib import unified_diff
from typing import Any, NamedTuple

import tomlkit
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import Array, InlineTable

from gateway.config import MOVED_FROM_WATCHDOG, ConfigError, parse
from gateway.core.assembly import build


class Change(NamedTuple):
    """One number of the robot file; `key`: of its [[motor]], parts of a table joined by a dot."""

    motor: str
    key: str
    old: float
    new: float


class CorrectionError(ValueError):
    """Why the text cannot be changed so."""


class Entry(NamedTuple):
    """One number by its keys and places, and what is said behind it."""

    place: tuple[str | int, ...]
    value: float
    note: str


def corrected(text: str, changes: Iterable[Change], origin: str) -> str:
    """The text with these changes; comments and line ends are kept. Raises CorrectionError."""
    try:
        document = tomlkit.parse(text)
        motors = {str(motor["name"]): motor for motor in document["motor"]}
        for change in changes:
            *tables, key = change.key.split(".")
            table = motors[change.motor]
            for name in tables:
                table = table[name]
            table[key] = change.new
        new = tomlkit.dumps(document)
        parse(new, origin)
    except (TOMLKitError, ConfigError, KeyError) as error:
        raise CorrectionError(f"{origin}: cannot be changed: {error}") from None
    return new


def with_entries(text: str, entries: Iterable[Entry], origin: str) -> str:
    """The text with these numbers, each with its note as a comment. Raises CorrectionError."""
    try:
        document = tomlkit.parse(text)
        for entry in entries:
            _put(document, entry)
        new = tomlkit.dumps(document)
        parse(new, origin)
    except (TOMLKitError, ConfigError, KeyError, IndexError) as error:
        raise CorrectionError(f"{origin}: cannot be changed: {error}") from None
    return new


def with_options(text: str, options: Mapping[str, Mapping[str, str | int]], watchdog: float | None, origin: str) -> str:
    """The text with the `options` of some motors changed; where one waives its watchdog, it gets one of so many s.

    Numbers that older robot files have within `watchdog` move. Raises CorrectionError.
    """
    try:
        document = tomlkit.parse(text)
        for motor in document["motor"]:
            if str(motor["name"]) in options:
                _put_options(motor, options[str(motor["name"])], watchdog)
        new = tomlkit.dumps(document)
        build(parse(new, origin), origin)
    except (TOMLKitError, ConfigError, KeyError) as error:
        raise CorrectionError(f"{origin}: cannot be changed: {error}") from None
    return new


def rounded(value: float, half: float) -> float:
    """To about a hundredth of what is not sure of it."""
    exponent = int(f"{half:e}".partition("e")[2])
    return round(value, 2 - exponent) if half > 0.0 else value


def _put(document: tomlkit.TOMLDocument, entry: Entry) -> None:
    table: Any = document
    *path, key = entry.place
    inline: list[Any] = []  # within those a comment would swallow the rest: it goes behind the whole
    for part in path:
        if part not in table and not isinstance(part, int):
            table[part] = tomlkit.table()
        table = table[part]
        inline += [table] if isinstance(table, InlineTable | Array) else []
    table[key] = entry.value
    (inline[0] if inline else table[key]).comment(entry.note)


def _put_options(motor: Any, options: Mapping[str, str | int], watchdog: float | None) -> None:  # noqa: ANN401
    if watchdog is not None and "watchdog" not in motor:
        motor.pop("watchdog_waiver", None)
        motor["watchdog"] = _inline({"timeout": watchdog})
    if MOVED_FROM_WATCHDOG.keys() & motor["watchdog"].keys():
        motor["watchdog"] = _inline({"timeout": motor["watchdog"]["timeout"]})
    if options.keys() <= motor.get("options", {}).keys():
        motor["options"].update(options)  # with the comments that are there
    else:
        motor["options"] = _inline({**motor.get("options", {}), **options})


def _inline(values: Mapping[str, str | int | float]) -> Any:  # noqa: ANN401  of tomlkit
    """A table in one line, spaced as our files have it."""
    items = ", ".join(f"{key} = {tomlkit.item(value).as_string()}" for key, value in values.items())
    return tomlkit.parse(f"made = {{ {items} }}\n")["made"]


def difference(old: str, new: str, origin: str) -> str:
    """What is changed, as `diff -u` has it."""
    lines = unified_diff(old.splitlines(), new.splitlines(), origin, f"{origin}, corrected", lineterm="", n=1)
    return "\n".join(lines)
