"""`drivegate setup calibrate`: the geometry of a robot file, from courses whose ends are measured."""

from collections.abc import Sequence
from datetime import date
from importlib import import_module
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
from gateway.setup.correction import Entry, rounded
from gateway.setup.courses import geometry_courses

if TYPE_CHECKING:
    from replay.calibrate.calibrate import Calibrated
    from replay.calibrate.models import Number
    from replay.calibrate.umbmark import Umbmark


def calibrate(  # noqa: PLR0913, PLR0917  # a command line: each parameter is an option with a name
    file: OwnFile,
    measured: Measured = None,
    session: SessionFolder = None,
    course: Names = None,
    length: Length = USUAL_LENGTH,
    repeat: Repeat = 2,
    source: SourceName = "teleop",
    truth: Truth = False,
    out: Out = None,
    connect: Connect = None,
    yes: Yes = False,
    json: bool = typer.Option(False, "--json", help="Machine-readable result."),
) -> None:
    """Find wheel radii, track or places of wheels, axle offset and wheel angles from measured courses; write them.

    The running robot drives courses, and you measure with tape where each ends; or --measured tells of courses driven
    earlier, and nothing moves. What is found is told with intervals of 95 %, shown as a difference, and written only
    after a yes; a copy of the file is kept. A number that the courses do not tell stays as it is, and it is said why.
    Exit 0: all were found, 1: not all, or none.
    """
    config, text = load(file)
    try:
        usual = geometry_courses(config)
        wanted = Wanted(measured, session, course or usual, length, repeat, source, truth, out, connect, yes)
        gathered = gather(file, config, text, wanted)
        with errors.status("calibrating"):
            found: Calibrated = import_module("replay.calibrate.calibrate").calibrated(
                config, gathered.courses, gathered.driven
            )
        if not json:
            _show(found)
        kept = write(file, text, entries(found.numbers, len(gathered.driven)), yes=yes) if found.numbers else None
    except REFUSALS as error:
        refuse(error, json=json, unchanged=file)
    if json:
        print_json(document(found, len(gathered.driven)) | {"measured": str(gathered.file), "kept": kept and str(kept)})
    if found.refused:
        raise typer.Exit(EXIT_REFUSED)


def entries(numbers: Sequence["Number"], courses: int) -> list[Entry]:
    """What goes into the robot file, each with its date and how sure it is."""
    today = date.today().isoformat()  # noqa: DTZ011  # of the person who stands there
    return [
        Entry(place, rounded(value, one.half), f"{one.unit}, {today}: {_how_sure(one)}, {courses} courses")
        for one in numbers
        for place, value in one.keys
    ]


def _how_sure(one: "Number") -> str:
    return f"{one.name} {rounded(one.value, one.half):g} +- {one.half:.2g} (95 %)"


def document(found: "Calibrated", courses: int) -> dict[str, object]:
    """For programs."""
    return {
        "ok": not found.refused,
        "courses": courses,
        "numbers": [
            {
                "name": one.name,
                "keys": [{"key": ".".join(map(str, place)), "value": value} for place, value in one.keys],
                "old": one.old,
                "value": one.value,
                "low": one.value - one.half,
                "high": one.value + one.half,
                "unit": one.unit,
            }
            for one in found.numbers
        ],
        "told": [one._asdict() for one in found.told],
        "refused": [one._asdict() for one in found.refused],
        "left_over": {"before": list(found.before), "after": list(found.after)},
        "chance": found.chance,
        "squares": found.squares and found.squares._asdict(),
        "squares_after": found.squares_after and found.squares_after._asdict(),
    }


def _show(found: "Calibrated") -> None:
    table = Table("number", "was", "is", "95 %", "unit")
    for one in found.numbers:
        table.add_row(one.name, f"{one.old:.5g}", f"{one.value:.5g}", f"+- {one.half:.2g}", one.unit)
    for told in found.told:
        table.add_row(told.name, "", f"{told.value:.5g}", f"+- {told.half:.2g}", f"{told.unit}; no key says it")
    for refused in found.refused:
        table.add_row(refused.name, "", "", f"[yellow]{escape(refused.reason)}[/]", "")
    console.print(table)
    for title, (metres, turn) in (("as the file was", found.before), ("as found", found.after)):
        console.print(f"  ends {title}: {metres:.4f} m, {turn:.4f} rad off (rms)", highlight=False)
    _show_squares("as the file was", found.squares)
    _show_squares("as found", found.squares_after)


def _show_squares(title: str, squares: "Umbmark | None") -> None:
    if squares is None:
        return
    ratios = ""
    if squares.track_ratio is not None:
        ratios = f", Eb {squares.track_ratio:.4f}, Ed {squares.wheel_ratio:.4f}"
    console.print(f"  squares {title} (UMBmark): E max,syst {squares.error:.4f} m{ratios}", highlight=False)
