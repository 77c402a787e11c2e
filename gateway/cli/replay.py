"""`drivegate replay`: what to do with a recorded session."""

from pathlib import Path
from typing import Annotated

import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from gateway.cli.output import complain, console, errors, print_json
from replay.session import Session, SessionError, open_session
from replay.verify import Verdict
from replay.verify import verify as run_verify

EXIT_NOT_REPLAYABLE = 2

replay = typer.Typer(help="Re-run recorded sessions.", no_args_is_help=True)


@replay.callback()
def _group() -> None:
    """Re-run recorded sessions."""


@replay.command()
def verify(
    session: Annotated[Path, typer.Argument(help="Session folder, or one .rrd file.")],
    json: Annotated[bool, typer.Option("--json", help="Machine-readable verdict.")] = False,
) -> None:
    """Run the recorded inputs through the same core: would it do the same again? Exit 0 yes, 1 no, 2 cannot tell."""
    try:
        verdict = verify_with_progress(open_session(session))
    except (SessionError, ValueError) as error:
        if json:
            print_json({"identical": False, "problem": str(error)})
        complain(str(error))
        raise typer.Exit(EXIT_NOT_REPLAYABLE) from None
    if json:
        print_json(verdict.as_json())
    else:
        show(verdict)
    raise typer.Exit(verdict.exit_code)


def verify_with_progress(session: Session) -> Verdict:
    """Verify with a progress bar on a terminal."""
    columns = (TextColumn("verifying"), BarColumn(), TextColumn("{task.completed:.0f} cycles"), TimeRemainingColumn())
    with Progress(*columns, console=errors, disable=not errors.is_terminal, transient=True) as progress:
        task = progress.add_task("verify", total=session.cycle_count)
        return run_verify(session, lambda done: progress.advance(task, done))


def show(verdict: Verdict) -> None:
    """The verdict in words."""
    covered = f"{verdict.cycles} cycles, {verdict.frames} frames sent, {verdict.realtime_ratio:.0f} x real time"
    difference = verdict.first_difference
    if difference is not None:
        subject = f" of motor {difference.motor}" if difference.motor else ""
        console.print(f"[red]different[/] in cycle {difference.cycle}: {difference.field}{subject}")
        console.print(f"  recorded {difference.recorded}\n  replayed {difference.replayed}", highlight=False)
    elif verdict.identical:
        console.print(f"[green]identical[/]: {covered}")
    else:
        console.print(f"[yellow]not replayable to the end[/]: {verdict.problem} ({covered} were identical)")
