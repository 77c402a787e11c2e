"""The core: one pure step from everything known to everything said.

How this works
--------------
receive -> measure -> judge -> select -> decide -> limit -> kinematics -> motor commands -> frames. Each stage is a
part of its own with its own state; the engine only passes values along. Time is an argument, nothing blocks, and the
same inputs give the same outputs: the live service, the simulation and the replay run this very code.

Authority over the motors only ever shrinks between two rests: the setpoint of the body grows in DRIVE and DEGRADED and
nowhere else, and a motor that was lost, released or found faulty is not driven again before IDLE. An emergency stop
alone may step, and may brake a motor that was lost before.
What a chassis does on its own between the setpoint and its joints is its drive law (`gateway.control.drive_law`), what
the motors left can do is `gateway.core.ability`. Launch will be a drive law's, traction comes after `measure`.
"""

from collections.abc import Sequence
from functools import partial
from math import sqrt
from typing import Final

from drivers.contract import CanFrame, MotorFeedback, MotorState
from drivers.records import maker
from gateway.arithmetic import dot, sin_cos
from gateway.config import RobotConfig
from gateway.control.drive_law import COAST, JointCommand, Measured, Motion
from gateway.control.limits import excess, scale_to, scaled
from gateway.control.posture import Posture, Stance
from gateway.control.slip_correction import SlipCorrection
from gateway.core import snapshot as snapshots
from gateway.core.ability import FULL, Abilities, Ability
from gateway.core.arbiter import Arbiter, Selection
from gateway.core.assembly import Robot, build, limiter
from gateway.core.health import Fault, FaultKind, Health, HealthMonitor
from gateway.core.joint_trust import UNKNOWN, JointTrust
from gateway.core.limp_watch import LimpWatch
from gateway.core.motors import Motors
from gateway.core.odometry import WheelOdometry
from gateway.core.reporter import Reporter, waiting_for
from gateway.core.sensors import Readings, Sensors
from gateway.core.settings import ANGULAR_SPEED, LINEAR_SPEED, SPEED_OVERRIDE, Settings
from gateway.core.slip import NO_SLIP, Slip, SlipDetector
from gateway.core.slip_model import slip_model
from gateway.core.standstill import Standstill
from gateway.core.supervisor import Situation, next_mode
from gateway.core.targets import more_of
from gateway.core.torque_loss import Mechanics, TorqueLossDetector
from gateway.kinematics.contract import Estimate
from gateway.types import (
    PLANAR,
    ZERO_TWIST,
    AxisTrace,
    BusEventKind,
    Event,
    Inputs,
    Level,
    Mode,
    Outputs,
    Rates,
    Region,
    Reply,
    Request,
    RequestKind,
    Status,
    Trace,
    Twist,
    TwistCommand,
    TwistFrame,
)

_measured: Final = maker(Measured)
_trace: Final = maker(Trace)
_outputs: Final = maker(Outputs)
# Members of enumerations, each looked up once: where every cycle does, it takes a tenth of its time.
_ANY: Final = Region.ANY
_IDLE: Final = Mode.IDLE
_STARTING: Final = Mode.STARTING
_FAULT: Final = Mode.FAULT
_BODY: Final = TwistFrame.BODY
_ODOM: Final = TwistFrame.ODOM
_DEGRADED: Final = Mode.DEGRADED
_ESTOP: Final = Mode.ESTOP
_OPERATIONAL: Final = MotorState.OPERATIONAL
_SILENT: Final = MotorState.SILENT

# Tuples: to look a member up by its hash, which is a function of Python, takes longer.
DRIVING: Final = (Mode.DRIVE, Mode.DEGRADED)
HOLDING: Final = (Mode.STARTING, Mode.DRIVE, Mode.DEGRADED, Mode.STOPPING)
POSTURES: Final = (RequestKind.STAND_UP, RequestKind.LET_DOWN)
ARMING_TIMEOUT_NS: Final = 3_000_000_000
ANSWER_TIME_NS: Final = 3_000_000_000  # since anybody answered anew; only then is a silent motor one to drive without
BRAKING: Final = (Mode.STOPPING, Mode.FAULT)
# On entering these every source needs a new zero.
DISMISSING: Final = (Mode.IDLE, Mode.ESTOP, Mode.FAULT)
MAX_STEP_PERIODS: Final = 5  # a longer pause of the loop is no time in which the setpoint may have moved on
RELEASED: Final = 0  # the stop category that lets go at once, of a robot that balances
HELD: Final = 2  # the stop category that goes on holding at rest (IEC 60204-1)
SLACK: Final = 0.1  # of top speed by which a braking setpoint may be ahead of the measured motion
RETREAT: Final = 5.0  # top speeds per second at which it is taken back beyond that: no step, whatever was measured
Numbers = Sequence[float | None]


