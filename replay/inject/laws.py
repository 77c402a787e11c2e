"""The laws of motion: what holds in every drive, whatever commanders, motors, buses and the loop do.

Each law is a function from the recorded cycles of a drive to its violations in words, and knows nothing of how the core
keeps it. A new process begins where the number of the cycle falls back; nothing before it counts for it.
"""

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from math import hypot, inf
from typing import NamedTuple

from gateway.config import RobotConfig
from gateway.control.limits import stopping_time
from gateway.types import ZERO_TWIST, BusEventKind, Inputs, Mode, Region, RequestKind, TwistCommand
from replay.drive.moment import Moment

DRIVING = frozenset({Mode.DRIVE, Mode.DEGRADED})
RESTING = frozenset({Mode.IDLE, Mode.ESTOP, Mode.FAULT})
ROUNDING = 1e-9  # of a setpoint, m/s or rad/s
STEP = 0.05  # of its top speed that a wheel's setpoint may move in one period; see `no_steps`
PAUSE = 1.5  # periods between two cycles; from there on the loop paused
DIP_NS = 2_000_000_000  # of silence that is forgiven to who tells when it sent
RETURN_NS = 200_000_000  # for motors to be heard again when their bus is back
STANDING = 0.05  # m/s and rad/s of the true body that still count as rest
DWELL_S = 0.25  # that wheels have to stand until it is rest
NOTICE_NS = 200_000_000  # from the plan of a manoeuvre to its first motion
FOLLOWING_S = 0.25  # by which real wheels may be later than their setpoints
FLOOR = 1.0  # m/s^2 that every floor gives to locked wheels
SWAYING = 0.15  # m/s and rad/s of the true body of a robot that balances that still count as rest
SETTLING_S = 2.5  # in which it comes to that behind its setpoint
HELD_NS = 10_000_000_000  # for which somebody holds a robot that was asked to stand up

Drive = Sequence[Moment]
Law = Callable[[Drive, RobotConfig], Iterator[str]]


class Pair(NamedTuple):
    """Two cycles of one process, one after the other."""

    before: Moment
    now: Moment


def grows_only_in_drive(drive: Drive, _: RobotConfig) -> Iterator[str]:
    """Outside DRIVE and DEGRADED no axis of the body's setpoint grows or changes its sign."""
    for before, now in pairs(drive):
        if now.outputs.mode not in DRIVING and _grows(before, now):
            yield f"{_when(now)}: setpoint grows from {_setpoint(before)} to {_setpoint(now)}"


def what_is_let_go_stays_so(drive: Drive, config: RobotConfig) -> Iterator[str]:
    """A motor that was released, fell silent, or was braked in an emergency stop, is not driven before IDLE.

    Not of a motor that falls silent with its bus: it may go on braking when the bus is back.
    """
    names = config.robot.motor_names()
    let_go: dict[int, str] = {}
    reach = _Reach(config)
    for now in drive:
        if now.inputs.cycle == 0 or now.outputs.mode is Mode.IDLE:
            let_go.clear()
        reach.receive(now.inputs)
        if now.outputs.mode is Mode.IDLE:
            continue
        stopped = now.outputs.mode is Mode.ESTOP and not _balances(config)  # which stays upright in it
        for index in reach.silent(now):
            let_go.setdefault(index, f"{_when(now)}: silent")
        for index, setpoint in enumerate(now.outputs.trace.wheel_setpoints):
            if setpoint and (index in let_go or stopped):
                yield f"{_when(now)}: {names[index]} driven at {setpoint} after {let_go.get(index, 'the stop')}"
            elif setpoint is None or stopped:
                let_go.setdefault(index, f"{_when(now)}: {'released' if setpoint is None else 'braked'}")


def nothing_moves_without_a_zero(drive: Drive, config: RobotConfig) -> Iterator[str]:
    """Whoever drives has sent a zero of its own since the robot last entered IDLE, ESTOP or FAULT, or started.

    A zero after which it asked for motion while the robot still lay in IDLE does not count.
    """
    zeros = _Zeros(config)
    before: Moment | None = None
    for now in drive:
        if now.inputs.cycle == 0:
            zeros, before = _Zeros(config), None
        zeros.receive(now.inputs)
        driving = now.outputs.mode in DRIVING
        target = now.outputs.trace.target
        if target != ZERO_TWIST and not any(one.twist == target for one in zeros.entitled(now.inputs.now_ns)):
            yield f"{_when(now)}: target {tuple(target)} of nobody who has sent a zero"
        if driving and before and _grows(before, now) and not zeros.entitled(now.inputs.now_ns):
            yield f"{_when(now)}: setpoint grows, and nobody who commands has sent a zero"
        if now.outputs.mode in RESTING and (before is None or before.outputs.mode is not now.outputs.mode):
            zeros.begin(now.inputs.now_ns)
        elif now.outputs.mode is Mode.IDLE:
            zeros.forget_the_impatient()
        before = now


