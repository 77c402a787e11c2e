"""How a step of setup ends that was refused, or interrupted: one line of JSON, words, and an exit code."""

from pathlib import Path
from typing import Final, NoReturn

import typer

from gateway.cli.output import complain, in_words, print_json
from gateway.edges.can_adapter import AdapterError
from gateway.errors import EXIT_UNAVAILABLE

EXIT_REFUSED: Final = 1


def refuse(
    error: BaseException, *, json: bool, unchanged: Path | None = None, interrupted: str = "interrupted"
) -> NoReturn:
    """Ends the command; `unchanged`: the file that is as it was. A bus that is not there may be there later: 69."""
    reason = in_words(error) if isinstance(error, Exception) else interrupted
    if json:
        print_json({"ok": False, "reason": reason})
    complain(reason if unchanged is None else f"{reason}; {unchanged} is as it was")
    raise typer.Exit(EXIT_UNAVAILABLE if isinstance(error, AdapterError) else EXIT_REFUSED) from None
