"""Puts numbers of motors into the text of a robot file, everything else as it was. Pure."""

from collections.abc import Iterable, Mapping
from difflib import unified_diff
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from gateway.config import MOVED_FROM_WATCHDOG, ConfigError, parse
from gateway.core.assembly import build
from gateway.setup.directions import Change


class CorrectionError(ValueError):
    """Why the text cannot be changed so."""


def corrected(text: str, changes: Iterable[Change], origin: str) -> str:
    """The text with these changes; comments and line ends are kept. Raises CorrectionError."""
    try:
        document = tomlkit.parse(text)
        motors = {str(motor["name"]): motor for motor in document["motor"]}
        for change in changes:
            motors[change.motor][change.key] = change.new
        new = tomlkit.dumps(document)
        parse(new, origin)
    except (TOMLKitError, ConfigError, KeyError) as error:
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


def _put_options(motor: Any, options: Mapping[str, str | int], watchdog: float | None) -> None:  # noqa: ANN401
    if watchdog is not None and "watchdog" not in motor:
        motor.pop("watchdog_waiver", None)
        motor["watchdog"] = _inline({"timeout": watchdog})
    if MOVED_FROM_WATCHDOG.keys() & motor["watchdog"].keys():
        motor["watchdog"] = _inline({"timeout": motor["watchdog"]["timeout"]})
    motor["options"] = _inline({**motor.get("options", {}), **options})


def _inline(values: Mapping[str, str | int | float]) -> Any:  # noqa: ANN401  of tomlkit
    """A table in one line, spaced as our files have it."""
    items = ", ".join(f"{key} = {tomlkit.item(value).as_string()}" for key, value in values.items())
    return tomlkit.parse(f"made = {{ {items} }}\n")["made"]


def difference(old: str, new: str, origin: str) -> str:
    """What is changed, as `diff -u` has it."""
    lines = unified_diff(old.splitlines(), new.splitlines(), origin, f"{origin}, corrected", lineterm="", n=1)
    return "\n".join(lines)
