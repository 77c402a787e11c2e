"""What `drivegate setup prepare` does on the buses and to the robot file; what is right is decided in gateway/setup."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from drivers.contract import CanFrame
from drivers.odrive.endpoints import FlatEndpoints, Value, version_request
from drivers.odrive.renaming import claim
from gateway.cli.asking import NotAllowedError, allow
from gateway.cli.output import complain, errors
from gateway.cli.rewriting import rewrite_keeping
from gateway.cli.setup_jog import warning
from gateway.config import Bus, Motor, RobotConfig, load
from gateway.edges.can_bus import CanBuses
from gateway.edges.claims import Claims, refuse_where_commanded
from gateway.edges.host_checks import set_anew
from gateway.edges.listening import Place, listen
from gateway.edges.signals import EndRequest
from gateway.edges.turning import turn
from gateway.setup import prepare_odrive
from gateway.setup.calibrating import Calibration, Outcome
from gateway.setup.census import Census
from gateway.setup.correction import difference, with_options
from gateway.setup.preparation import Ear, Line, Verdict, wrong
from gateway.setup.prepare_kinds import KINDS
from gateway.setup.prepare_odrive import BAUD_RATE, CALIBRATED, Setting
from gateway.setup.restart import PATIENCE_S, Restart
from gateway.setup.sdo import Exchange, Job

ASKED_AT: Final = (0.4, 0.6, 0.8)  # of the time: a frame may be lost
EXCHANGE_S: Final = 60.0
PERIOD_NS: Final = 10_000_000


class PrepareError(RuntimeError):
    """Why nothing, or nothing more, is set."""


@contextmanager
def to_ourselves(motors: Sequence[Motor], config: RobotConfig) -> Iterator[None]:
    """Nobody commands the buses of these motors, and no gateway begins to. Raises InUseError."""
    used = [bus for bus in config.bus if any(motor.bus == bus.name for motor in motors)]
    for bus in used:
        refuse_where_commanded(bus.interface, bus.channel)
    claims: list[Claims] = []
    try:
        for bus in used:
            mine = [one.id for one in motors if one.bus == bus.name and _is_06(one)]
            claims.append(Claims(bus.interface, bus.channel, map(claim, mine)))
        yield
    finally:
        for one in claims:
            one.release()


class Preparing:
    """Everything that was found of these motors, and what is done about it."""

    def __init__(
        self, config: RobotConfig, motors: Sequence[Motor], flats: dict[str, FlatEndpoints], seconds: float
    ) -> None:
        self.config = config
        self.motors = motors
        self.lines: list[Line] = []
        self.changed: list[str] = []  # "motor: path = value"
        self._flats = flats
        self._seconds = seconds
        self._buses = {bus.name: bus for bus in config.bus}
        self._moved: set[str] = set()  # buses whose controllers have another bit rate by now than the link
        self._fits: dict[str, FlatEndpoints] = {}  # by motor
        self._to_set: dict[str, list[Setting]] = {}
        self._idle: set[str] = set()

    def _forget(self, motors: Sequence[Motor]) -> None:
        names = [motor.name for motor in motors]
        self.lines = [line for line in self.lines if line.motor not in names]
        self._idle -= set(names)
        for name in names:
            self._fits.pop(name, None)
            self._to_set.pop(name, None)

    # -- looking ------------------------------------------------------------------------------------------------------

    def look(self) -> None:
        """Listen, then read; what moved to another bit rate stays as it is known. Raises AdapterError, PrepareError."""
        for bus in self._buses.values():
            mine = [motor for motor in self.motors if motor.bus == bus.name]
            if not mine or bus.name in self._moved:
                continue
            self._forget(mine)
            ear = self._listened(bus, mine)
            for motor in mine:
                self.lines += KINDS[motor.driver].heard_lines(ear, motor, bus)
                if _is_06(motor):
                    self.lines += self._read(bus, motor, ear)
        names = [motor.name for motor in self.motors]
        self.lines.sort(key=lambda line: names.index(line.motor))

    def by_hand(self) -> dict[str, list[str]]:
        """By motor, what to set with the vendor's tool."""
        steps = {motor.name: KINDS[motor.driver].by_hand(motor, self._buses[motor.bus]) for motor in self.motors}
        return {name: told for name, told in steps.items() if told}

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

    def _read(self, bus: Bus, motor: Motor, ear: Ear) -> list[Line]:
        """The settings of an ODrive 0.6."""
        if prepare_odrive.idle(ear, motor):
            self._idle.add(motor.name)
        flat, line = prepare_odrive.chosen(motor, prepare_odrive.versions(ear, motor), self._flats)
        if flat is None:
            unread = [] if self._flats else [prepare_odrive.unread_line(motor)]
            return [line, *unread, prepare_odrive.file_line(motor, None)]
        self._fits[motor.name] = flat
        wanted = [*prepare_odrive.settings(self.config, motor), prepare_odrive.bit_rate(bus)]
        done = self._exchanged(motor, prepare_odrive.jobs(flat, wanted))
        self._to_set[motor.name] = [] if done.silent else prepare_odrive.to_set(wanted, done.values)
        lines = prepare_odrive.setting_lines(motor, flat, wanted, done.values, done.silent)
        return [line, *lines, prepare_odrive.file_line(motor, flat)]

    def _exchanged(self, motor: Motor, jobs: Sequence[Job]) -> Exchange:
        exchange = Exchange(motor.id, jobs)
        listen(
            *(self._place(motor), EXCHANGE_S, exchange.take),
            going_on=lambda: not exchange.finished,
            questions=exchange.questions,
        )
        return exchange

    def _place(self, motor: Motor) -> Place:
        return _place(self._buses[motor.bus])

    # -- setting ------------------------------------------------------------------------------------------------------

    def set(self, *, yes: bool) -> None:
        """What a person lets happen; then all is looked at anew. Raises AdapterError, PrepareError."""
        if not any(self._to_set.values()):
            return
        moving = {motor.bus for motor in self.motors if self._moves(motor)}
        self._refuse_where_one_stays(moving)
        plans = [
            (motor, plan)
            for motor in self.motors
            if (plan := self._to_set.get(motor.name, [])) or (motor.bus in moving and _is_06(motor))
        ]
        busy = [motor.name for motor, _ in plans if motor.name not in self._idle]
        if busy:
            raise PrepareError(f"{', '.join(busy)}: not idle, or nobody hears it: nothing is set")
        todo = [f"  {motor.name}: {_said(one)}" for motor, plan in plans for one in plan]
        text = "\n".join(["This will be written, read back, and saved; each controller then restarts:", *todo])
        if not _allowed(text, "to write it", yes=yes):
            return
        for motor, plan in plans:
            self._put(motor, plan)
            if motor.bus not in moving:
                self._save(motor)
        for name in sorted(moving):
            self._other_bit_rate(self._buses[name])
        self.look()

    def _moves(self, motor: Motor) -> bool:
        """Whether it is to have another bit rate."""
        return any(one.path == BAUD_RATE for one in self._to_set.get(motor.name, []))

    def _refuse_where_one_stays(self, moving: Iterable[str]) -> None:
        """Raises PrepareError where a controller of these buses would keep a bit rate at which nobody hears it."""
        has_it = {line.motor for line in self.lines if line.what == BAUD_RATE and line.verdict is Verdict.OK}
        silent = {line.motor for line in self.lines if line.what == "answers"}
        for name in sorted(moving):
            here = [one for one in self.config.motor if one.bus == name]
            rest = [one for one in here if one.name not in has_it and not self._moves(one)]
            stay = [one.name for one in rest if _is_06(one) or one.name not in silent]
            if stay:
                raise PrepareError(
                    f"{name}: another bit rate goes to all of its motors at once, and {', '.join(stay)} would keep "
                    "this one: name no motor, switch all on, and set first by hand what is not set over CAN"
                )

    def _put(self, motor: Motor, plan: Sequence[Setting]) -> None:
        """Raises PrepareError where one reads back otherwise, or somebody armed it since it was looked at."""
        self._refuse_where_armed(motor)
        done = self._exchanged(motor, prepare_odrive.jobs(self._fits[motor.name], plan, write=True))
        for one in plan:
            read: Value | None = done.values.get(one.path)
            if read is None or not one.accepts(read):
                found = "is not answered" if read is None else f"reads back {prepare_odrive.words(read)}"
                raise PrepareError(
                    f"{motor.name}: {_said(one)} {found}: nothing is saved, "
                    "switching it off and on brings back what it had"
                )
            self.changed.append(f"{motor.name}: {_said(one)}")

    def _refuse_where_armed(self, motor: Motor) -> None:
        """Raises PrepareError."""
        ear = Ear()
        listen(self._place(motor), self._seconds, ear.take, going_on=lambda: not prepare_odrive.idle(ear, motor))
        if not prepare_odrive.idle(ear, motor):
            raise PrepareError(f"{motor.name}: not idle any more: nothing more is set")

    def _save(self, motor: Motor) -> None:
        """Raises PrepareError where it does not come back."""
        errors.print(f"{motor.name} saves its settings and restarts", highlight=False, markup=False)
        if not self._restarted([motor], wait=True):
            raise PrepareError(f"{motor.name}: was not seen to restart within {PATIENCE_S:g} s: is it saved?")

    def _restarted(self, motors: Sequence[Motor], *, wait: bool) -> bool:
        """Those of one bus, all told to within a heartbeat of each other; whether all are back, or not waited for."""
        restarts = [Restart(motor.id) for motor in motors]

        def take(frame: CanFrame) -> None:
            for one in restarts:
                one.take(frame)

        def over() -> bool:
            return all(one.finished if wait else one.told for one in restarts)

        listen(
            *(self._place(motors[0]), PATIENCE_S, take),
            going_on=lambda: not over(),
            questions=lambda gone: [frame for one in restarts for frame in one.questions(gone)],
        )
        return over()

    def _other_bit_rate(self, bus: Bus) -> None:
        """All of a bus restart, which have it already: from then on nobody there hears us. Raises PrepareError."""
        motors = [motor for motor in self.motors if motor.bus == bus.name and _is_06(motor)]
        for motor in motors:
            self._refuse_where_armed(motor)
        self._restarted(motors, wait=False)
        self._moved.add(bus.name)
        complain(_set_link(bus))
        self.lines = [self._not_seen_yet(line) for line in self.lines]

    def _not_seen_yet(self, line: Line) -> Line:
        """What was set is not known before the link has the new bit rate; other buses are looked at anew."""
        names = [one.path.rpartition(".")[2] for one in self._to_set.get(line.motor, [])]
        was_set = line.todo == prepare_odrive.A_YES or any(name in line.todo for name in names)
        todo = "set the link to the new bit rate, and run it again"
        return line._replace(verdict=Verdict.UNKNOWN, todo=todo) if was_set else line

    # -- calibrating --------------------------------------------------------------------------------------------------

    def calibrate(self, *, yes: bool) -> None:
        """Those that are not, if a person lets it happen. Raises PrepareError where one does not end well."""
        names = {line.motor for line in wrong(self.lines) if line.what in CALIBRATED}
        motors = [motor for motor in self.motors if motor.name in names]
        unheard = [motor.name for motor in motors if motor.bus in self._moved]
        if unheard:
            links = "; ".join(_set_link(self._buses[name]) for name in sorted(self._moved))
            raise PrepareError(f"{', '.join(unheard)}: not calibrated: {links}")
        told = ", ".join(motor.name for motor in motors)
        what = f"{warning(self.config, *names)} Each turns by itself, a turn or so there and back: {told}."
        if not motors or not _allowed(what, "to calibrate them", yes=yes):
            return
        for motor in motors:
            errors.print(f"{motor.name} calibrates itself now.", highlight=False, markup=False)
            outcome = self._turned(motor)
            if not outcome.well:
                ended = "calibrated, but not saved" if outcome.ok else f"not calibrated: {outcome.reason}"
                held = "" if outcome.released else "; it did not confirm that it is released: cut its power"
                raise PrepareError(f"{motor.name}: {ended}{held}")
            with to_ourselves([motor], self.config):
                self._save(motor)
        with to_ourselves(self.motors, self.config):
            self.look()

    def _turned(self, motor: Motor) -> Outcome:
        """One calibration, with the bus to itself. Raises InUseError."""
        bus = self._buses[motor.bus]
        refuse_where_commanded(bus.interface, bus.channel)
        procedure, ending = Calibration(bus.name, motor.id), EndRequest()
        buses = CanBuses(self.config.model_copy(update={"bus": [bus]}))
        try:
            with ending.heeded():
                turn(buses, procedure, ending, period_ns=PERIOD_NS)
        finally:
            buses.close()
        outcome = procedure.outcome or Outcome(ok=False, reason="it has no outcome", released=False)
        if ending.by is not None and outcome.ok:  # asked when it was calibrated already
            return outcome._replace(ok=False, reason=ending.by)
        return outcome

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
        kept = rewrite_keeping(file, text, new)
        errors.print(f"{file} is corrected; as it was before: {kept}", highlight=False, markup=False)
        given = [motor.name for motor in self.motors if motor.name in options and motor.watchdog is None]
        if given:
            complain(f"{', '.join(given)}: has a watchdog in the robot file now; run it once more to set it")
        by_name = {motor.name: motor for motor in load(file)[0].motor}
        self.lines = [
            prepare_odrive.file_line(by_name[line.motor], self._fits.get(line.motor))
            if line.what == prepare_odrive.IN_FILE
            else line
            for line in self.lines
        ]
        return kept


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


def _is_06(motor: Motor) -> bool:
    return (motor.driver, motor.variant) == ("odrive", "0.6")


def _place(bus: Bus) -> Place:
    return Place(bus.interface, bus.channel, bus.bitrate)


def _set_link(bus: Bus) -> str:
    """What a person has to do before these controllers are heard again."""
    return f"{bus.name}: its controllers restart with {bus.bitrate} bit/s: `{set_anew(bus)}`, then run this again"


def _said(one: Setting) -> str:
    return f"{one.path} = {prepare_odrive.words(one.wanted)}"


def _allowed(what: str, question: str, *, yes: bool) -> bool:
    try:
        allow(what, question, yes=yes)
    except NotAllowedError as error:
        errors.print(str(error), highlight=False, markup=False)
        return False
    return True
