"""`drivegate setup scan`: who is on a bus."""

from collections.abc import Sequence
from typing import Annotated

import typer
from rich.table import Table

from drivers import DRIVERS
from drivers.contract import CanFrame
from gateway import robot_files
from gateway.cli.doctor import link_of
from gateway.cli.output import console, print_json
from gateway.cli.refusing import refuse
from gateway.config import RobotConfig, load
from gateway.edges.can_adapter import AdapterError
from gateway.edges.claims import refuse_where_commanded
from gateway.edges.listening import Place, listen
from gateway.setup.bit_rate import Link, words
from gateway.setup.census import Census, Report
from gateway.setup.match import Match, match

EXIT_FOUND_CONFLICT = 1
ASK_AFTER = 0.4  # of the time: whom to ask is known by then


def scan(  # noqa: PLR0917  # a command line: each parameter is an option with a name
    bus: Annotated[str, typer.Argument(help="CAN interface, e.g. can0.")],
    interface: Annotated[str, typer.Option(help="Of python-can.")] = "socketcan",
    bitrate: Annotated[int | None, typer.Option(help="Bit/s, where python-can sets it: not on socketcan.")] = None,
    seconds: Annotated[float, typer.Option(min=0.5, max=60.0, help="How long to listen.")] = 2.0,
    ask: Annotated[bool, typer.Option("--ask", help="Also ask: ODrives for their firmware, VESCs by a ping.")] = False,
    file: Annotated[str | None, typer.Option(help="Robot file to compare with, or its name.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Machine-readable report.")] = False,
) -> None:
    """Tell who answers on a bus, by listening alone: protocols, ids, errors, conflicts. Exit 1 on a conflict.

    Moves and changes nothing. It asks nothing either without --ask, so a new VESC, which is silent, is not found.
    """
    place = Place(interface, bus, bitrate)
    config = None if file is None else _on(load(robot_files.find(file))[0], place)
    refuse_where_commanded(interface, bus)
    census = Census()
    try:
        errors = listen(place, seconds, lambda frame: census.take([frame]), questions=_questions(ask, census, seconds))
    except AdapterError as error:
        refuse(error, json=json)
    motors = [] if config is None else config.motor
    report = census.report(seconds, known=[(motor.driver, motor.variant, motor.id) for motor in motors])
    said = words(_link(place), bus, frames=report.frames, errors=errors)
    found = None if config is None else match(config, report.found)
    if json:
        print_json(_document(report, said, found))
    else:
        _show(bus, report, said, found)
    if report.conflicts:
        raise typer.Exit(EXIT_FOUND_CONFLICT)


class _Asker:
    """Every question once."""

    def __init__(self, census: Census, after: float) -> None:
        self._census = census
        self._after = after
        self._asked = False

    def __call__(self, gone: float) -> Sequence[CanFrame]:
        if self._asked or gone < self._after:
            return ()
        self._asked = True
        return [frame for name, driver in DRIVERS.items() for frame in driver.questions("", self._census.heard(name))]


def _questions(ask: bool, census: Census, seconds: float) -> "_Asker":
    return _Asker(census, ASK_AFTER * seconds if ask else seconds * 2.0)


def _link(place: Place) -> Link | None:
    link = link_of(place.channel) if place.interface == "socketcan" else None
    if link is None:
        return None
    return Link(link.up, link.kind != "can", link.bitrate, link.state, link.errors)


def _on(config: RobotConfig, place: Place) -> RobotConfig:
    """The robot file with the motors of this bus alone."""
    buses = {bus.name for bus in config.bus if (bus.interface, bus.channel) == (place.interface, place.channel)}
    return config.model_copy(update={"motor": [motor for motor in config.motor if motor.bus in buses]})


def _document(report: Report, said: Sequence[str], found: Match | None) -> dict[str, object]:
    unknown = [one._asdict() | {"data": one.data.hex()} for one in report.unknown]
    document = report._asdict() | {
        "found": [one._asdict() | {"told": dict(one.told)} for one in report.found],
        "unknown": unknown,
        "link": list(said),
    }
    return document if found is None else document | {"file": found._asdict()}


def _show(bus: str, report: Report, said: Sequence[str], found: Match | None) -> None:
    table = Table(
        "controller", "id", "frames/s", "tells", title=f"{bus}: {report.frames} frames in {report.seconds:g} s"
    )
    for one in report.found:
        rate = "" if one.rate_hz is None else f"{one.rate_hz:.0f}"
        told = ", ".join(f"{name} {value}" for name, value in one.told)
        kinds = " or ".join(one.variants)
        name = one.driver if kinds == one.driver else f"{one.driver} {kinds}"
        table.add_row(name, str(one.id), rate, told + (", commanded by somebody" if one.commanded else ""))
    console.print(table)
    for unknown in report.unknown:
        rate = "once" if unknown.rate_hz is None else f"{unknown.rate_hz:.0f} a second"
        console.print(f"unknown id 0x{unknown.can_id:X}, {rate}: {unknown.data.hex(' ')}", highlight=False)
    for line in (*said, *report.commanded, *(() if found is None else found.lines())):
        console.print(line, markup=False, highlight=False)
    for line in report.conflicts:
        console.print(f"conflict: {line}", style="red", markup=False, highlight=False)
