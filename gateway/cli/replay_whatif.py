"""`drivegate replay whatif`: what would have been commanded with other settings, or with another robot file?"""

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table

from gateway.cli.output import complain, console, print_json
from gateway.config import ConfigError, load
from replay.compare.verify import EXIT_INCOMPLETE, EXIT_NOT_REPLAYABLE
from replay.compare.what_if import OPEN_LOOP, WhatIf, WhatIfError
from replay.sessions.reader import Session, SessionError, open_session
from replay.sim.plants.contract import PlantName


def whatif(  # noqa: PLR0913, PLR0917  # a command line: each parameter is an option with a name
    session: Annotated[Path, typer.Argument(help="Session folder, or one .rrd file.")],
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="A setting, e.g. compensation_gain=2.5.")
    ] = None,
    robot_file: Annotated[Path | None, typer.Option(help="Another robot file.")] = None,
    begin: Annotated[float, typer.Option("--from", help="s since the first recorded cycle.")] = 0.0,
    closed: Annotated[bool, typer.Option("--closed", help="The simulated robot answers, see `identify`.")] = False,
    parameters: Annotated[
        Path | None, typer.Option(help="With --closed: a file of `identify --out`; else it is done from this session.")
    ] = None,
    plant: Annotated[
        PlantName | None, typer.Option(help="With --closed and no --parameters: as of `identify`.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Recording with both side by side, e.g. whatif.rrd.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Machine-readable answer.")] = False,
) -> None:
    """Run the recorded inputs through the core with other settings or another robot file: what would it have said?

    Open loop: motors and sensors say what they said then, whatever is commanded. Settings are asked for in the first
    cycle from --from on. With another robot file the core begins where the session does, because it can take no state
    from the recorded one, and --from says from where on the answers are compared.

    --closed: the recorded commands drive the simulated robot, with the identified parameters, once as it was set up
    then and once changed. The difference of the two is the answer; that of the first to the recording, how far to trust
    it. There --from is only for settings: another robot file is there from the beginning.

    Exit 0 whether something changes or not; 1 if, --closed, the recorded settings do not reproduce the recorded drive;
    2 if it cannot be answered; 3 if the recording is incomplete.

    --json: changes (motor, channel, cycles, first_t, last_t, largest, largest_t, rms), cycles (compared), unseen,
    began (where the changed core has its state from), open_loop (what that means), problem (what is missing of the
    recording, or null). --closed: changes, cycles, reproduced (recorded settings against the recording, as of `replay
    run`), effect (change against recorded settings), parameters, plant, closed_loop, sensed, problem.
    """
    try:
        opened = open_session(session)
        _check_out(out, opened)
        other = None if robot_file is None else load(robot_file)[0]
        asked = _settings(settings or ())
        if closed:
            raise typer.Exit(
                # Only now: SciPy takes a third of a second.
                import_module("gateway.cli.whatif_closed").closed_loop(
                    opened, asked, other, begin, parameters=parameters, plant=plant, out=out, json=json
                )
            )
        _check_open(parameters, plant)
        question = WhatIf(opened, asked, other, begin)
        _answer(question, opened.path.name, out)
    except (SessionError, WhatIfError, ConfigError) as error:
        complain(str(error))
        raise typer.Exit(EXIT_NOT_REPLAYABLE) from None
    except OSError as error:
        complain(
            f"{error.filename or out}: {error.strerror}" if closed else f"{out}: cannot be written: {error.strerror}"
        )
        raise typer.Exit(EXIT_NOT_REPLAYABLE) from None
    if json:
        print_json(_document(question, opened.problem))
    else:
        _show(question)
        if opened.problem is not None:
            complain(f"{opened.path}: incomplete: {opened.problem}")
    raise typer.Exit(0 if opened.problem is None else EXIT_INCOMPLETE)


def _settings(given: Sequence[str]) -> dict[str, float]:
    """Raises WhatIfError."""
    found: dict[str, float] = {}
    for text in given:
        name, _, value = text.partition("=")
        try:
            found[name.strip()] = float(value)
        except ValueError:
            raise WhatIfError(f"--set {text}: must be NAME=VALUE, the value a number") from None
    return found


def _check_open(parameters: Path | None, plant: PlantName | None) -> None:
    """Raises WhatIfError."""
    if parameters is not None or plant is not None:
        raise WhatIfError("--parameters and --plant are of the simulated robot: give --closed too")


def _check_out(out: Path | None, session: Session) -> None:
    """Raises WhatIfError."""
    if out is not None and out.resolve() in {segment.resolve() for segment in session.segments}:
        raise WhatIfError(f"--out {out}: is of the session itself")


def _answer(question: WhatIf, name: str, out: Path | None) -> None:
    """All of it. Raises WhatIfError, OSError."""
    if out is None:
        for _ in question.steps():
            pass
        return
    from gateway.cli.whatif_recording import Recording  # noqa: PLC0415  # Rerun takes half a second

    sides = {"recorded": question.config, "new": question.new_config}
    with Recording(out, name, sides) as recording:
        for step in question.steps():
            recording.add(step)


def _document(question: WhatIf, problem: str | None) -> dict[str, object]:
    return {
        "changes": [change._asdict() for change in question.changes],
        "cycles": question.cycles,
        "unseen": question.unseen,
        "began": question.began,
        "open_loop": OPEN_LOOP,
        "problem": problem,
    }


def _show(question: WhatIf) -> None:
    changes = question.changes
    if changes:
        table = Table("motor", "what", "cycles", "first", "largest", "at", "rms", title="what changes")
        for one in changes:
            sizes = (_number(one.largest), _number(one.largest_t, " s"), _number(one.rms))
            table.add_row(one.motor or "", escape(one.channel), str(one.cycles), _number(one.first_t, " s"), *sizes)
        console.print(table)
    else:
        console.print("[green]nothing changes[/]")
    console.print(f"  {question.cycles} cycles; the changed core began {question.began}", highlight=False)
    if question.unseen:
        console.print(f"  not compared: {question.unseen} cycles that no state leads to", highlight=False)
    console.print(f"  {OPEN_LOOP}", highlight=False)


def _number(value: float | None, unit: str = "") -> str:
    return "" if value is None else f"{value:.4g}{unit}"
