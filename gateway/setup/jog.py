"""Turns one motor a little, and never further: what to send, given what was received and the time. Pure.

How this works
--------------
The motors are those of the robot file, behind the same drivers, gears and speed loops as when the robot drives; this
one is told a speed that rises, stays and falls, with a share of its torque, and all others are told to roll. The phases
go one way only:

    LISTEN -> WAKE -> ARM -> TURN -> REST -> RELEASE -> DONE
                        \\-------\\-----> BRAKE -/

LISTEN sends nothing. From ARM on every cycle asks the same questions (`_objection`): does it report, does it obey, is
it where it should be by now, not faster, and not on the wrong side. The first no, or `stop`, leads to BRAKE: the
driver's stop frames, for as long as they make it slower and for BRAKE_NS at most, then those that release, again and
again. A motor whose stop frames make it faster (its phases are swapped) is released at once. Nothing leads back.
"""

from enum import Enum
from math import pi
from typing import Final, NamedTuple

from drivers.contract import CanFrame, MotorFeedback, MotorState
from drivers.setpoint import CommandKind
from gateway.config import Motor, RobotConfig, SpeedLoop
from gateway.control.drive_law import COAST, JointCommand, Measured
from gateway.core.assembly import Robot, build, with_motors
from gateway.core.motors import Motors
from gateway.setup.course import Course, trapezoid

SLOWEST, FASTEST = 0.05, 1.0  # rad/s at the output
SHORTEST, LONGEST = 0.2, 5.0  # s
FURTHEST: Final = pi  # rad at the output
USUAL_SPEED, USUAL_SECONDS = 0.5, 1.0
TORQUE_SHARE: Final = 0.3  # of max_torque and max_current, that a jog may use
TORQUE_RISES: Final = 0.5  # s until it has all of that, where the speed loop is ours
LEAST_SHARE: Final = 0.1  # of that, with which it begins
KP_SHARE, KI_SHARE = 0.1, 0.5  # of a speed loop of ours, which is tuned to a wheel that carries the robot: one in the
# air has a tenth of that inertia, and would swing
RAMP: Final = 0.25  # of the time: the speed rises, and falls, for so long
LEAST_REPORTS: Final = 50.0  # Hz; three of them within SILENCE_NS

PERIOD_NS: Final = 10_000_000  # at most between two steps, also where the robot's own loop is slower
LISTEN_NS: Final = 250_000_000
WAKE_NS: Final = 4_000_000_000  # controllers whose command timeout is looked at first take 2 s
ARM_NS: Final = 3_000_000_000
REST_NS: Final = 500_000_000
SILENCE_NS: Final = 60_000_000
BRAKE_NS: Final = 100_000_000
RELEASE_NS: Final = 50_000_000
CONFIRM_NS: Final = 500_000_000
STUCK_NS: Final = 400_000_000

BESIDE: Final = 0.15  # rad at the output: on the wrong side, or before it is told to turn at all
AHEAD: Final = 0.3  # rad beyond where it should be
BACKWARDS: Final = 0.5  # of the speed asked for, the other way round
TOO_FAST: Final = 1.5  # times the speed asked for
SPEED_NOISE: Final = 0.2  # rad/s at the output; at least two steps of what it tells
STANDING: Final = 0.1  # rad/s
STUCK: Final = 0.1  # of the way, that it has at least when it is not blocked
STUCK_FROM: Final = 0.1  # rad of the way, from which that is asked

_VELOCITY: Final = CommandKind.VELOCITY


class JogError(ValueError):
    """Why this motor is not turned; nothing was sent."""


class Phase(Enum):
    """Where a jog is."""

    LISTEN = "listen"
    WAKE = "wake"
    ARM = "arm"
    TURN = "turn"
    REST = "rest"
    BRAKE = "brake"
    RELEASE = "release"
    DONE = "done"


class Ending(Enum):
    """How a jog came to its end."""

    TURNED = "turned"
    STUCK = "stuck"  # it obeyed, and did not turn
    ASKED = "asked"  # a person or the system stopped it
    RUNAWAY = "runaway"  # too fast, too far, the wrong way
    LOST = "lost"  # it stopped reporting or obeying
    NEVER = "never"  # it did not get as far as to turn


class Outcome(NamedTuple):
    """`moved`: rad at the output as the motor told them, in the direction asked for; `released`: it says so itself."""

    motor: str
    ending: Ending
    reason: str
    moved: float | None
    released: bool

    @property
    def well(self) -> bool:
        """Whether it turned as it was told to, and is released."""
        return self.ending is Ending.TURNED and self.released


class _Objection(NamedTuple):
    ending: Ending
    reason: str


