"""Puts numbers of motors into the text of a robot file, everything else as it was. Pure."""

from collections.abc import Iterable
from difflib import unified_diff
from typing import NamedTuple

import tomlkit
from tomlkit.exceptions import TOMLKitError

from gateway.config import ConfigError, parse


class Change(NamedTuple):
    """One number of the robot file; `key`: of its [[motor]], parts of a table joined by a dot."""

    motor: str
    key: str
    old: float
    new: float


class CorrectionError(ValueError):
    """Why the text cannot be changed so."""


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


def difference(old: str, new: str, origin: str) -> str:
    """What is changed, as `diff -u` has it."""
    lines = unified_diff(old.splitlines(), new.splitlines(), origin, f"{origin}, corrected", lineterm="", n=1)
    return "\n".join(lines)