class Engine:
    """From `Inputs` to `Outputs`, once per cycle; one writer, one thread.

    `state`: a snapshot to go on from. Raises ConfigError, SnapshotError at construction.
    """

    def __init__(self, config: RobotConfig, state: snapshots.State | None = None) -> None:
        robot = build(config)
        self._robot_name = config.robot.name
        self._names = robot.names
        top_speeds = tuple(limits.speed for limits in robot.limits)
        self._kinematics = robot.kinematics
        self._law = robot.law
        self._selects = robot.law.features.choices  # the law has a say in what is driven towards
        self._grips = robot.law.features.grip
        self._posture = robot.law.posture
        self._motors = Motors(robot)
        self._arbiter = Arbiter(config.commands.source, robot.law.features)
        axes = robot.kinematics.axes
        self._more = axes[len(PLANAR) :]
        self._velocity = config.limits.velocity.as_rates(axes)
        self._limiter = limiter(config, robot)
        self._abilities = Abilities(config, robot)
        self._ability: Ability | None = FULL
        self._limp_watch = LimpWatch(self._velocity, config.degraded.speed)
        self._health = HealthMonitor(robot.names, limits=robot.limits)
        self._torque_loss = _torque_loss_detector(robot, config)
        self._odometry = WheelOdometry(
            robot.kinematics, top_speeds=top_speeds, sideways=config.robot.SIDEWAYS, growth=config.odometry.growth()
        )
        self._trust = JointTrust(robot.kinematics.steered, absolute=robot.absolute, top_speeds=top_speeds)
        self._sensors = Sensors(config.sensor, top_turn=config.limits.velocity.wz, ports=robot.ports)
        self._settings = Settings(config.settings, robot.law, config.limits.velocity)
        model = slip_model(config, robot)
        self._slip = None if model is None else SlipDetector(robot.names, model)
        self._correction = SlipCorrection(() if model is None else model.wheels(robot), 1.0 / config.loop.rate)
        self._standstill = Standstill()
        self._reporter = Reporter(config)
        self._period = 1.0 / config.loop.rate
        self._stop_category = config.stop.category
        self._turned = 0.0  # rad, by which the law turned the setpoint of the last cycle into a manoeuvre
        self._last_ns: int | None = None
        self._answered_ns: int | None = None  # the first cycle, and the last in which a silent motor was heard at rest
        self._mode = _IDLE
        self._mode_since_ns = 0
        self._energised = False  # motors were armed and have not been released since
        self._rolled = False  # it rolled after an emergency stop had released it
        self._unheard = False  # on the way to rest the setpoint went to nobody, and no motor has told its speed since
        self._shutdown = False
        self._buses_down: dict[str, str] = {}
        self._none = (False,) * len(robot.names)  # of the motors
        self._believable: tuple[bool, ...] = (True,) * len(robot.names)
        self._measured = self._motors.measure(0, self._period)  # nothing yet
        self._expected_speeds = tuple(partial(self._expected_speed, index) for index in range(len(robot.names)))
        self._robot_file = snapshots.fingerprint(config)
        if state is not None:
            snapshots.put(self, self._robot_file, state)

    def snapshot(self) -> snapshots.State:
        """The state after the last step as plain data; `Engine(config, state)` goes on from it byte for byte."""
        return snapshots.take(self, self._robot_file)

    @property
    def mode(self) -> Mode:
        """The operating mode decided by the last step."""
        return self._mode

    def step(self, inputs: Inputs) -> Outputs:
        """One cycle."""
        now_ns = inputs.now_ns
        dt = self._elapsed(now_ns)
        inputs = self._receive(inputs)
        self._measured = measured = self._measure(now_ns, dt)
        if self._posture is not None:
            self._look_at(self._posture, measured)
        health = self._judge(measured)
        self._believable = health.brakable
        if self._posture is not None:
            self._posture.whole = all(health.usable)
        adrift = self._adrift(measured)
        selection = self._arbiter.select(now_ns)
        replies, granted = self._answer(inputs)
        self._ability = self._abilities.of(health, measured)
        self._decide(inputs, health, selection, granted=granted)
        target = self._target(selection)
        more = self._target_of_more(selection) if self._more else ()
        motion = self._limit((*target, *more) if more else target, measured, health, selection.command)
        frames = self._command(motion, measured, health)
        twist, residual, residuals, _ = measured.estimate or (None, None, None, ())
        command = self._arbiter.moving(now_ns) if self._mode is _IDLE else selection.command
        reason = waiting_for(
            self._mode,
            faults=health.faults,
            command=command,
            shutdown=self._shutdown,
            unready=self._law.unready if self._mode is _IDLE else None,
        )
        events = self._reporter.events(
            inputs,
            mode=self._mode,
            reason=reason,
            faults=health.faults,
            replies=replies,
            slip=self._slip.named() if measured.slipping and self._slip else None,
            silent=self._sensors.silent,
            jumped=self._sensors.jumped,
        )
        if motion.events:
            events = (*events, *self._reporter.of_law(motion.events, now_ns))
        if adrift:
            events = (*events, *self._reporter.of_law(adrift, now_ns))
        status = None
        if self._reporter.status_due(now_ns) or events or motion.events:
            status = self._status(inputs, health, selection, reason=reason, motion=motion, measured=measured)
        trace = _trace(
            (
                target,
                self._limiter.setpoint,
                twist,
                self._odometry.pose,
                self._motors.setpoints,
                measured.speeds,
                measured.positions,
                _seconds(selection.age_ns),
                residual,
                residuals,
                motion.numbers,
                self._trace_of_more(more, measured) if more else (),
                measured.heading,
                measured.attitude,
                measured.ranges,
            )
        )
        odometry = self._odometry.read(twist, residual) if self._reporter.odometry_due(now_ns) else None
        finished = self._shutdown and not self._energised
        return _outputs((frames, self._mode, events, replies, odometry, status, trace, finished))

    def coast_frames(self) -> list[CanFrame]:
        """Frames that release every motor; valid in any state."""
        return self._motors.coast_frames()

    def stop_frames(self, *, now_ns: int) -> list[CanFrame]:
        """Frames that stop every motor when this core can no longer be trusted; sent until it is at rest."""
        return self._motors.stop_frames(now_ns=now_ns)

    def at_rest(self, frames: Sequence[CanFrame], *, now_ns: int) -> bool:
        """Takes frames in, and nothing else: whether every motor reports that it stands. Beside `stop_frames`."""
        self._motors.receive(frames)
        measured = self._motors.measure(now_ns, self._period)
        return None not in measured.speeds and not self._motors.turning(measured)

    # receive and measure

    def _look_at(self, posture: Posture, measured: Measured) -> None:
        """How it leans; a fall is over when what has fallen lies still."""
        stood = posture.stands
        posture.look(measured.attitude, measured.now_ns)
        if posture.fallen is not None and stood:
            self._let_go()
        elif posture.fallen is not None and self._rested(measured.now_ns):
            posture.lies()

    def _let_go(self) -> None:
        """Every motor is released, whatever is measured."""
        self._energised = False
        self._health.expect_nothing()

    def _elapsed(self, now_ns: int) -> float:
        last_ns, self._last_ns = self._last_ns, now_ns
        if last_ns is None:
            self._answered_ns = now_ns
            return self._period
        elapsed, longest = max(now_ns - last_ns, 0) * 1e-9, MAX_STEP_PERIODS * self._period
        if elapsed > longest:
            self._health.look_anew()
            if self._torque_loss is not None:
                self._torque_loss.forget()
        return min(elapsed, longest)

    def _receive(self, inputs: Inputs) -> Inputs:
        """Take everything in; commands that this chassis cannot follow are among the refusals of what is given back."""
        self._motors.receive(inputs.frames)
        if self._sensors.ports:
            self._sensors.hear(inputs.frames)
        refused = []
        for command in inputs.commands:
            refusal = self._arbiter.receive(command)
            if refusal is not None:
                refused.append(refusal)
        for sample in inputs.samples:
            self._sensors.receive(sample)
        for event in inputs.bus_events:
            if event.kind is BusEventKind.DOWN:
                self._buses_down[event.bus] = event.text
            elif event.kind is BusEventKind.UP:
                self._buses_down.pop(event.bus, None)
        return inputs._replace(refusals=(*inputs.refusals, *refused)) if refused else inputs

    def _measure(self, now_ns: int, dt: float) -> Measured:
        before = self._motors.feedback
        measured = self._motors.measure(now_ns, dt)
        if self._mode is _IDLE and _appeared(before, self._motors.feedback):
            self._answered_ns = now_ns
        angles = self._trust.angles(measured.positions)
        deltas, jumped = self._odometry.deltas(angles, measured.ages_ns, now_ns)
        self._trust.watch(angles, jumped, now_ns)
        trusted = self._trust.trusted(angles)
        speeds, deltas = self._believed(measured.speeds, deltas, trusted)
        estimate = self._kinematics.twist(speeds, trusted)
        readings = self._sensors.read(now_ns)
        slip = NO_SLIP if self._slip is None else self._slip.look(measured, speeds, estimate, readings.heading)
        if slip.wheels:
            estimate, deltas = self._without(slip, estimate, speeds, deltas, trusted)
        measurable = estimate is not None or None not in speeds
        moves = self._law.moves(measured, turning=self._motors.turning(measured))
        self._standstill.measure(turning=moves, measurable=measurable, now_ns=now_ns)
        goes = 0.0 if moves is False or estimate is None else self._way_per_second(estimate.rates)
        self._standstill.slide(goes, now_ns)
        self._move(deltas, trusted, readings, estimate=estimate, slip=slip, dt=dt)
        return _measured(
            (
                now_ns,
                dt,
                measured.speeds,
                measured.positions,
                measured.torques,
                measured.ages_ns,
                tuple(trusted),
                estimate,
                slip.slipping,
                readings.heading and readings.heading.angle,
                readings.attitude,
                readings.ranges,
                measured.torque_ages_ns,
            )
        )

    def _way_per_second(self, rates: Rates) -> float:
        """M/s of a motion, no more than can be commanded; turning counts as driving at the same share of its top."""
        top = self._velocity
        return min(excess(rates, top), 1.0) * max(top[0], top[1])

    def _move(
        self,
        deltas: Sequence[float | None],
        angles: Sequence[float | None],
        readings: Readings,
        *,
        estimate: Estimate | None,
        slip: Slip,
        dt: float,
    ) -> None:
        """The pose by the way of this cycle, with the turn of a gyro where there is one to be believed."""
        residual, beside = None if estimate is None else estimate.residual, 0.0
        if self._more and estimate is not None and any(deltas):
            for rate in estimate.more:
                beside += abs(rate) * dt
        angle, fresh, anew = readings.heading or (None, True, False)
        if anew:
            self._odometry.forget_heading()
        self._odometry.update(
            deltas,
            angles,
            residual=residual,
            dt=dt,
            heading=angle,
            fresh=fresh,
            spread=slip.spread,
            beside=beside,
        )

    def _believed(
        self, speeds: Numbers, deltas: list[float | None], angles: Numbers
    ) -> tuple[Numbers, list[float | None]]:
        """Without those of wheels that are known to tell something wrong, as long as the others suffice."""
        if all(self._believable):
            return speeds, deltas
        others = [speed if ok else None for speed, ok in zip(speeds, self._believable)]
        if self._kinematics.twist(others, angles) is None:
            return speeds, deltas
        return others, [delta if ok else None for delta, ok in zip(deltas, self._believable)]

    def _without(
        self,
        slip: Slip,
        estimate: Estimate | None,
        speeds: Numbers,
        deltas: list[float | None],
        angles: Numbers,
    ) -> tuple[Estimate | None, list[float | None]]:
        """The motion and the ways without wheels that are known to slip, as long as the others suffice.

        What the wheels do not explain stays what all of them do not: that is how the end of the slip is seen.
        """
        others = [None if place in slip.wheels else speed for place, speed in enumerate(speeds)]
        found = self._kinematics.twist(others, angles)
        if found is None or estimate is None:
            return estimate, deltas
        kept = found._replace(residual=estimate.residual, residuals=estimate.residuals)
        return kept, [None if place in slip.wheels else delta for place, delta in enumerate(deltas)]

    def _expected_speed(self, index: int) -> float | None:
        """Speed of one wheel as the other wheels have it, rad/s."""
        measured = self._measured
        others = [None if place == index else speed for place, speed in enumerate(measured.speeds)]
        estimate = self._kinematics.twist(others, measured.angles)
        if estimate is None:
            return None
        speeds = self._kinematics.wheel_speeds(estimate.rates, measured.angles)
        return None if speeds is None else speeds[index]

    # judge and decide

    def _judge(self, measured: Measured) -> Health:
        motors = self._motors
        return self._health.assess(
            motors.feedback,
            motors.samples(measured, driving=self._mode in DRIVING, expected=self._expected_speeds),
            others=self._other_faults(measured),
            out_of_reach=motors.on_buses(tuple(self._buses_down)) if self._buses_down else (),
            energised=self._energised,
            redundant=measured.estimate is not None and measured.estimate.residual is not None,
            powerless=self._powerless(measured) if self._torque_loss is not None else None,
            now_ns=measured.now_ns,
        )

    def _powerless(self, measured: Measured) -> tuple[int, str] | None:
        """The motor whose torque does not arrive; wheels that slip do not tell how the body moves."""
        detector = self._torque_loss
        if detector is None:
            return None
        judged = self._mode in DRIVING and not measured.slipping and measured.estimate is not None
        twist = measured.estimate.twist if judged and measured.estimate is not None else None
        return detector.look(twist, self._motors.torques_now(measured), measured.dt)

    def _adrift(self, measured: Measured) -> tuple[Event, ...]:
        """Whether limping has to end: whoever commands has to send zero again, and the robot brakes until then."""
        limps = self._mode is _DEGRADED and self._ability is not None and not self._kinematics.steered
        reach = self._ability.reach if limps and self._ability is not None else None
        text = self._limp_watch.look(reach, None if measured.estimate is None else measured.estimate.rates)
        if text is None:
            return ()
        self._arbiter.dismiss(measured.now_ns)
        return (Event(Level.WARNING, "limp_ended", text),)

    def _other_faults(self, measured: Measured) -> list[Fault]:
        """Buses that are down, a fall, and joints that are heard but stand at an angle nobody knows."""
        if not (self._buses_down or self._trust.unknown or self._posture):
            return []
        faults = [Fault(FaultKind.BUS, bus, text, latched=False) for bus, text in self._buses_down.items()]
        if self._posture is not None and self._posture.fallen is not None:
            faults.append(Fault(FaultKind.FALLEN, self._robot_name, self._posture.fallen, latched=False))
        for index, why in self._trust.unknown.items():
            if measured.positions[index] is not None:
                text = f"{UNKNOWN} ({why}): drivegate reference {self._robot_name}"
                faults.append(Fault(FaultKind.POSITION_UNKNOWN, self._names[index], text, latched=False))
        return faults

    def _answer(self, inputs: Inputs) -> tuple[tuple[Reply, ...], bool]:
        """Replies to this cycle's requests, and whether a reset was granted."""
        if not inputs.requests:
            return (), False
        kinds = {request.kind for request in inputs.requests}
        self._shutdown = self._shutdown or RequestKind.SHUTDOWN in kinds
        replies: list[Reply] = []
        granted = False
        for request in inputs.requests:
            if request.kind is RequestKind.REFERENCE:
                refusal = self._reference(request)
            elif request.kind is RequestKind.RESET:
                refusal = self._refusal_of_reset(inputs.now_ns, estop=RequestKind.ESTOP in kinds)
                granted = refusal is None
            elif request.kind is RequestKind.SET:
                refusal = self._settings.set(request.setting, request.value)
            elif request.kind in POSTURES:
                refusal = self._pose_as_asked(request.kind)
            elif request.kind is RequestKind.MARK:
                refusal = None
            else:
                continue
            replies.append(Reply(request.id, refusal is None, refusal))
        if granted:
            self._health.reset()
            self._motors.clear_faults()
        return tuple(replies), granted

    def _pose_as_asked(self, kind: RequestKind) -> str | None:
        """Get ready to stand up, or give way to who holds it; why not, if not."""
        posture = self._posture
        if posture is None:
            return "this robot stands by itself"
        if kind is RequestKind.STAND_UP:
            return posture.stand_up() if self._mode is _IDLE else f"it stands up from idle: it is in {self._mode.value}"
        if self._mode in DRIVING or self._mode is _STARTING:
            return f"the robot is in mode {self._mode.value}; it is let down while nobody drives it"
        return posture.let_down() if self._standstill.standing is not False else "the robot still moves"

    def _refusal_of_reset(self, now_ns: int, *, estop: bool) -> str | None:
        if estop:
            return "an emergency stop arrived at the same moment"
        if self._mode in HOLDING:
            return f"nothing to reset in mode {self._mode.value}"
        command = self._arbiter.moving(now_ns)
        if command is not None:
            return f"{command.source} commands motion; commands must be zero"
        for index, why in self._trust.unknown.items():
            return f"{self._names[index]}: {UNKNOWN} ({why}): reference it first"
        if self._energised and not self._law.may_release(self._measured):
            return "a reset would release the motors, and the robot would fall: support it first"
        return self._refusal_while_moving()

    def _refusal_while_moving(self) -> str | None:
        if self._standstill.standing is None:
            return "too few motors report their speed, so the robot is not known to stand"
        return None if self._standstill.standing else "the robot still moves"

    def _reference(self, request: Request) -> str | None:
        """Take the angle of a steered joint; why not, if not."""
        steered = {self._names[index]: index for index in self._kinematics.steered}
        name = request.motor if request.motor is not None else next(iter(steered), "no joint")
        if name not in steered or (request.motor is None and len(steered) > 1):
            return f"motor = {name!r}: must be one of the steered joints: {', '.join(steered) or 'there are none'}"
        if self._mode in HOLDING:
            return f"the robot is in mode {self._mode.value}; a joint is referenced at rest"
        position = self._measured.positions[steered[name]]
        if position is None:
            return f"{name} does not report its position"
        refusal = self._refusal_while_moving()
        if refusal is None:
            self._trust.reference(steered[name], request.angle or 0.0, position)
            self._odometry.forget(steered[name])
        return refusal

    def _decide(self, inputs: Inputs, health: Health, selection: Selection, *, granted: bool) -> None:
        now_ns = inputs.now_ns
        whole = all(health.usable)
        well = whole and not health.faults
        unarmed = self._motors.not_operational(health.usable)
        overdue = self._mode is _STARTING and now_ns - self._mode_since_ns > ARMING_TIMEOUT_NS
        mode = next_mode(
            self._mode,
            Situation(
                estop=bool(inputs.requests) and any(one.kind is RequestKind.ESTOP for one in inputs.requests),
                reset=granted,
                shutdown=self._shutdown,
                blocked=not well and (self._ability is None or self._fallen),
                latched=not well and any(fault.latched for fault in health.faults),
                faulty=bool(health.faults),
                reduced=not whole,
                commanded=selection.command is not None and self._may_drive,
                start=self._mode is _IDLE
                and selection.command is not None
                and selection.command.still
                and (well or self._had_time_to_answer(now_ns))
                and self._law.unready is None,
                armed=not unarmed,
                overdue=overdue,
                rested=self._rested(now_ns),
            ),
        )
        if mode is self._mode:
            if mode is _IDLE:
                self._arbiter.dismiss_moving()
            return
        if mode is _FAULT and overdue:
            self._latch_unarmed(unarmed)
        self._enter(mode, now_ns)

    @property
    def _fallen(self) -> bool:
        return self._posture is not None and self._posture.fallen is not None

    @property
    def _may_drive(self) -> bool:
        """Not a robot that is being let down, or is down; what is in IDLE may be about to stand up."""
        return self._posture is None or self._mode is _IDLE or self._posture.stance is Stance.UP

    def _had_time_to_answer(self, now_ns: int) -> bool:
        """Whether a motor that is silent now is not just one that comes later than the others."""
        return self._answered_ns is not None and now_ns - self._answered_ns >= ANSWER_TIME_NS

    def _rested(self, now_ns: int) -> bool:
        if self._energised:
            return self._standstill.rested(now_ns) and self._law.may_release(self._measured)
        return self._standstill.standing is not False  # released, but perhaps too early: not all wheels were heard

    def _latch_unarmed(self, unarmed: Sequence[int]) -> None:
        for index in unarmed:
            state = self._motors.feedback[index].state.value
            text = f"still {state} {ARMING_TIMEOUT_NS * 1e-9:g} s after arming began"
            self._health.latch(Fault(FaultKind.ARMING, self._names[index], text, latched=True))

    def _enter(self, mode: Mode, now_ns: int) -> None:
        self._mode = mode
        self._mode_since_ns = now_ns
        self._rolled = False
        self._unheard = self._unheard and mode in BRAKING
        if mode in DISMISSING:
            self._arbiter.dismiss(now_ns)
        if mode is _IDLE:
            self._energised = False
            if self._posture is not None:
                self._posture.rest()
            self._law.forget_told()  # at a robot that stands it may not have come to zero: a wall stops faster
            self._health.forgive()
        elif mode is _ESTOP and self._stop_category == RELEASED and self._posture is not None:
            self._posture.rest()
            self._let_go()
        elif mode is _STARTING:
            self._energised = True
            if self._posture is not None:
                self._posture.rise()

    # limit

    def _target(self, selection: Selection) -> Twist:
        """What the winner asks for, in the body frame; zero in every mode that does not drive."""
        command = selection.command
        if self._mode not in DRIVING or command is None:
            return ZERO_TWIST
        if command.frame is _BODY:
            return command.twist
        vx, vy, wz = command.twist
        s, c = sin_cos(self._odometry.pose.theta)
        return Twist(c * vx + s * vy, c * vy - s * vx, wz)

    def _target_of_more(self, selection: Selection) -> Rates:
        """The same of the axes beyond the twist."""
        command = selection.command
        if self._mode not in DRIVING or command is None:
            return (0.0,) * len(self._more)
        if command.width is not None:
            command = command._replace(width_rate=self._law.width_rate(command.width))
        return more_of(command, self._more)

    def _reached(self, target: Rates) -> Rates:
        """What of it the motors left can drive."""
        return target if self._ability is None else self._ability.target(target, self._velocity)

    def _limit(self, target: Rates, measured: Measured, health: Health, asked: TwistCommand | None) -> Motion:
        """The setpoint within every limit, and what the joints are told for it; the limits at work by name."""
        limits: tuple[str, ...] = ("slip",) if measured.slipping else ()
        if self._mode is _DEGRADED and self._ability is not None and self._ability.reach is not None:
            limits = (*limits, "limp")
        braking = self._mode in BRAKING
        path_rate, region = (None, _ANY) if asked is None else (asked.path_rate, asked.region)
        if self._mode in DRIVING:
            target, overridden = self._overridden(target)
            headroom = self._motors.headroom(measured)
            effort = self._ability.effort if self._ability is not None else 1.0
            aim = self._reached(target)
            if self._selects:
                whole = self._mode is not _DEGRADED
                aim = self._law.aim(aim, measured, region=region, path_rate=_path_rate(asked), whole=whole)
            ground = self._law.ground(whole=all(health.usable)) if self._grips else None
            ease = self._settings.ease
            _, active = self._limiter.step(aim, measured.dt, effort=effort, headroom=headroom, ground=ground, ease=ease)
            limits = (*limits, *overridden, *active, "torque") if headroom < 1.0 else (*limits, *overridden, *active)
        elif braking:
            self._brake(measured, health)
            if self._grips:
                self._law.ground(whole=all(health.obeying))
        else:
            self._limiter.reset()
        if self._mode is _ESTOP:
            return self._law.stop(measured).limited_by(limits)
        motion = self._law.motion(self._limiter.rates, measured, braking=braking, path_rate=path_rate)
        self._turned = motion.turned
        if motion.share < 1.0:
            self._limiter.scale(motion.share)
        return motion.limited_by(limits)

    def _overridden(self, target: Rates) -> tuple[Rates, tuple[str, ...]]:
        """The target within the speeds that settings leave to commands; the setpoint goes there within the limits."""
        settings = self._settings
        active: tuple[str, ...] = ()
        share = settings.value(SPEED_OVERRIDE)
        allowed = target if share >= 1.0 else scale_to(target, tuple([share * axis for axis in self._velocity]))
        if allowed is not target:
            active = (*active, SPEED_OVERRIDE.name)
        most, vx, vy = settings.held(LINEAR_SPEED), allowed[0], allowed[1]
        if most is not None and vx * vx + vy * vy > most * most:
            allowed = scaled(allowed, most / sqrt(vx * vx + vy * vy))
            active = (*active, LINEAR_SPEED.name)
        most = settings.held(ANGULAR_SPEED)
        if most is not None and abs(allowed[2]) > most:
            allowed = scaled(allowed, most / abs(allowed[2]))
            active = (*active, ANGULAR_SPEED.name)
        return allowed, active

    def _brake(self, measured: Measured, health: Health) -> None:
        """The setpoint on its way to rest. While no motor follows it waits: they may still do what they were told."""
        if self._followed(health):
            self._take_up(measured, health)
            effort = self._abilities.braking(health, measured, self._limiter.rates)
            self._limiter.brake(measured.dt, effort=effort)
        else:
            self._unheard = True
        if measured.estimate is not None:
            self._fall_back(_turned_back(measured.estimate.rates, self._turned), measured.dt)

    def _take_up(self, measured: Measured, health: Health) -> None:
        """Motors that follow again go on from how they turn now: what they were told before they may have lost."""
        share = self._motors.share_driven(measured, health.obeying) if self._unheard else None
        if share is not None:
            self._limiter.scale(share)
            self._law.forget_told()
            self._unheard = False

    def _followed(self, health: Health) -> bool:
        """Whether any motor obeys, as far as can be seen."""
        for obeying, feedback in zip(health.obeying, self._motors.feedback):
            if obeying and feedback.state is _OPERATIONAL:
                return True
        return False

    def _fall_back(self, measured: Rates, dt: float) -> None:
        """Take the setpoint back to what is measured along its direction, where the robot is much slower than that."""
        setpoint, top = self._limiter.rates, self._velocity
        size = excess(setpoint, top)
        if size <= SLACK:  # nothing to take back; and the square of less than 1e-162 would be zero, to divide by
            return
        scaled = [s / limit for s, limit in zip(setpoint, top, strict=True)]
        along = dot(scaled, [m / limit for m, limit in zip(measured, top, strict=True)]) / dot(scaled, scaled)
        bound = max(along, 0.0) * size + SLACK
        if bound < size:
            self._limiter.scale(max(bound, size - RETREAT * dt, 0.0) / size)

    # command

    def _command(self, motion: Motion, measured: Measured, health: Health) -> tuple[CanFrame, ...]:
        now_ns = measured.now_ns
        followed = self._followed(health)
        self._standstill.command(braking=self._limiter.at_rest or not followed, now_ns=now_ns)
        self._hold_or_release(now_ns)
        may = self._may_be_commanded(health) if self._energised else self._none
        commands = motion.commands
        if self._slip is not None and (self._slip.now.ahead or self._correction.active):
            ahead = self._slip.now.ahead if measured.slipping else ()
            wheels = self._slip.now.wheels if measured.slipping else ()
            braking = self._mode in BRAKING
            correct = self._correction.corrected
            commands = correct(commands, ahead, wheels, measured.speeds, braking=braking, dt=measured.dt)
        return self._motors.command(commands if all(may) else self._released(commands, may), measured)

    def _released(self, commands: Sequence[JointCommand], may: Sequence[bool]) -> list[JointCommand]:
        """The commands without those of motors that may not be commanded; of an energised robot these are lost."""
        driven = self._mode is _FAULT or (self._mode is _ESTOP and self._posture is not None)
        if self._mode in HOLDING or (driven and self._energised):
            self._health.lose([index for index, ok in enumerate(may) if not ok])
        return [command if ok else COAST for command, ok in zip(commands, may)]

    def _may_be_commanded(self, health: Health) -> Sequence[bool]:
        if self._mode is _ESTOP and self._posture is None:  # what stays upright in it drives its motors, and not all
            # A fault that is not latched goes once the motor is asked to coast; then it can brake again.
            return [
                brakable and (feedback.fault is None or feedback.fault.latched)
                for brakable, feedback in zip(health.brakable, self._motors.feedback, strict=True)
            ]
        return health.obeying if self._mode in BRAKING or self._mode is _ESTOP else health.usable

    def _hold_or_release(self, now_ns: int) -> None:
        """At rest the motors are released, unless stop category, slope or chassis ask for more; rolling is braked."""
        if self._mode in HOLDING:
            return
        if self._mode is _ESTOP and not self._energised and self._posture is None and self._standstill.rolls(now_ns):
            self._energised = self._rolled = True
        held = self._mode is _ESTOP and (self._stop_category == HELD or self._rolled) and not self._shutdown
        if self._energised and not held and self._rested(now_ns):
            self._let_go()

    def _trace_of_more(self, more: Rates, measured: Measured) -> tuple[AxisTrace, ...]:
        size = len(PLANAR)
        known: Sequence[float | None] = measured.estimate.more if measured.estimate else (None,) * len(more)
        return tuple(map(AxisTrace, more, self._limiter.rates[size:], known))

    def _status(
        self,
        inputs: Inputs,
        health: Health,
        selection: Selection,
        *,
        reason: str | None,
        motion: Motion,
        measured: Measured,
    ) -> Status:
        return Status(
            mode=self._mode,
            reason=reason,
            faults=tuple(map(str, health.faults)),
            winner=selection.command.source if selection.command else None,
            winner_age_s=_seconds(selection.age_ns),
            sources=self._arbiter.describe(selection, inputs.now_ns),
            motors=self._motors.status(measured),
            limits_active=motion.limits,
            stop_category=self._stop_category,
            standing=self._standstill.standing,
            pose=self._odometry.pose,
            twist=measured.estimate.twist if measured.estimate else None,
            refused=self._reporter.refused,
            tx_dropped=self._reporter.tx_dropped,
            overruns=inputs.overruns,
            dropped_records=inputs.dropped_records,
            cycle=inputs.cycle,
            ability=self._abilities.describe(self._ability, health.usable),
            chassis=self._law.facts,
            sensors=self._sensors.describe(inputs.now_ns),
            settings=self._settings.describe(),
            slip=None if self._slip is None else self._slip.describe(measured),
        )


