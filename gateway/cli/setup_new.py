"""`drivegate setup new`: an interview that writes a robot file."""

import os
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Final

import typer

from gateway.cli.asking import NotAllowedError, ask
from gateway.cli.output import EXIT_CONFIG, complain, console, errors, print_json
from gateway.cli.refusing import refuse
from gateway.config import document_of, read
from gateway.core.examination import examined
from gateway.setup.fields import AnswerError, Field, Value
from gateway.setup.interview import Question, robot_file

STAND_INS: Final = (1, 3, "robot")  # for what is missing: so it is told at once what else is


class Asker:
    """Answers from those given, else from a person, else the default.

    `left`: given and not asked for yet. `missing`: what nobody answers, in words; then the answers are worth nothing.
    """

    def __init__(self, given: Mapping[str, object], *, person: bool) -> None:
        self.left = dict(given)
        self.answers: dict[str, Value] = {}
        self.missing: list[str] = []
        self._person = person

    def __call__(self, question: Question) -> Value:
        """Raises AnswerError for an answer given that cannot be, or that nobody gives and others depend on."""
        self.answers[question.key] = self._answer(question)
        return self.answers[question.key]

    def _answer(self, question: Question) -> Value:
        if question.key in self.left:
            given = self.left.pop(question.key)
            try:
                return question.field.read(given) if isinstance(given, Typed) else question.field.value(given)
            except AnswerError as error:
                # Its range may come from what stands in for an answer that is missing.
                raise AnswerError("\n".join(self.missing) or f"{question.key}: {error}") from None
        if self._person:
            return self._asked(question)
        if question.default is None:
            self.missing.append(f"{question.key}: missing: {question.words} It is {question.field.allowed}")
            return self._stand_in(question.field)
        return question.default

    def _stand_in(self, field: Field) -> Value:
        for value in STAND_INS:
            with suppress(AnswerError):
                return field.value(value)
        raise AnswerError("\n".join(self.missing))

    @staticmethod
    def _asked(question: Question) -> Value:
        """Until the answer can be; nothing typed is the default."""
        allowed = f" ({question.field.allowed})" if question.field.allowed else ""
        default = "" if question.default is None else f" [{question.default}]"
        while True:
            typed = ask(f"{question.words}{allowed}{default}")
            if not typed and question.default is not None:
                return question.default
            try:
                return question.field.read(typed)
            except AnswerError as error:
                complain(str(error))


class Typed(str):
    """An answer of the command line, which has no type yet."""

    __slots__ = ()


def new(
    file: Annotated[Path, typer.Argument(help="Robot file to be written; there must be none yet.")],
    answers: Annotated[Path | None, typer.Option(help="TOML with answers by key; the rest is asked.")] = None,
    given: Annotated[list[str] | None, typer.Option("--set", help="KEY=VALUE, one answer; again for more.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Machine-readable result.")] = False,
) -> None:
    """Ask what a robot is made of, and write a commented robot file for it. Exit 78 if that needs another look.

    Without a terminal nothing is asked: what is not given is the default, or missing.
    """
    try:
        asker = Asker(_given(answers, given or ()), person=sys.stdin is not None and sys.stdin.isatty())
        text = _written(file, asker)
    except (AnswerError, NotAllowedError, KeyboardInterrupt, OSError) as error:
        refuse(error, json=json)
    problems, warnings = _checked(text, file)
    if json:
        answered = dict(asker.answers)
        print_json({"ok": not problems, "answers": answered, "problems": problems, "warnings": warnings})
    else:
        _tell(file, problems, warnings)
    if problems:
        raise typer.Exit(EXIT_CONFIG)


def _written(file: Path, asker: Asker) -> str:
    """The text that is in the file now. Raises AnswerError, NotAllowedError, OSError."""
    if file.exists():
        raise AnswerError(f"{file}: is there already, and stays as it is")
    if not (
        file.parent.is_dir() and os.access(file.parent, os.W_OK)
    ):  # asked before a person answers, whose answers would be lost
        raise AnswerError(f"{file}: cannot be written: {file.parent} is no folder that is there and may be written to")
    text = robot_file(asker)
    if asker.missing:
        raise AnswerError("\n".join(asker.missing))
    if asker.left:
        raise AnswerError(f"{', '.join(asker.left)}: nobody asked for that; asked was {', '.join(asker.answers)}")
    with file.open("x", encoding="utf-8") as place:
        place.write(text)
    return text


def _given(answers: Path | None, options: Sequence[str]) -> dict[str, object]:
    """By key, tables joined by dots. Raises AnswerError, ConfigError."""
    found: dict[str, object] = {}
    if answers is not None:
        found = _flat(document_of(read(answers), str(answers)))
    for option in options:
        key, equals, value = option.partition("=")
        if not equals:
            raise AnswerError(f"--set {option}: must be KEY=VALUE")
        found[key] = Typed(value)
    return found


def _flat(table: Mapping[str, object], before: str = "") -> dict[str, object]:
    found: dict[str, object] = {}
    for key, value in table.items():
        found |= _flat(value, f"{before}{key}.") if isinstance(value, dict) else {f"{before}{key}": value}
    return found


def _checked(text: str, file: Path) -> tuple[list[str], list[str]]:
    """Problems and warnings of `drivegate check`."""
    told = examined(text, str(file))
    return list(told.problems), [] if told.report is None else list(told.report.warnings)


def _tell(file: Path, problems: Sequence[str], warnings: Sequence[str]) -> None:
    for problem in problems:
        complain(f"{file}: {problem}")
    for warning in warnings:
        errors.print(f"warning: {warning}", highlight=False, markup=False)
    fits = "is written, and has to be corrected" if problems else "is written, and can be driven with"
    words = f"{file} {fits}. Next: `drivegate setup prepare {file}`"
    console.print(words, highlight=False, markup=False, soft_wrap=True)