class Jog:
    """One motor of a robot file. Raises JogError, or ConfigError, before anything is sent.

    `speed`: rad/s at the output as the robot file counts it, below 0: backwards; `seconds`: for how long.
    """

    def __init__(
        self, config: RobotConfig, motor: str, *, speed: float = USUAL_SPEED, seconds: float = USUAL_SECONDS
    ) -> None:
        _check(config, motor, speed, seconds)
        robot = with_motors(build(config), _gentle(config, motor))
        self.bus = next(one.bus for one in config.motor if one.name == motor)
        self.phase = Phase.LISTEN
        self.outcome: Outcome | None = None
        self._name = motor
        self._speed = speed
        self._seconds = seconds
        self._plan = self._course(abs(speed), seconds)
        self._robot = robot
        self._motors = Motors(robot)
        self._place = robot.names.index(motor)
        _check_slowness(robot, self._place, speed)
        (group,) = [group for group in robot.groups if self._place in group.indices]
        self._driver = group.driver
        self._size = len(robot.names)
        self._torque = robot.limits[self._place].torque
        self._hosted = robot.speed_loops[self._place] is not None
        self.speed_step = (robot.capabilities[self._place].speed_step or 0.0) / abs(
            robot.transmissions[self._place].ratio
        )  # rad/s at the output, by which what it tells differs at least
        self._rest_speed = max(STANDING, 2.0 * self.speed_step)
        self._noise = max(SPEED_NOISE, 2.0 * self.speed_step)
        self._entered_ns: int | None = None
        self._before_ns: int | None = None
        self._start: float | None = None  # rad at the output
        self._moved: float | None = None
        self._ended: _Objection | None = None
        self._fastest = 0.0  # rad/s, at which braking began
        self._asked: str | None = None

    @property
    def finished(self) -> bool:
        """Whether there is nothing more to send."""
        return self.phase is Phase.DONE

    def stop(self, reason: str) -> None:
        """End it; the next `step` begins to brake."""
        self._asked = self._asked or reason

    def step(self, frames: list[CanFrame], now_ns: int) -> list[CanFrame]:
        """What to send now, given what was received since the last call; on this bus alone."""
        self._motors.receive(frames)
        dt = 0.0 if self._before_ns is None else (now_ns - self._before_ns) * 1e-9
        self._before_ns = now_ns
        self._entered_ns = now_ns if self._entered_ns is None else self._entered_ns
        measured = self._motors.measure(now_ns, dt)
        feedback = self._motors.feedback[self._place]
        self._follow(measured)
        self._advance(measured, feedback, now_ns)
        frames = self._frames(measured, now_ns)
        self._note(measured)
        return [frame for frame in frames if frame.bus == self.bus]

    def _note(self, measured: Measured) -> None:
        """For who wants to know what was measured and told in each cycle."""

    def stop_frames(self, *, now_ns: int) -> list[CanFrame]:
        """Frames that brake; for whoever cannot go on with `step`."""
        return self._driver.stop_frames(now_ns=now_ns)

    def coast_frames(self) -> list[CanFrame]:
        """Frames that release; for whoever cannot go on with `step`."""
        return self._driver.coast_frames()

    # -- where it is --------------------------------------------------------------------------------------------------

    def _follow(self, measured: Measured) -> None:
        """The way since it was armed, in the direction asked for."""
        position = measured.positions[self._place]
        if self._start is not None and position is not None:
            self._moved = (position - self._start) * self._sign

    @property
    def _sign(self) -> float:
        return 1.0 if self._speed > 0.0 else -1.0

    def _gone_ns(self, now_ns: int) -> int:
        return 0 if self._entered_ns is None else now_ns - self._entered_ns

    def _course(self, top: float, seconds: float) -> Course:
        """What it is to follow, in the direction asked for."""
        return trapezoid(top, seconds, ramp=RAMP)

    def _planned(self, gone: float) -> tuple[float, float]:
        """Speed, rad/s, and way, rad, after so many seconds, both positive in the direction asked for."""
        return self._plan.at(gone)

    def _enter(self, phase: Phase, now_ns: int) -> None:
        self.phase = phase
        self._entered_ns = now_ns

    def _end(self, objection: _Objection, measured: Measured, now_ns: int) -> None:
        """The first reason counts."""
        self._ended = self._ended or objection
        self._fastest = abs(measured.speeds[self._place] or 0.0)
        self._enter(Phase.BRAKE, now_ns)

    def _advance(self, measured: Measured, feedback: MotorFeedback, now_ns: int) -> None:
        """At most one step further."""
        gone_ns = self._gone_ns(now_ns)
        if self.phase in (Phase.LISTEN, Phase.WAKE):
            self._before_arming(measured, feedback, now_ns)
        elif self.phase in (Phase.ARM, Phase.TURN, Phase.REST):
            objection = self._objection(measured, feedback, now_ns)
            if objection is not None:
                self._end(objection, measured, now_ns)
            else:
                self._armed(measured, feedback, now_ns)
        elif self.phase is Phase.BRAKE and self._braked(measured, gone_ns):
            self._enter(Phase.RELEASE, now_ns)
        elif self.phase is Phase.RELEASE:
            idle = feedback.state is MotorState.IDLE
            if gone_ns >= RELEASE_NS and (idle or gone_ns >= CONFIRM_NS):
                self._finish(released=idle)

    def _before_arming(self, measured: Measured, feedback: MotorFeedback, now_ns: int) -> None:
        gone_ns = self._gone_ns(now_ns)
        if self._asked is not None:
            self._never(self._asked, Ending.ASKED, now_ns)
        elif self.phase is Phase.LISTEN:
            if gone_ns >= LISTEN_NS:
                self._enter(Phase.WAKE, now_ns)
        elif feedback.state is MotorState.IDLE and measured.positions[self._place] is not None:
            if self._turns(measured):
                self._never("it turns already: let it come to rest first", Ending.NEVER, now_ns)
                return
            self._start = measured.positions[self._place]
            self._enter(Phase.ARM, now_ns)
        elif gone_ns >= WAKE_NS:
            self._never(_why_not_idle(feedback), Ending.NEVER, now_ns)

    def _never(self, reason: str, ending: Ending, now_ns: int) -> None:
        self._ended = _Objection(ending, reason)
        self._enter(Phase.RELEASE, now_ns)

    def _armed(self, measured: Measured, feedback: MotorFeedback, now_ns: int) -> None:
        gone_ns = self._gone_ns(now_ns)
        if self.phase is Phase.ARM and feedback.state is MotorState.OPERATIONAL:
            self._enter(Phase.TURN, now_ns)
        elif self.phase is Phase.TURN and gone_ns >= self._seconds * 1e9:
            self._enter(Phase.REST, now_ns)
        elif self.phase is Phase.REST and (not self._turns(measured) or gone_ns >= REST_NS):
            way = self._planned(self._seconds)[1]
            turned = self._moved is not None and self._moved >= STUCK * way
            self._ended = _Objection(Ending.TURNED, "") if turned else _STUCK
            self._enter(Phase.RELEASE, now_ns)

    def _turns(self, measured: Measured) -> bool:
        speed = measured.speeds[self._place]
        return speed is None or abs(speed) > self._rest_speed

    def _braked(self, measured: Measured, gone_ns: int) -> bool:
        """Whether stop frames have done what they can."""
        speed = measured.speeds[self._place]
        if gone_ns >= BRAKE_NS:
            return True
        if speed is None or gone_ns == 0:
            return False
        return abs(speed) <= self._rest_speed or abs(speed) > self._fastest + self._noise

    def _finish(self, *, released: bool) -> None:
        ended = self._ended or _Objection(Ending.NEVER, "")
        self.outcome = Outcome(self._name, ended.ending, ended.reason, self._moved, released)
        self.phase = Phase.DONE

    # -- what may not be ----------------------------------------------------------------------------------------------

    def _objection(self, measured: Measured, feedback: MotorFeedback, now_ns: int) -> _Objection | None:
        """Why it must not go on."""
        if self._asked is not None:
            return _Objection(Ending.ASKED, self._asked)
        if feedback.fault is not None:
            return _Objection(Ending.LOST, feedback.fault.text)
        age_ns = measured.ages_ns[self._place]
        if age_ns is None or age_ns > SILENCE_NS or (self._moved is None and self.phase is not Phase.ARM):
            return _Objection(Ending.LOST, f"it has not reported for {(age_ns or 0) * 1e-9:.2f} s")
        if self.phase is Phase.ARM:
            if self._gone_ns(now_ns) >= ARM_NS:
                return _Objection(Ending.NEVER, "it does not become operational")
        elif feedback.state is not MotorState.OPERATIONAL:
            return _Objection(Ending.LOST, f"it does not obey any more: it is {feedback.state.value}")
        return self._runs_away(measured, now_ns)

    def _runs_away(self, measured: Measured, now_ns: int) -> _Objection | None:
        speed, moved = measured.speeds[self._place], self._moved
        if speed is None or moved is None:
            return None
        forward, asked = speed * self._sign, abs(self._speed)
        _, way = self._planned(self._gone(now_ns))
        if moved < -BESIDE or forward < -(BACKWARDS * asked + self._noise):
            return _Objection(Ending.RUNAWAY, f"it turned the wrong way: {moved:.2f} rad, {forward:.2f} rad/s")
        if moved > way + AHEAD:
            return _Objection(Ending.RUNAWAY, f"it turned {moved:.2f} rad where {way:.2f} were asked for")
        if forward > TOO_FAST * asked + self._noise:
            return _Objection(Ending.RUNAWAY, f"it turned {forward:.2f} rad/s where {asked:.2f} were asked for")
        blocked = way >= STUCK_FROM and moved < STUCK * way
        if self.phase is Phase.TURN and blocked and self._gone_ns(now_ns) >= STUCK_NS:
            return _STUCK
        return None

    def _gone(self, now_ns: int) -> float:
        """S since it was told to turn."""
        if self.phase is Phase.ARM:
            return 0.0
        return self._seconds if self.phase is Phase.REST else self._gone_ns(now_ns) * 1e-9

    # -- what is sent -------------------------------------------------------------------------------------------------

    def _frames(self, measured: Measured, now_ns: int) -> list[CanFrame]:
        if self.phase in (Phase.LISTEN, Phase.DONE):
            return []
        if self.phase is Phase.BRAKE:
            return self.stop_frames(now_ns=now_ns)
        commands = [COAST] * self._size
        if self.phase in (Phase.ARM, Phase.TURN, Phase.REST):
            commands[self._place] = self._command(now_ns)
        frames = list(self._motors.command(commands, measured))  # also tells the driver that it is released on purpose
        if self.phase is Phase.RELEASE and self._gone_ns(now_ns) < RELEASE_NS:
            return [*self.coast_frames(), *frames]
        return frames

    def _command(self, now_ns: int) -> JointCommand:
        speed, _ = self._planned(self._gone(now_ns))
        gone = self._gone(now_ns)
        share = min(1.0, LEAST_SHARE + (1.0 - LEAST_SHARE) * gone / TORQUE_RISES)
        return JointCommand(_VELOCITY, speed * self._sign, limit=self._torque * share if self._hosted else None)


