"""`drivegate replay bisect`: the commit at which a recorded drive would first have gone differently."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer
from rich.markup import escape

from gateway.cli.output import complain, console, errors, print_json
from replay.compare.verify import EXIT_NOT_REPLAYABLE
from replay.history.bisect import Answer, Asked, BisectError, Found, bisect
from replay.history.revisions import Repository, Revisions
from replay.sessions.reader import SessionError, open_session

EXIT_SEVERAL = 1
COLOURS = {Answer.GOOD: "green", Answer.BAD: "red", Answer.SKIPPED: "yellow"}


def register(group: typer.Typer) -> None:
    """The command of this file."""
    group.command(name="bisect")(bisect_history)


def bisect_history(
    session: Annotated[Path, typer.Argument(help="Session folder, or one .rrd file.")],
    *,
    good: Annotated[
        str | None, typer.Option(help="Commit that would do the same again. Default: the one that recorded it.")
    ] = None,
    bad: Annotated[str, typer.Option(help="Commit that would not.")] = "HEAD",
    repository: Annotated[Path, typer.Option(help="A git repository of DriveGate.")] = Path(),
    json: Annotated[bool, typer.Option("--json", help="Machine-readable result.")] = False,
) -> None:
    """Find the commit at which a recorded drive would first have gone differently.

    Each commit that is asked is unpacked into a temporary folder and verifies the session itself, with packages of its
    own where it needs others than are installed. The repository and its checkout are only read. A commit that gives no
    verdict is skipped. Exit 0: one commit was found; 1: one of several, for those between gave no verdict; 2: not to
    be found: no session, no repository, or --good or --bad is not what it is said to be.

    --json: first (the commits one of which is the first different one; each with name, subject, author, date and why),
    asked (each with commit, answer: the same, differently or no verdict, and why), or error.
    """
    try:
        found, history = _found(session, good, bad, repository, quiet=json)
        told = [history.told(commit) for commit in found.first]
    except (BisectError, SessionError) as error:
        complain(str(error))
        if json:
            print_json({"error": str(error)})
        raise typer.Exit(EXIT_NOT_REPLAYABLE) from None
    if json:
        asked = [one._asdict() | {"answer": one.answer.value} for one in found.asked]
        print_json({"first": [one._asdict() | {"why": found.why(one.name)} for one in told], "asked": asked})
    else:
        certain = len(told) == 1
        console.print("first different:" if certain else "the first different one is among these:")
        for one in told:
            line = f"{one.name[:12]} {one.date} {one.author}: {one.subject}"
            console.print(f"  {escape(line)}", highlight=False, soft_wrap=True)
            if why := found.why(one.name):
                console.print(f"    {escape(why)}", highlight=False, soft_wrap=True)
    raise typer.Exit(0 if len(told) == 1 else EXIT_SEVERAL)


def _found(session: Path, good: str | None, bad: str, path: Path, *, quiet: bool) -> tuple[Found, Repository]:
    """Raises BisectError, SessionError."""
    header = open_session(session).header
    history = Repository(path)
    first = history.commit(good or _recorder(header.git_commit))
    last = history.commit(bad)
    if first == last or not history.is_ancestor(first, last):
        raise BisectError(f"--good {first[:12]} must be a commit that led to --bad {last[:12]}, and it is not")
    with TemporaryDirectory(prefix="drivegate-") as folder, _told(quiet=quiet) as doing:
        revisions = Revisions(history, session, Path(folder), doing)

        def ask(commit: str) -> Asked:
            doing(f"unpacking {commit[:12]}")
            asked = revisions.ask(commit)
            if not quiet:
                _show(asked, history)
            return asked

        return bisect(first, last, halve=history.halve, ask=ask), history


def _recorder(commit: str | None) -> str:
    if commit is None:
        raise BisectError("the session does not say by which commit it was recorded: tell one with --good")
    if commit.endswith("-dirty"):
        raise BisectError(f"the session was recorded by {commit}, which no commit is: tell one with --good")
    return commit


def _show(asked: Asked, history: Repository) -> None:
    why = f": {asked.why}" if asked.why else ""
    line = f"{asked.commit[:12]}  {history.told(asked.commit).subject}{why}"
    word = f"[{COLOURS[asked.answer]}]{asked.answer.value:11}[/]"
    console.print(f"{word}  {escape(line)}", highlight=False, soft_wrap=True)


@contextmanager
def _told(*, quiet: bool) -> Iterator[Callable[[str], None]]:
    """Says on a terminal what takes time."""
    if quiet or not errors.is_terminal:
        yield lambda _: None
        return
    with errors.status("reading the session") as status:
        yield status.update
