"""`drivegate setup covariance`: how far the odometry may be trusted, from repeated courses whose ends are measured."""

from collections.abc import Sequence
from datetime import date
from importlib import import_module
from math import sqrt
from typing import TYPE_CHECKING

import typer
from rich.markup import escape
from rich.table import Table

from gateway.cli.asking import Yes
from gateway.cli.correcting import OwnFile
from gateway.cli.operate import Connect
from gateway.cli.output import console, errors, print_json
from gateway.cli.refusing import EXIT_REFUSED, refuse
from gateway.cli.setup_courses import (
    REFUSALS,
    USUAL_LENGTH,
    Length,
    Measured,
    Names,
    Out,
    Repeat,
    SessionFolder,
    SourceName,
    Truth,
    Wanted,
    gather,
    write,
)
from gateway.config import load
from gateway.setup.correction import Entry
from gateway.setup.courses import REPEATED, geometry_courses

if TYPE_CHECKING:
    from replay.calibrate.covariance import Growth, Judged
    from replay.calibrate.likelihood import Consistency


def covariance(  # noqa: PLR0913, PLR0917  # a command line: each parameter is an option with a name
    file: OwnFile,
    measured: Measured = None,
    session: SessionFolder = None,
    course: Names = None,
    length: Length = USUAL_LENGTH,
    repeat: Repeat = 8,
    source: SourceName = "teleop",
    truth: Truth = False,
    out: Out = None,
    connect: Connect = None,
    yes: Yes = False,
    json: bool = typer.Option(False, "--json", help="Machine-readable result."),
) -> None:
    """Find by how much the odometry errs by chance, from repeated measured courses; write it into the robot file.

    First `drivegate setup calibrate`: errors that are the same each time are refused. Growths of the covariance are
    found by maximum likelihood, each with its interval of 95 %; whether the errors are as the covariance says (NEES) is
    told before and after. Where courses are too few it is said how many more it would take.
    Exit 0: all three were found, 1: not all, or none.
    """
    config, text = load(file)
    try:
        geometry_courses(config)
        wanted = Wanted(measured, session, course or REPEATED, length, repeat, source, truth, out, connect, yes)
        gathered = gather(file, config, text, wanted)
        with errors.status("judging"):
            found: Judged = import_module("replay.calibrate.covariance").judged(
                config, gathered.courses, gathered.driven
            )
        if not json:
            _show(found)
        kept = write(file, text, entries(found.growths, found.courses), yes=yes)
    except REFUSALS as error:
        refuse(error, json=json, unchanged=file)
    if json:
        print_json(document(found) | {"measured": str(gathered.file), "kept": str(kept)})
    if found.untold:
        raise typer.Exit(EXIT_REFUSED)


def entries(growths: Sequence["Growth"], courses: int) -> list[Entry]:
    """What goes into the robot file, each with its date and how sure it is."""
    today = date.today().isoformat()  # noqa: DTZ011  # of the person who stands there
    return [
        Entry(
            ("odometry", one.key),
            float(f"{one.value:.3g}"),
            f"{one.unit}, {today}: {one.low:.2g} to {one.high:.2g} (95 %), {courses} courses",
        )
        for one in growths
    ]


def document(found: "Judged") -> dict[str, object]:
    """For programs."""
    return {
        "ok": not found.untold,
        "courses": found.courses,
        "growths": [one._asdict() for one in found.growths],
        "untold": [one._asdict() for one in found.untold],
        "nees": {"before": found.before._asdict(), "after": found.after._asdict()},
    }


def _show(found: "Judged") -> None:
    table = Table("number", "was", "is", "95 %", "unit", "that is")
    for one in found.growths:
        after = f"{sqrt(one.value):.2g} after one"
        table.add_row(
            one.key, f"{one.old:.3g}", f"{one.value:.3g}", f"{one.low:.2g} to {one.high:.2g}", one.unit, after
        )
    for untold in found.untold:
        table.add_row(untold.key, "", "", f"[yellow]{escape(untold.reason)}[/]", "", "")
    console.print(table)
    for title, errs in (("as the file was", found.before), ("as found", found.after)):
        console.print(f"  errors {title}: {words(errs)}", highlight=False)


def words(one: "Consistency") -> str:
    """Whether the covariance is what it says."""
    verdict = "consistent"
    if one.nees > one.high:
        verdict = "the covariance is too sure of itself"
    elif one.nees < one.low:
        verdict = "the covariance is too cautious"
    return f"NEES {one.nees:.2f} of {one.size:.2f}, 95 % of {one.low:.2f} to {one.high:.2f}: {verdict}"
