"""What only a person may let happen: asked on a terminal, or said beforehand with --yes."""

import sys
from typing import Annotated

import typer

from gateway.cli.output import errors

ANSWER = "yes"
Yes = Annotated[bool, typer.Option("--yes", help="A person stands by and lets it happen: do not ask.")]


class NotAllowedError(RuntimeError):
    """Nobody let it happen."""


def allow(what: str, question: str, *, yes: bool) -> None:
    """Says what will happen, and goes on only after a yes. Raises NotAllowedError."""
    errors.print(what, highlight=False, markup=False)
    if yes:
        return
    if sys.stdin is None or not sys.stdin.isatty():  # None: it was closed
        raise NotAllowedError("a person has to let it happen: run it on a terminal, or stand by and give --yes")
    errors.print(f"Type {ANSWER} {question}: ", end="", highlight=False, markup=False)
    if _typed().strip() != ANSWER:
        raise NotAllowedError("nobody let it happen")


def ask(question: str) -> str:
    """One line of a person, or of a script. Raises NotAllowedError where there is none any more."""
    errors.print(f"{question} ", end="", highlight=False, markup=False)
    line = _typed()
    if not line:
        raise NotAllowedError("nobody answers any more")
    return line.strip()


def _typed() -> str:
    """One line with its end; without one the question has its line for itself, also where a Ctrl-C ended it."""
    line = ""
    try:
        line = "" if sys.stdin is None else sys.stdin.readline()
    finally:
        if not line.endswith("\n"):
            errors.print()
    return line
