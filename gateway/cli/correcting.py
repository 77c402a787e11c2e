"""A robot file is corrected: shown, asked, written; the one before is kept."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from gateway import robot_files
from gateway.cli.asking import allow
from gateway.cli.output import errors
from gateway.cli.rewriting import rewrite_keeping
from gateway.setup.correction import Change, corrected, difference


def _own(file: Path) -> Path:
    return robot_files.find_own(str(file))


OwnFile = Annotated[
    Path, typer.Argument(callback=_own, help="Robot file, or the name of an installed one; it is corrected.")
]


def correct(file: Path, text: str, changes: Sequence[Change], *, yes: bool) -> Path | None:
    """The copy that is kept; None: nothing is to be changed.

    Raises CorrectionError, NotAllowedError, RewriteError: the file is as it was.
    """
    if not changes:
        errors.print(f"{file} is right", highlight=False)
        return None
    new = corrected(text, changes, str(file))
    allow(difference(text, new, str(file)), f"to write this into {file}", yes=yes)
    kept = rewrite_keeping(file, text, new)
    errors.print(f"{file} is corrected; as it was before: {kept}", highlight=False)
    return kept