_STUCK: Final = _Objection(
    Ending.STUCK, "it did not turn: it is blocked, not fastened to what turns, or has no torque (is there motor power?)"
)


def _why_not_idle(feedback: MotorFeedback) -> str:
    if feedback.fault is not None:
        return feedback.fault.text
    if feedback.state is MotorState.SILENT:
        return feedback.silence or "it is not heard: power, cable, bit rate, id?"
    if feedback.position is None:
        return "it does not tell its position"
    return f"it does not become idle: it is {feedback.state.value}"


def _check(config: RobotConfig, name: str, speed: float, seconds: float) -> None:
    """Raises JogError."""
    motors = {motor.name: motor for motor in config.motor}
    if name not in motors:
        raise JogError(f"motor {name!r}: no such [[motor]]; there is {', '.join(motors)}")
    fastest = min(FASTEST, config.limits.motor_speed[name])
    if not SLOWEST <= abs(speed) <= fastest:
        raise JogError(
            f"speed = {speed:g}: must be {SLOWEST:g} to {fastest:g} rad/s at the output, or the same below 0"
        )
    if not SHORTEST <= seconds <= LONGEST:
        raise JogError(f"seconds = {seconds:g}: must be {SHORTEST:g} to {LONGEST:g}")
    if abs(speed) * seconds > FURTHEST:
        raise JogError(f"{abs(speed):g} rad/s for {seconds:g} s: must be {FURTHEST:.2f} rad at most, half a turn")
    rate = motors[name].feedback_rate
    if rate is not None and rate < LEAST_REPORTS:
        raise JogError(
            f"motor {name}: feedback_rate = {rate:g}: must be {LEAST_REPORTS:g} Hz at least, so that a runaway is seen"
        )


def _check_slowness(robot: Robot, place: int, speed: float) -> None:
    """Raises JogError for a speed that its controller would brake."""
    least = robot.capabilities[place].least_speed / abs(robot.transmissions[place].ratio)
    if robot.speed_loops[place] is None and abs(speed) < least:
        name, most = robot.names[place], f"and no jog is faster than {FASTEST:g}"
        raise JogError(
            f"motor {name}: speed = {speed:g}: must be {least:.3g} rad/s at least for its controller, {most}"
        )


def _gentle(config: RobotConfig, name: str) -> RobotConfig:
    """The same robot, whose motor of this name has a share of its torque."""
    return config.model_copy(update={"motor": [_weak(one) if one.name == name else one for one in config.motor]})


def _weak(motor: Motor) -> Motor:
    share: dict[str, object] = {
        "max_torque": motor.max_torque * TORQUE_SHARE,
        "max_current": motor.max_current * TORQUE_SHARE,
    }
    loop = motor.speed_loop
    if loop is not None:
        share["speed_loop"] = SpeedLoop(kp=loop.kp * KP_SHARE, ki=loop.ki * KI_SHARE)
    return motor.model_copy(update=share)