def no_steps(drive: Drive, config: RobotConfig) -> Iterator[str]:
    """No setpoint of a wheel moves by more than STEP of its top speed in a period, but into an emergency stop.

    In a period of 4 ms a fall back to the measured motion takes 2 %, a joint that turns under a fast robot at its own
    top speed 2.8 % (moby: 7 rad/s), the acceleration limits below 0.5 %.
    A motor that was not heard in the cycle before was told nothing: it may go on from nearer to how it turns.
    Not of a robot that balances: it catches itself.
    """
    if _balances(config):
        return
    names = config.robot.motor_names()
    for before, now in pairs(drive):
        periods = (now.inputs.now_ns - before.inputs.now_ns) * 1e-9 * config.loop.rate
        if periods > PAUSE or now.outputs.mode is Mode.ESTOP:
            continue
        old_trace, trace = before.outputs.trace, now.outputs.trace
        for index, (name, old, new) in enumerate(
            zip(names, old_trace.wheel_setpoints, trace.wheel_setpoints, strict=True)
        ):
            if old is None or new is None or abs(new - old) <= STEP * config.limits.motor_speed[name]:
                continue
            speed = trace.wheel_speeds[index]
            taken_up = old_trace.wheel_speeds[index] is None and (speed is None or abs(new - speed) < abs(old - speed))
            if not taken_up:
                yield f"{_when(now)}: {name} steps from {old:.4f} to {new:.4f} rad/s"


def manoeuvres_only_as_asked(drive: Drive, config: RobotConfig) -> Iterator[str]:
    """A chassis is turned round only for a fresh command that asks for a region, and slower than that commands.

    While `state` tells that it is, the joint is driven straight along or across the chassis, no faster than the
    setpoint, and the platform is not turned; for NOTICE_S before, wheels stand. A command for less slows it down, and
    not at once. How far it may get is in no law,
    because pushes and slopes move it too: see tests/gateway/test_region_drives.py.
    """
    if getattr(config.robot, "manoeuvre", None) is None:
        return
    radius, offset, track = (getattr(config.robot, key) for key in ("wheel_radius", "axle_offset", "track"))
    zeros, planned_ns = _Zeros(config), -NOTICE_NS
    for before, now in zip((None, *drive[:-1]), drive, strict=True):
        zeros = _Zeros(config) if now.inputs.cycle == 0 else zeros
        zeros.receive(now.inputs)
        stage = now.outputs.status.chassis.get("manoeuvre") if now.outputs.status is not None else None
        if any(event.code == "manoeuvre_planned" for event in now.outputs.events):
            planned_ns = now.inputs.now_ns
            if stage != "planned":
                yield f"{_when(now)}: a manoeuvre is planned, and state tells {stage!r}"
        if stage not in {"planned", "turning", "driving"}:
            continue
        asked = [hypot(*one.twist[:2]) for one in zeros.entitled(now.inputs.now_ns) if one.region is not Region.ANY]
        left, right, joint = (speed or 0.0 for speed in now.outputs.trace.wheel_setpoints)
        along, across = radius * (left + right) / 2.0, offset * radius * (right - left) / track
        turning = joint + across / offset
        most, setpoint = max(asked, default=0.0), hypot(*now.outputs.trace.setpoint[:2])
        slower = before is not None and setpoint < hypot(*before.outputs.trace.setpoint[:2])
        most = setpoint if asked and slower else min(most, setpoint)
        if hypot(along, across) > most + ROUNDING or min(abs(along), abs(across)) > ROUNDING or abs(turning) > ROUNDING:
            yield f"{_when(now)}: {stage} at {along}, {across} m/s and {turning} rad/s where {most} m/s are asked for"
        if hypot(along, across) > 0.0 and now.inputs.now_ns - planned_ns < NOTICE_NS:
            yield f"{_when(now)}: moves {(now.inputs.now_ns - planned_ns) * 1e-9} s after it was planned"


