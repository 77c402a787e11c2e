"""`drivegate replay identify`: the unknown parameters of the simulated robot, from a recorded drive."""

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec
import typer
from rich.markup import escape
from rich.table import Table

from gateway.cli.output import complain, console, errors, print_json
from gateway.config import ConfigError
from replay.compare.verify import EXIT_INCOMPLETE, EXIT_NOT_REPLAYABLE
from replay.sessions.reader import Session, SessionError, open_session
from replay.sim.plants.contract import PlantName

if TYPE_CHECKING:
    from replay.identify.identify import Identified

EXIT_NOTHING_FOUND = 1


def register(group: typer.Typer) -> None:
    """The command of this file."""
    group.command()(identify)


def identify(  # noqa: PLR0917  # a command line: each parameter is an option with a name
    session: Annotated[Path, typer.Argument(help="Session folder, or one .rrd file.")],
    known: Annotated[
        list[str] | None, typer.Option(metavar="NAME=VALUE", help="Not to be sought, e.g. mass=131.09.")
    ] = None,
    plant: Annotated[
        PlantName | None, typer.Option(help="Which simulated robot; else the session's, or the one that fits better.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="File of the parameters, for `whatif --closed --parameters`.")
    ] = None,
    plot: Annotated[Path | None, typer.Option(help="Picture of the fit, e.g. fit.png.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Machine-readable answer.")] = False,
) -> None:
    """Find mass, inertias, friction and drag of the simulated robot from a recorded drive, with intervals of 95 %.

    By least squares over the torques that the motors told, against those that the measured motion needs. What the drive
    does not excite is not found, and the reason is told. A torque told counts as true: give a mass with --known, and
    the torque constant is found in its place.

    Exit 0: something was found, 1: nothing, 2: it cannot be looked for, 3: found in an incomplete recording.

    --json: robot, kind, session, plant, found (each value, low, high, unit), not_found (each value, reason), residuals
    and torques (N m rms by motor), seconds, moments; and likeness, slipping, abrupt, problem.
    """
    if plot is not None and plot.suffix.lower() != ".png":
        raise typer.BadParameter(
            f"{plot}: must end in .png, so that no other file becomes a picture", param_hint="--plot"
        )
    parameters = import_module("replay.identify.parameters")
    try:
        opened = open_session(session)
        found = found_in(opened, plant, known or ())
    except (SessionError, ConfigError, parameters.IdentifyError) as error:
        complain(str(error))
        raise typer.Exit(EXIT_NOT_REPLAYABLE) from None
    try:
        if out is not None:
            out.write_bytes(msgspec.json.format(msgspec.json.encode(found.file)) + b"\n")
        if plot is not None:
            import_module("gateway.cli.identify_picture").draw_fit(found, plot)
    except OSError as error:
        complain(f"cannot be written: {error}")
        raise typer.Exit(EXIT_NOT_REPLAYABLE) from None
    if json:
        more = {"likeness": found.likeness, "slipping": found.slipping, "abrupt": found.abrupt}
        print_json({**msgspec.to_builtins(found.file), **more, "problem": opened.problem})
    else:
        _show(found)
        if opened.problem is not None:
            complain(f"{opened.path}: incomplete: {opened.problem}")
    if not found.file.found:
        raise typer.Exit(EXIT_NOTHING_FOUND)
    raise typer.Exit(0 if opened.problem is None else EXIT_INCOMPLETE)


def found_in(session: Session, plant: PlantName | None, known: Sequence[str]) -> "Identified":
    """What can be found, behind a line on a terminal. Raises SessionError, ConfigError, IdentifyError.

    Only here SciPy is imported: it takes a third of a second.
    """
    with errors.status("identifying"):
        module = import_module("replay.identify.identify")
        found: Identified = module.identify(session, plant=plant, known=_known(known))
        return found


def _known(given: Sequence[str]) -> dict[str, float]:
    """Raises IdentifyError."""
    found: dict[str, float] = {}
    for text in given:
        name, _, value = text.partition("=")
        try:
            found[name.strip()] = float(value)
        except ValueError:
            problem = f"--known {text}: must be NAME=VALUE, the value a number"
            raise import_module("replay.identify.parameters").IdentifyError(problem) from None
    return found


def _show(found: "Identified") -> None:
    file = found.file
    table = Table("parameter", "value", "95 %", "unit", title=f"{file.robot}, {file.session}, plant {file.plant}")
    for name, one in file.found.items():
        table.add_row(name, f"{one.value:.5g}", f"{one.low:.5g} to {one.high:.5g}", one.unit)
    for name, refused in file.not_found.items():
        table.add_row(name, f"[dim]{refused.value:.5g}[/]", f"[yellow]{escape(refused.reason)}[/]", "")
    console.print(table)
    for motor, left in file.residuals.items():
        console.print(f"  {motor}: {left:.3g} N m left over of {file.torques[motor]:.3g} (rms)", highlight=False)
    console.print(f"  {file.moments} instants of {file.seconds:g} s{_left_out(found)}", highlight=False)
    if found.likeness == 0:
        console.print(
            "  [yellow]the simulated robot does not follow this drive: what measuring shifts is not made up for[/]"
        )


def _left_out(found: "Identified") -> str:
    """In words."""
    parts = []
    if found.slipping:
        parts.append(f"{found.slipping} in which wheels slip")
    if found.abrupt:
        parts.append(f"{found.abrupt} too abrupt for torques told so seldom")
    return f"; left out: {', '.join(parts)}" if parts else ""
