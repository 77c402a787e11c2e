"""How the commands speak: tables and progress for people, one JSON line for programs."""

import json
import sys
from collections.abc import Mapping

from rich.console import Console

import gateway.errors

EXIT_CONFIG = gateway.errors.EXIT_CONFIG

console = Console()
errors = Console(stderr=True, soft_wrap=True)


def complain(text: str) -> None:
    """One error, on standard error."""
    errors.print(text, style="red", markup=False, highlight=False)


def in_words(error: Exception) -> str:
    """What an exception says; of the system's with the file in front, where it names one."""
    if isinstance(error, OSError) and error.strerror is not None:
        return error.strerror if error.filename is None else f"{error.filename}: {error.strerror}"
    return str(error)


def note(text: str) -> None:
    """What somebody should know who gets what was asked for, on standard error."""
    errors.print(text, style="dim", markup=False, highlight=False)


def print_json(document: Mapping[str, object]) -> None:
    """The last line of standard output of a command called with --json."""
    sys.stdout.write(json.dumps(document, allow_nan=False) + "\n")
    sys.stdout.flush()