def stands_only_as_asked(drive: Drive, config: RobotConfig) -> Iterator[str]:
    """A robot that balances is given nothing before somebody asks it to stand up, nor after it was let go or fell.

    Whoever asks holds it for HELD_NS; if nothing was begun by then it has to be asked again.
    """
    if not _balances(config):
        return
    asked_ns, stands, fell = -HELD_NS, False, False
    for now in drive:
        if now.inputs.cycle == 0:
            asked_ns, stands, fell = -HELD_NS, False, False
        if any(request.kind is RequestKind.STAND_UP for request in now.inputs.requests):
            asked_ns = now.inputs.now_ns
        driven = any(setpoint is not None for setpoint in now.outputs.trace.wheel_setpoints)
        fell = fell and now.outputs.mode is not Mode.STARTING  # which it has to be asked for
        if driven and fell:
            yield f"{_when(now)}: driven after a fall"
        if driven and not stands and now.inputs.now_ns - asked_ns > HELD_NS:
            yield f"{_when(now)}: driven, and nobody has asked it to stand up"
        fell = fell or any(event.code == "fault_fallen" for event in now.outputs.events)
        asked_ns = -HELD_NS if driven and not stands else asked_ns
        stands = driven


def released_in_idle(drive: Drive, config: RobotConfig) -> Iterator[str]:
    """In IDLE no motor is given anything but its release."""
    names = config.robot.motor_names()
    for now in drive:
        if now.outputs.mode is Mode.IDLE:
            for name, setpoint in zip(names, now.outputs.trace.wheel_setpoints, strict=True):
                if setpoint is not None:
                    yield f"{_when(now)}: {name} is given {setpoint} rad/s"


def rests_in_time(drive: Drive, config: RobotConfig) -> Iterator[str]:
    """After the last command the robot comes to rest within the computed time. Not of a robot that cannot brake."""
    limits = config.limits
    time_to_stop = stopping_time(
        velocity=limits.velocity.as_twist(),
        acceleration=limits.acceleration.as_twist(),
        jerk=limits.jerk.as_twist(),
    )
    if limits.motor_acceleration is not None:  # the setpoint at rest, what the wheels are told may still be on its way
        time_to_stop += max(limits.motor_speed[name] / most for name, most in limits.motor_acceleration.items())
    last = max((now.t for now in drive if now.inputs.commands), default=0.0)
    longest = max(source.timeout for source in config.commands.source)
    time_to_stop = max(time_to_stop, max(limits.velocity.as_twist()[:2]) / FLOOR)  # held as long as it may slide
    due = last + longest + time_to_stop + DWELL_S + FOLLOWING_S
    resting, standing = RESTING, STANDING
    if _balances(config):  # upright until somebody lets it down
        due, resting, standing = due + SETTLING_S, RESTING | {Mode.STOPPING}, SWAYING
    for now in drive:
        if now.t < due:
            continue
        if now.outputs.mode not in resting:
            yield f"{_when(now)}: last command at {last:.3f} s, due to rest at {due:.3f} s"
        elif max(map(abs, now.truth.twist)) > standing:
            yield f"{_when(now)}: due to rest at {due:.3f} s, moves at {tuple(now.truth.twist)}"


LAWS: dict[str, Law] = {
    "the setpoint grows in DRIVE and DEGRADED only": grows_only_in_drive,
    "what is let go stays so until IDLE": what_is_let_go_stays_so,
    "nothing moves without a zero of its own": nothing_moves_without_a_zero,
    "no steps but into an emergency stop": no_steps,
    "everything is released in IDLE": released_in_idle,
    "stands up only as it was asked to": stands_only_as_asked,
    "turns its chassis round only as it was asked to": manoeuvres_only_as_asked,
}
REST = "rests within the computed time"  # of drives that leave the motors able to brake
ALL_LAWS: dict[str, Law] = {**LAWS, REST: rests_in_time}


def violations(drive: Drive, config: RobotConfig, *, can_brake: bool) -> dict[str, list[str]]:
    """Of every law that this drive is to keep, by name."""
    laws = ALL_LAWS if can_brake else LAWS
    return {name: list(law(drive, config)) for name, law in laws.items()}


