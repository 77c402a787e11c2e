"""`drivegate setup id`: another id for a controller, by its serial number, or by hand while the bus is watched."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Annotated

import typer

from drivers import DRIVERS
from drivers.contract import CanFrame, Identity, RenamingOverCan
from gateway.cli.asking import NotAllowedError, Yes, allow
from gateway.cli.output import console, errors, print_json
from gateway.cli.refusing import EXIT_REFUSED, refuse
from gateway.edges.can_adapter import AdapterError
from gateway.edges.claims import Claims, refuse_where_commanded
from gateway.edges.listening import Place, listen
from gateway.setup.census import Census
from gateway.setup.renaming import (
    KINDS,
    IdWatch,
    RenamingError,
    RestWatch,
    RollCall,
    check_free,
    named,
    way,
)

ROLL_S = 2.0
REST_S = 0.5  # of heartbeats, which come every 0.1 s
ASK_EVERY_S = 0.6  # answers are spread over that time
CONFIRM_S = 3.0
RESTART_S = 1.5  # without a question: what is saved and started anew
BEFORE_S = 3.0
BY_HAND_S = 300.0
PING_EVERY_S = 1.0
Say = Callable[[str], None]  # to who called: on standard output, or beside it where that is for a program


def id(  # noqa: PLR0917  # the command's name, and a command line: each parameter is an option with a name
    bus: Annotated[str, typer.Argument(help="CAN interface, e.g. can0.")],
    kind: Annotated[str, typer.Argument(help=f"Of the controller: {', '.join(KINDS)}.")],
    to: Annotated[int | None, typer.Option(help="Its new id; left out: only tell who is there.")] = None,
    serial: Annotated[str | None, typer.Option(help="Which one, where several tell their serial numbers.")] = None,
    interface: Annotated[str, typer.Option(help="Of python-can.")] = "socketcan",
    bitrate: Annotated[int | None, typer.Option(help="Bit/s, where python-can sets it: not on socketcan.")] = None,
    yes: Yes = False,
    json: Annotated[bool, typer.Option("--json", help="Machine-readable result.")] = False,
) -> None:
    """Give a controller another id. An ODrive (0.6) gets it over CAN, by its serial number, also where two have one id.

    All others are set by hand: it says how, watches the bus, and tells which id went and which one came.
    """
    say = partial((errors if json else console).print, highlight=False)
    try:
        driver, variant, how = way(kind, to)
        refuse_where_commanded(interface, bus)
        place = Place(interface, bus, bitrate)
        if isinstance(how, RenamingOverCan):
            document = _over_can(place, driver, how, say=say, to=to, serial=serial, yes=yes)
        else:
            document = _by_hand(place, driver, variant, how, say=say, to=to)
    except (RenamingError, NotAllowedError, AdapterError, KeyboardInterrupt) as error:
        refuse(error, json=json)
    if json:
        print_json(document)
    if not document["ok"]:
        raise typer.Exit(EXIT_REFUSED)


# -- over CAN ---------------------------------------------------------------------------------------------------------


def _over_can(
    place: Place, driver: str, how: RenamingOverCan, *, say: Say, to: int | None, serial: str | None, yes: bool
) -> dict[str, object]:
    census, rest, call = Census(), RestWatch(driver), RollCall(how)

    def take(frame: CanFrame) -> None:
        census.take([frame])
        rest.take(frame)
        call.take(frame)

    listen(place, ROLL_S, take, questions=_Again(lambda: how.ask(place.name)))
    for line in call.lines():
        say(line)
    for at in call.shared():
        errors.print(f"id {at} was given more than once: give one of them another id, by --serial", highlight=False)
    if to is None:
        return {"ok": not call.shared(), "ids": _table(call), "shared": call.shared()}
    one = call.chosen(serial)
    found = [found for found in census.report(ROLL_S).found if found.driver == driver]
    check_free(call.ids, found, one, to)
    rest.check(one)
    allow(
        f"{named(one)}: gets id {to}, keeps it and starts anew. What it does by itself at a start (calibration, closed "
        "loop) it will do: lift the robot so that no wheel touches the ground, and keep hands and cables away.",
        f"to give it id {to}",
        yes=yes,
    )
    refuse_where_commanded(place.interface, place.channel)  # somebody may have started one meanwhile
    _give(place, driver, how, one, to)
    say(f"serial {one.serial:012X} has id {to}, also after a restart")
    return {"ok": True, "serial": f"{one.serial:012X}", "from": one.id, "to": to}


def _give(place: Place, driver: str, how: RenamingOverCan, one: Identity, to: int) -> None:
    """Raises RenamingError where it drives by now, or does not say its id before it is kept and after; InUseError."""
    rest = RestWatch(driver)
    claims = Claims(place.interface, place.channel, [how.claim(at) for at in (one.id, to) if at is not None])
    try:
        listen(place, REST_S, rest.take)
        rest.check(one)
        _confirmed(place, how, one, to, how.give(place.name, one.serial, to), quiet_s=0.0)
        _confirmed(place, how, one, to, how.keep(place.name, to), quiet_s=RESTART_S)
    finally:
        claims.release()


def _confirmed(
    place: Place, how: RenamingOverCan, one: Identity, to: int, first: Sequence[CanFrame], *, quiet_s: float
) -> None:
    """Sends this, and asks after so many seconds until it tells this id."""
    call = RollCall(how)
    questions = _Again(lambda: how.ask(place.name), first=first, quiet_s=quiet_s)
    until = lambda: call.ids.get(one.serial) != to  # noqa: E731  # a condition is one line
    listen(place, quiet_s + CONFIRM_S, call.take, questions=questions, going_on=until)
    if call.ids.get(one.serial) != to:
        told = call.ids.get(one.serial, "nothing")
        raise RenamingError(f"serial {one.serial:012X}: tells id {told} instead of {to}: look with --to left out")


def _table(call: RollCall) -> dict[str, int | None]:
    return {f"{serial:012X}": at for serial, at in call.ids.items()}


class _Again:
    """Frames at once, and others every so often after a while."""

    def __init__(
        self,
        ask: Callable[[], list[CanFrame]],
        *,
        first: Sequence[CanFrame] = (),
        quiet_s: float = 0.0,
        every_s: float = ASK_EVERY_S,
    ) -> None:
        self._ask = ask
        self._first = list(first)
        self._next_s = quiet_s
        self._every_s = every_s

    def __call__(self, gone_s: float) -> Sequence[CanFrame]:
        first, self._first = self._first, []
        if gone_s < self._next_s:
            return first
        self._next_s = gone_s + self._every_s
        return [*first, *self._ask()]


# -- by hand ----------------------------------------------------------------------------------------------------------


def _by_hand(
    place: Place, driver: str, variant: str, steps: Callable[[int], tuple[str, ...]], *, say: Say, to: int | None
) -> dict[str, object]:
    watch = IdWatch(driver, variant)
    pings = lambda: DRIVERS[driver].questions(place.name, ())  # noqa: E731  # a question is one line
    listen(place, BEFORE_S, watch.take, questions=_Again(pings, every_s=PING_EVERY_S))
    before = sorted(watch.ids())
    say(f"{variant}: heard {', '.join(f'id {at}' for at in before) or 'nobody'}")
    if to is None:
        return {"ok": True, "ids": before}
    if to in before:
        raise RenamingError(f"id {to} is taken: give that one another id first, or switch it off meanwhile")
    errors.print(f"{variant}: id {to} is set by hand. Nothing here sends it; the bus is watched.", highlight=False)
    for number, step in enumerate(steps(to), start=1):
        errors.print(f"  {number}. {step}", highlight=False, markup=False)
    watch.begin()
    again = _Again(pings, every_s=PING_EVERY_S)
    listen(place, BY_HAND_S, watch.take, questions=again, going_on=lambda: not watch.over)
    came, went = watch.change()
    if not came:
        raise RenamingError(f"no new id was heard within {BY_HAND_S:g} s")
    ok = came == (to,)
    words = f"id {_ids(went)} went, id {_ids(came)} came" if went else f"id {_ids(came)} came"
    say(words if ok else f"{words}, not {to}: once more from the first step")
    return {"ok": ok, "came": list(came), "went": list(went), "to": to}


def _ids(ids: Sequence[int]) -> str:
    return ", ".join(map(str, ids))
