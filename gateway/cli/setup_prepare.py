"""`drivegate setup prepare`: what the robot file needs of its controllers, beside how they are; set after a yes."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Final

import typer
from rich.table import Table

from drivers.odrive.endpoints import EndpointError, FlatEndpoints, read_flat
from gateway.cli.asking import Yes
from gateway.cli.correcting import OwnFile
from gateway.cli.output import console, in_words, print_json
from gateway.cli.preparing import PrepareError, Preparing, to_ourselves
from gateway.cli.refusing import EXIT_REFUSED, refuse
from gateway.cli.rewriting import RewriteError
from gateway.config import Motor, RobotConfig, load
from gateway.edges.can_adapter import AdapterError
from gateway.setup.correction import CorrectionError
from gateway.setup.preparation import Line, Verdict, wrong
from gateway.setup.prepare_odrive import A_YES

LONGEST_FILE: Final = 4_000_000  # bytes
INTERRUPTED: Final = (
    "interrupted: what was written and not yet saved is gone once the controller was switched off and on"
)
_STYLES: Final = {Verdict.OK: "green", Verdict.NO: "red", Verdict.UNKNOWN: "yellow"}


def prepare(  # noqa: PLR0917  # a command line: each parameter is an option with a name
    file: OwnFile,
    motors: Annotated[list[str] | None, typer.Argument(help="Only these of its motors.")] = None,
    endpoints: Annotated[
        list[Path] | None,
        typer.Option(help="ODrive 0.6: the vendor's flat_endpoints.json; once more for other hardware."),
    ] = None,
    watchdog: Annotated[
        float | None, typer.Option(min=0.003, max=1.0, help="S; for ODrives whose watchdog the robot file waives.")
    ] = None,
    calibrate: Annotated[
        bool, typer.Option("--calibrate", help="ODrive 0.6: have motors calibrated that are not; they turn. Asks anew.")
    ] = False,
    seconds: Annotated[float, typer.Option(min=0.5, max=60.0, help="How long to listen.")] = 2.0,
    yes: Yes = False,
    json: Annotated[bool, typer.Option("--json", help="Machine-readable report.")] = False,
) -> None:
    """Compare what the robot file needs with what its controllers are set to, and set that where you say yes.

    It listens first, and asks ODrives of firmware 0.6 for their settings; nothing turns without --calibrate. Exit 1
    where something is not as the robot file needs it, and is not set.
    """
    config, text = load(file)
    try:
        flats = {str(path): _flat(path) for path in endpoints or []}
        work = Preparing(config, _chosen(config, motors or []), flats, seconds)
        with to_ourselves(work.motors, config):
            work.look()
            if not json:
                _show(config.robot.name, work)
            work.set(yes=yes)
            kept = work.correct(file, text, watchdog, yes=yes)
        if calibrate:
            work.calibrate(yes=yes)
    except (PrepareError, EndpointError, AdapterError, RewriteError, CorrectionError, KeyboardInterrupt) as error:
        refuse(error, json=json, interrupted=INTERRUPTED)
    bad = wrong(work.lines)
    if json:
        rows = [line._asdict() | {"verdict": line.verdict.value} for line in work.lines]
        told = {"lines": rows, "changed": work.changed, "by_hand": work.by_hand()}
        print_json({"ok": not bad, "kept": kept and str(kept)} | told)
    elif work.changed or kept:
        _show_rest(work)
    if bad:
        raise typer.Exit(EXIT_REFUSED)


def _flat(path: Path) -> FlatEndpoints:
    """Raises PrepareError."""
    try:
        with path.open("rb") as source:
            data = source.read(LONGEST_FILE + 1)
        if len(data) > LONGEST_FILE:
            raise PrepareError(f"{path}: is longer than {LONGEST_FILE} bytes: must be flat_endpoints.json")
        return read_flat(data.decode())
    except OSError as error:
        raise PrepareError(in_words(error)) from None
    except UnicodeDecodeError:
        raise PrepareError(f"{path}: is no text") from None
    except EndpointError as error:
        raise PrepareError(f"{path}: {error}") from None


def _chosen(config: RobotConfig, names: Sequence[str]) -> list[Motor]:
    """Raises PrepareError."""
    known = [motor.name for motor in config.motor]
    for name in names:
        if name not in known:
            raise PrepareError(f"motor {name!r}: no such [[motor]]; there is {', '.join(known)}")
    return [motor for motor in config.motors_in_order() if motor.name in (names or known)]


def _show(robot: str, work: Preparing) -> None:
    """All of it, for a person."""
    table = Table("motor", title=f"what {robot} needs")
    for head in ("what", "wanted", "found", ""):
        table.add_column(head, overflow="fold")
    for line in work.lines:
        style = _STYLES[line.verdict]
        table.add_row(line.motor, line.what, line.wanted, line.found, f"[{style}]{line.verdict.value}[/]")
    console.print(table)
    for said in _advice(work.lines):
        _say(said)
    for motor, steps in work.by_hand().items():
        _say(f"{motor}, by the vendor's tool:")
        for step in steps:
            _say(f"  {step}")


def _advice(lines: Sequence[Line]) -> list[str]:
    """What to do, each once, and for which motors; what a yes sets is shown before it is asked."""
    motors: dict[tuple[str, str], list[str]] = {}
    for line in lines:
        if line.todo not in ("", A_YES):
            motors.setdefault((line.what, line.todo), []).append(line.motor)
    return [f"{what} ({', '.join(names)}): {todo}" for (what, todo), names in motors.items()]


def _show_rest(work: Preparing) -> None:
    """What is still not as needed, or not known, after something was set."""
    rest = [line for line in work.lines if line.verdict is not Verdict.OK]
    for line in rest:
        _say(f"{line.verdict.value}: {line.motor}, {line.what}: {line.found} (wanted: {line.wanted or 'nothing'})")
    if not rest:
        _say(f"everything of {', '.join(motor.name for motor in work.motors)} is as the robot file needs it")


def _say(text: str) -> None:
    console.print(text, markup=False, highlight=False, soft_wrap=True)
