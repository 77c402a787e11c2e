"""Puts numbers of motors into the text of a robot file, everything else as it was. Pure."""

from collections.abc import Iterable
from difflib import unified_diff

import tomlkit
from tomlkit.exceptions import TOMLKitError

from gateway.config import ConfigError, parse
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


def difference(old: str, new: str, origin: str) -> str:
    """What is changed, as `diff -u` has it."""
    lines = unified_diff(old.splitlines(), new.splitlines(), origin, f"{origin}, corrected", lineterm="", n=1)
    return "\n".join(lines)