def _torque_loss_detector(robot: Robot, config: RobotConfig) -> TorqueLossDetector | None:
    """None: its geometry depends on joint angles, or on more than a twist."""
    kinematics = robot.kinematics
    if kinematics.steered or kinematics.axes != PLANAR:
        return None
    body = config.robot.body
    mechanics = Mechanics(
        kinematics.matrix(),
        config.robot.inertia([0.0] * len(robot.names)),
        rotor=body.joint_inertia,
        friction=body.joint_friction,
        drag=body.joint_drag,
    )
    return TorqueLossDetector(mechanics, [limits.torque for limits in robot.limits])


def _appeared(before: Sequence[MotorFeedback], now: Sequence[MotorFeedback]) -> bool:
    """Whether a motor that was silent is heard."""
    return any([a.state is _SILENT and b.state is not _SILENT for a, b in zip(before, now)])


def _turned_back(rates: Rates, turned: float) -> Rates:
    """A measured motion as if the law had not turned the setpoint into it."""
    if turned == 0.0:
        return rates
    s, c = sin_cos(turned)
    return (c * rates[0] + s * rates[1], c * rates[1] - s * rates[0], *rates[2:])


def _path_rate(asked: TwistCommand | None) -> float | None:
    """As it is told; a velocity over the ground leads straight on, whatever the platform turns by."""
    if asked is None:
        return None
    return 0.0 if asked.path_rate is None and asked.frame is _ODOM else asked.path_rate


def _seconds(nanoseconds: int | None) -> float | None:
    return None if nanoseconds is None else nanoseconds * 1e-9
