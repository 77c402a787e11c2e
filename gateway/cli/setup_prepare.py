"""`drivegate setup prepare`: what the robot file needs of its controllers, beside how they are; set after a yes."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Final

import typer
from rich.table import Table

from drivers.contract import CanFrame
from drivers.odrive import tables
from drivers.odrive.endpoints import EndpointError, FlatEndpoints, Value, read_flat, version_request
from gateway.cli.asking import NotAllowedError, Yes, allow
from gateway.cli.output import complain, console, errors, in_words, print_json
from gateway.cli.rewriting import RewriteError, keep, rewrite
from gateway.cli.setup_jog import EXIT_REFUSED, warning
from gateway.config import Bus, Motor, RobotConfig, load
from gateway.edges.can_adapter import AdapterError
from gateway.edges.can_bus import CanBuses
from gateway.edges.claims import Claims, refuse_where_commanded
from gateway.edges.listening import Place, listen
from gateway.edges.signals import EndRequest
from gateway.edges.turning import turn
from gateway.setup import prepare_dji, prepare_odrive, prepare_vesc
from gateway.setup.calibrating import Calibration, Outcome
from gateway.setup.census import Census
from gateway.setup.correction import CorrectionError, difference, with_options
from gateway.setup.preparation import Ear, Line, Verdict, wrong
from gateway.setup.prepare_odrive import Setting, Versions
from gateway.setup.restart import PATIENCE_S, Restart
from gateway.setup.sdo import Exchange, Job

EXIT_UNAVAILABLE = 69  # EX_UNAVAILABLE of sysexits.h
ASKED_AT: Final = (0.4, 0.6, 0.8)  # of the time: a frame may be lost
LONGEST_FILE: Final = 4_000_000  # bytes
EXCHANGE_S: Final = 60.0
PERIOD_NS: Final = 10_000_000
_STYLES: Final = {Verdict.OK: "green", Verdict.NO: "red", Verdict.UNKNOWN: "yellow"}


class PrepareError(RuntimeError):
    """Why nothing, or nothing more, is set."""


def prepare(  # noqa: PLR0917  # a command line: each parameter is an option with a name
    file: Annotated[Path, typer.Argument(help="Robot file.")],
    motors: Annotated[list[str] | None, typer.Argument(help="Only these of its motors.")] = None,
    endpoints: Annotated[
        list[Path] | None,
        typer.Option(help="ODrive 0.6: the vendor's flat_endpoints.json; once more for other hardware."),
    ] = None,
    watchdog: Annotated[
        float | None, typer.Option(min=0.003, max=1.0, help="S; for ODrives whose watchdog the robot file waives.")
    ] = None,
    calibrate: Annotated[
        bool,
        typer.Option("--calibrate", help="ODrive 0.6: motors that are not calibrated are; they turn. Asks once more."),
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
        work = _Work(config, _chosen(config, motors or []), flats, seconds)
        with _to_themselves(work.motors, config):
            work.look()
            if not json:
                work.show()
            work.set(yes=yes)
            kept = work.correct(file, text, watchdog, yes=yes)
        if calibrate and work.calibrated(yes=yes):
            with _to_themselves(work.motors, config):
                work.look()
    except (PrepareError, AdapterError, RewriteError, CorrectionError) as error:
        if json:
            print_json({"ok": False, "reason": str(error)})
        complain(str(error))
        raise typer.Exit(EXIT_UNAVAILABLE if isinstance(error, AdapterError) else EXIT_REFUSED) from None
    bad = wrong(work.lines)
    if json:
        print_json(work.document() | {"ok": not bad, "kept": kept and str(kept)})
    elif work.changed or kept:
        work.show_rest()
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


@contextmanager
def _to_themselves(motors: Sequence[Motor], config: RobotConfig) -> Iterator[None]:
    """Nobody commands these buses, and no gateway begins to. Raises InUseError."""
    used = [bus for bus in config.bus if any(motor.bus == bus.name for motor in motors)]
    for bus in used:
        refuse_where_commanded(bus.interface, bus.channel)
    claims = [
        Claims(bus.interface, bus.channel, [_state_id(one) for one in motors if one.bus == bus.name and _is_06(one)])
        for bus in used
    ]
    try:
        yield
    finally:
        for claim in claims:
            claim.release()


def _state_id(motor: Motor) -> int:
    return motor.id << tables.NODE_SHIFT | tables.SET_AXIS_STATE


def _is_06(motor: Motor) -> bool:
    return (motor.driver, motor.variant) == ("odrive", "0.6")


class _Work:
    """Everything that was found, and what is done about it."""

    def __init__(
        self, config: RobotConfig, motors: list[Motor], flats: dict[str, FlatEndpoints], seconds: float
    ) -> None:
        self.config = config
        self.motors = motors
        self.lines: list[Line] = []
        self.changed: list[str] = []  # "motor: path = value"
        self._flats = flats
        self._seconds = seconds
        self._buses = {bus.name: bus for bus in config.bus}
        self._fits: dict[str, FlatEndpoints] = {}  # by motor
        self._to_set: dict[str, list[Setting]] = {}
        self._idle: set[str] = set()

    def look(self) -> None:
        """Listen, then read. Raises AdapterError, PrepareError."""
        self.lines, self._fits, self._to_set = [], {}, {}
        for bus in self._used():
            mine = [motor for motor in self.motors if motor.bus == bus.name]
            ear = self._listened(bus, mine)
            for motor in mine:
                self.lines += self._lines(bus, motor, ear)

    def _used(self) -> list[Bus]:
        return [bus for bus in self.config.bus if any(motor.bus == bus.name for motor in self.motors)]

    def _listened(self, bus: Bus, motors: Sequence[Motor]) -> Ear:
        ear, census = Ear(), Census()

        def take(frame: CanFrame) -> None:
            ear.take(frame)
            census.take([frame])

        ask = _Asker([version_request(motor.id) for motor in motors if _is_06(motor)], self._seconds)
        listen(_place(bus), self._seconds, take, questions=ask)
        known = [(motor.driver, motor.variant, motor.id) for motor in self.config.motor if motor.bus == bus.name]
        conflicts = census.report(self._seconds, known).conflicts
        if conflicts:
            raise PrepareError(f"{bus.name}: {'; '.join(conflicts)}: nothing was asked and nothing is set")
        return ear

    def _lines(self, bus: Bus, motor: Motor, ear: Ear) -> list[Line]:
        if motor.driver == "vesc":
            return prepare_vesc.heard_lines(ear, motor)
        if motor.driver == "dji":
            return prepare_dji.heard_lines(ear, motor, bus)
        heard = prepare_odrive.heard_lines(ear, motor)
        if not _is_06(motor):
            return [*heard, *prepare_odrive.old_lines(motor)]
        told = prepare_odrive.versions(ear, motor)
        if prepare_odrive.idle(ear, motor):
            self._idle.add(motor.name)
        return [*heard, *self._read(bus, motor, told)]

    def _read(self, bus: Bus, motor: Motor, told: Versions | None) -> list[Line]:
        """The settings of an ODrive 0.6."""
        flat, line = prepare_odrive.chosen(motor, told, self._flats)
        if flat is None:
            unread = [] if self._flats else [prepare_odrive.unread_line(motor)]
            return [line, *unread, prepare_odrive.file_line(motor, None)]
        self._fits[motor.name] = flat
        wanted = [*prepare_odrive.settings(self.config, motor), prepare_odrive.bit_rate(bus)]
        done = self._exchanged(bus, motor, prepare_odrive.jobs(flat, wanted))
        self._to_set[motor.name] = [] if done.silent else prepare_odrive.to_set(wanted, done.values)
        lines = prepare_odrive.setting_lines(motor, flat, wanted, done.values, done.silent)
        return [line, *lines, prepare_odrive.file_line(motor, flat)]

    def _exchanged(self, bus: Bus, motor: Motor, jobs: Sequence[Job]) -> Exchange:
        exchange = Exchange(motor.id, jobs)
        listen(
            *(_place(bus), EXCHANGE_S, exchange.take),
            going_on=lambda: not exchange.finished,
            questions=exchange.questions,
        )
        return exchange

    # -- setting ------------------------------------------------------------------------------------------------------

    def set(self, *, yes: bool) -> None:
        """What a person lets happen; then all is looked at anew. Raises AdapterError, PrepareError."""
        plans = [(motor, self._to_set.get(motor.name, [])) for motor in self.motors]
        todo = [
            f"  {motor.name}: {one.path} = {prepare_odrive.words(one.wanted)}" for motor, plan in plans for one in plan
        ]
        if not todo:
            return
        busy = [motor.name for motor, plan in plans if plan and motor.name not in self._idle]
        if busy:
            raise PrepareError(f"{', '.join(busy)}: not idle, or nobody hears it: nothing is set")
        text = "\n".join(["This will be written, read back, and saved; each controller then restarts:", *todo])
        if not _allowed(text, "to write it", yes=yes):
            return
        for motor, plan in plans:
            self._write(motor, [one for one in plan if one.path != prepare_odrive.BAUD_RATE])
        if self._other_bit_rate():
            return
        self.look()

    def _write(self, motor: Motor, plan: Sequence[Setting]) -> None:
        if plan:
            self._put(motor, plan)
            self._save(motor)

    def _put(self, motor: Motor, plan: Sequence[Setting]) -> None:
        """Raises PrepareError where one reads back otherwise."""
        flat = self._fits[motor.name]
        done = self._exchanged(self._buses[motor.bus], motor, prepare_odrive.jobs(flat, plan, write=True))
        for one in plan:
            read: Value | None = done.values.get(one.path)
            if read is None or not one.accepts(read):
                found = "does not answer" if read is None else f"reads back {prepare_odrive.words(read)}"
                raise PrepareError(
                    f"{motor.name}: {one.path} = {prepare_odrive.words(one.wanted)} {found}: "
                    "nothing is saved, switching it off and on brings back what it had"
                )
            self.changed.append(f"{motor.name}: {one.path} = {prepare_odrive.words(one.wanted)}")

    def _save(self, motor: Motor) -> None:
        """Raises PrepareError where it does not come back."""
        errors.print(f"{motor.name} saves its settings and restarts", highlight=False, markup=False)
        restart = Restart(motor.id)
        listen(
            *(_place(self._buses[motor.bus]), PATIENCE_S, restart.take),
            going_on=lambda: not restart.finished,
            questions=restart.questions,
        )
        if not restart.finished:
            raise PrepareError(f"{motor.name}: was not seen to restart within {PATIENCE_S:g} s: is it saved?")

    def _other_bit_rate(self) -> bool:
        """All of a bus at once, because from then on they hear neither each other nor us."""
        moved = [
            (motor, one)
            for motor in self.motors
            for one in self._to_set.get(motor.name, [])
            if one.path == prepare_odrive.BAUD_RATE
        ]
        for motor, one in moved:
            self._put(motor, [one])
        for motor, _ in moved:
            restart = Restart(motor.id)
            listen(_place(self._buses[motor.bus]), 0.1, restart.take, questions=restart.questions)
        for bus in {motor.bus for motor, _ in moved}:
            place = self._buses[bus]
            self.lines = [
                line._replace(verdict=Verdict.UNKNOWN, todo=f"set {place.channel} to {place.bitrate} and run it again")
                if line.what == prepare_odrive.BAUD_RATE
                else line
                for line in self.lines
            ]
            complain(f"{bus}: its controllers restart with {place.bitrate} bit/s: set {place.channel} so, run it again")
        return bool(moved)

    # -- calibrating --------------------------------------------------------------------------------------------------

    def calibrated(self, *, yes: bool) -> bool:
        """Whether a person let it happen. Raises PrepareError where one does not end well, and lets it go."""
        paths = prepare_odrive.CALIBRATED
        names = {line.motor for line in wrong(self.lines) if line.what in paths}
        motors = [motor for motor in self.motors if motor.name in names]
        what = f"{warning(self.config, *names)} Each turns by itself, a turn or so there and back: {', '.join(names)}."
        if not motors or not _allowed(what, "to calibrate them", yes=yes):
            return False
        for motor in motors:
            errors.print(f"{motor.name} calibrates itself now.", highlight=False, markup=False)
            outcome = _turned(self.config, self._buses[motor.bus], motor)
            if not outcome.ok:
                held = "" if outcome.released else "; it did not confirm that it is released: cut its power"
                raise PrepareError(f"{motor.name}: not calibrated: {outcome.reason}{held}")
            self._save(motor)
        return True

    # -- the robot file -----------------------------------------------------------------------------------------------

    def correct(self, file: Path, text: str, watchdog: float | None, *, yes: bool) -> Path | None:
        """The numbers of the endpoints; the copy that is kept. Raises CorrectionError, RewriteError."""
        options = {
            motor.name: prepare_odrive.file_options(self._fits[motor.name])
            for motor in self.motors
            if motor.name in self._fits and (motor.watchdog is not None or watchdog is not None)
        }
        new = with_options(text, options, watchdog, str(file))
        if new == text or not _allowed(difference(text, new, str(file)), f"to write this into {file}", yes=yes):
            return None
        kept = keep(file)
        rewrite(file, new)
        errors.print(f"{file} is corrected; as it was before: {kept}", highlight=False, markup=False)
        by_name = {motor.name: motor for motor in load(file)[0].motor}
        self.lines = [
            prepare_odrive.file_line(by_name[line.motor], self._fits.get(line.motor))
            if line.what == prepare_odrive.IN_FILE
            else line
            for line in self.lines
        ]
        return kept

    # -- what is told -------------------------------------------------------------------------------------------------

    def instructions(self) -> dict[str, list[str]]:
        """By motor, what to set with the vendor's tool."""
        found = {}
        for motor in self.motors:
            bus = self._buses[motor.bus]
            if motor.driver == "vesc":
                found[motor.name] = prepare_vesc.vesc_tool(motor, bus)
            elif (motor.driver, motor.variant) == ("odrive", "0.5"):
                found[motor.name] = prepare_odrive.odrivetool(self.config, motor, bus)
        return found

    def show(self) -> None:
        """For a person."""
        table = Table("motor", title=f"what {self.config.robot.name} needs")
        for head in ("what", "wanted", "found", ""):
            table.add_column(head, overflow="fold")
        for line in self.lines:
            style = _STYLES[line.verdict]
            table.add_row(line.motor, line.what, line.wanted, line.found, f"[{style}]{line.verdict.value}[/]")
        console.print(table)
        for said in _advice(self.lines):
            _say(said)
        for motor, steps in self.instructions().items():
            _say(f"{motor}, by the vendor's tool:")
            for step in steps:
                _say(f"  {step}")

    def show_rest(self) -> None:
        """What is still not as needed, or not known, after something was set."""
        rest = [line for line in self.lines if line.verdict is not Verdict.OK]
        for line in rest:
            _say(
                f"{line.verdict.value}: {line.motor}, {line.what}: wanted {line.wanted or 'nothing'}, found {line.found}"
            )
        if not rest:
            _say(f"everything of {', '.join(motor.name for motor in self.motors)} is as the robot file needs it")

    def document(self) -> dict[str, object]:
        rows = [line._asdict() | {"verdict": line.verdict.value} for line in self.lines]
        return {"lines": rows, "changed": self.changed, "by_hand": self.instructions()}