def pairs(drive: Drive) -> Iterator[Pair]:
    """Every cycle with the one before it in the same process."""
    for before, now in pairwise(drive):
        if now.inputs.cycle != 0:
            yield Pair(before, now)


class _Zeros:
    """Who has sent a zero, told from the commands alone."""

    def __init__(self, config: RobotConfig) -> None:
        self._timeouts_ns = {source.name: round(source.timeout * 1e9) for source in config.commands.source}
        self._widths = getattr(config.robot, "narrowest", inf), getattr(config.robot, "widest", -inf)
        self._newest: dict[str, TwistCommand] = {}
        self._zeroed: set[str] = set()
        self._since_ns = -1

    def begin(self, now_ns: int) -> None:
        """The robot rests, was stopped or failed."""
        self._zeroed.clear()
        self._since_ns = now_ns

    def forget_the_impatient(self) -> None:
        """The robot has not started: a zero counts as long as nothing else follows it."""
        self._zeroed = {name for name in self._zeroed if _is_zero(self._newest[name])}

    def receive(self, inputs: Inputs) -> None:
        """The commands of a cycle. Another sender needs a zero too, and so does an unstamped one after its timeout."""
        for command in inputs.commands:
            if command.width is not None and not self._widths[0] <= command.width <= self._widths[1]:
                continue  # refused as a whole
            before = self._newest.get(command.source)
            self._newest[command.source] = command
            if before is not None and self._is_another(before, command):
                self._zeroed.discard(command.source)
            if _is_zero(command) and command.received_ns > self._since_ns:
                self._zeroed.add(command.source)

    def entitled(self, now_ns: int) -> list[TwistCommand]:
        """Fresh commands of sources that have sent their zero."""
        fresh = [one for one in self._newest.values() if now_ns - one.received_ns <= self._timeouts_ns[one.source]]
        return [one for one in fresh if one.source in self._zeroed]

    def _is_another(self, before: TwistCommand, command: TwistCommand) -> bool:
        gap_ns = command.received_ns - before.received_ns
        patience_ns = DIP_NS if command.stamped and before.stamped else 0
        late = gap_ns > max(self._timeouts_ns[command.source], patience_ns)
        return late or command.sender != before.sender


class _Reach:
    """Which motors could be heard, told from the events of the buses alone."""

    def __init__(self, config: RobotConfig) -> None:
        self._buses = [motor.bus for motor in config.motors_in_order()]
        self._down: set[str] = set()
        self._away_ns: dict[str, int] = {}  # when a bus was last down

    def receive(self, inputs: Inputs) -> None:
        """The bus events of a cycle."""
        if inputs.cycle == 0:
            self._down.clear()
            self._away_ns.clear()
        for event in inputs.bus_events:
            if event.kind is BusEventKind.DOWN:
                self._down.add(event.bus)
            elif event.kind is BusEventKind.UP:
                self._down.discard(event.bus)
                self._away_ns[event.bus] = inputs.now_ns
        for bus in self._down:
            self._away_ns[bus] = inputs.now_ns

    def silent(self, now: Moment) -> Iterator[int]:
        """Places of the motors that nothing is heard of though their bus is up, and has been for RETURN_NS."""
        for index, (bus, speed) in enumerate(zip(self._buses, now.outputs.trace.wheel_speeds, strict=True)):
            away_ns = self._away_ns.get(bus)
            if speed is None and (away_ns is None or now.inputs.now_ns - away_ns > RETURN_NS):
                yield index


def _grows(before: Moment, now: Moment) -> bool:
    axes = zip(_setpoint(before), _setpoint(now), strict=True)
    return any(abs(new) > abs(old) + ROUNDING or new * old < -(ROUNDING**2) for old, new in axes)


def _setpoint(now: Moment) -> tuple[float, ...]:
    """Of every axis."""
    trace = now.outputs.trace
    return (*trace.setpoint, *[axis.setpoint for axis in trace.more])


def _is_zero(command: TwistCommand) -> bool:
    """It asks for nothing, also not of the width: a width to go to is motion wherever the wheels are."""
    return command.twist == ZERO_TWIST and not command.width_rate and command.width is None


def _balances(config: RobotConfig) -> bool:
    return getattr(config.robot, "balance", None) is not None


def _when(now: Moment) -> str:
    return f"{now.t:.3f} s, {now.outputs.mode.value}"