def _advice(lines: Sequence[Line]) -> list[str]:
    """What to do, each once, and for which motors; what a yes sets is shown before it is asked."""
    motors: dict[tuple[str, str], list[str]] = {}
    for line in lines:
        if line.todo not in ("", prepare_odrive.A_YES):
            motors.setdefault((line.what, line.todo), []).append(line.motor)
    return [f"{what} ({', '.join(names)}): {todo}" for (what, todo), names in motors.items()]


def _say(text: str) -> None:
    console.print(text, markup=False, highlight=False, soft_wrap=True)


class _Asker:
    """The same questions a few times."""

    def __init__(self, frames: Sequence[CanFrame], seconds: float) -> None:
        self._frames = frames
        self._due = [share * seconds for share in ASKED_AT]

    def __call__(self, gone: float) -> Sequence[CanFrame]:
        if not self._due or gone < self._due[0]:
            return ()
        del self._due[0]
        return self._frames


def _turned(config: RobotConfig, bus: Bus, motor: Motor) -> Outcome:
    """One calibration, with the bus to itself. Raises InUseError."""
    refuse_where_commanded(bus.interface, bus.channel)
    procedure, ending = Calibration(bus.name, motor.id), EndRequest()
    buses = CanBuses(config.model_copy(update={"bus": [bus]}))
    try:
        with ending.heeded():
            turn(buses, procedure, ending, period_ns=PERIOD_NS)
    finally:
        buses.close()
    return procedure.outcome or Outcome(ok=False, reason="it has no outcome", released=False)


def _place(bus: Bus) -> Place:
    return Place(bus.interface, bus.channel, bus.bitrate)


def _allowed(what: str, question: str, *, yes: bool) -> bool:
    try:
        allow(what, question, yes=yes)
    except NotAllowedError as error:
        errors.print(str(error), highlight=False, markup=False)
        return False
    return True
