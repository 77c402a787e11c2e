"""The core: one pure step from everything known to everything said.

How this works
--------------
receive -> measure -> judge -> select -> decide -> limit -> kinematics -> motor commands -> frames. Each stage is a
part of its own with its own state; the engine only passes values along. Time is an argument, nothing blocks, and the
same inputs give the same outputs: the live service, the simulation and the replay run this very code.

Authority over the motors only ever shrinks between two rests: the setpoint of the body grows in DRIVE and DEGRADED and
nowhere else, and a motor that was lost, released or found faulty is not driven again before IDLE. An emergency stop
alone may step, and may brake a motor that was lost before.
The stages of later work have their place here: compensation and launch between `limit` and `wheel speeds`, traction
after `measure`, degraded driving inside the kinematics (fewer rows) and the limits (less effort).
"""

from collections.abc import Sequence
from math import cos, sin

from drivers.contract import CanFrame, MotorState
from gateway.config import RobotConfig
from gateway.control.limits import TwistLimiter, excess
from gateway.core import snapshot as snapshots
from gateway.core.arbiter import Arbiter, Selection
from gateway.core.assembly import build
from gateway.core.detectors import SlipDetector
from gateway.core.health import Fault, FaultKind, Health, HealthMonitor
from gateway.core.joint_trust import JointTrust
from gateway.core.motors import Motors
from gateway.core.odometry import WheelOdometry
from gateway.core.reporter import Reporter, waiting_for
from gateway.core.standstill import Standstill
from gateway.core.supervisor import Situation, next_mode
from gateway.kinematics.contract import Estimate, desaturate
from gateway.types import (
    ZERO_TWIST,
    BusEventKind,
    Inputs,
    Mode,
    Outputs,
    Reply,
    Request,
    RequestKind,
    Status,
    Trace,
    Twist,
    TwistFrame,
)

DRIVING = frozenset({Mode.DRIVE, Mode.DEGRADED})
HOLDING = frozenset({Mode.STARTING, Mode.DRIVE, Mode.DEGRADED, Mode.STOPPING})
ARMING_TIMEOUT_NS = 3_000_000_000
ANSWER_TIME_NS = 3_000_000_000  # after start-up; only then is a motor that never answered one to drive without
DEGRADED_EFFORT = 0.5  # one motor of four lost: half the acceleration (Rojas section 11, corrected: E-001-14)
BRAKING = frozenset({Mode.STOPPING, Mode.FAULT})
DISMISSING = frozenset({Mode.IDLE, Mode.ESTOP, Mode.FAULT})  # on entering them every source needs a new zero
MAX_STEP_PERIODS = 5  # a longer pause of the loop is no time in which the setpoint may have moved on
HELD = 2  # the stop category that goes on holding at rest (IEC 60204-1)
SLACK = 0.1  # of top speed by which a braking setpoint may be ahead of the measured motion
RETREAT = 5.0  # top speeds per second at which it is taken back beyond that: no step, whatever was measured


class Engine:
    """From `Inputs` to `Outputs`, once per cycle; one writer, one thread.

    `state`: a snapshot to go on from. Raises ConfigError, SnapshotError at construction.
    """

    def __init__(self, config: RobotConfig, state: snapshots.State | None = None) -> None:
        robot = build(config)
        self._robot_name = config.robot.name
        self._names = robot.names
        self._top_speeds = tuple(limits.speed for limits in robot.limits)
        self._kinematics = robot.kinematics
        self._motors = Motors(robot)
        self._arbiter = Arbiter(config.commands.source)
        self._velocity = config.limits.velocity.as_twist()
        self._limiter = TwistLimiter(
            velocity=self._velocity,
            acceleration=config.limits.acceleration.as_twist(),
            jerk=config.limits.jerk.as_twist(),
        )
        self._health = HealthMonitor(robot.names, limits=robot.limits)
        self._odometry = WheelOdometry(robot.kinematics, top_speeds=self._top_speeds)
        self._trust = JointTrust(robot.kinematics.steered, absolute=robot.absolute, top_speeds=self._top_speeds)
        self._slip = SlipDetector()
        self._standstill = Standstill()
        self._reporter = Reporter(config)
        self._period = 1.0 / config.loop.rate
        self._stop_category = config.stop.category
        self._last_ns: int | None = None
        self._first_ns: int | None = None
        self._mode = Mode.IDLE
        self._mode_since_ns = 0
        self._energised = False  # motors were armed and have not been released since
        self._rolled = False  # it rolled after an emergency stop had released it
        self._blind = False  # braking without the joint angle, in proportion
        self._shutdown = False
        self._buses_down: dict[str, str] = {}
        self._angles: list[float | None] = [None] * len(self._names)  # rad; None: silent or not trusted
        self._ramp: tuple[float, list[float]] = (0.0, [0.0] * len(self._names))  # last setpoint known in wheel speeds
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
        self._receive(inputs)
        estimate = self._measure(now_ns, dt)
        health = self._judge(now_ns, dt)
        selection = self._arbiter.select(now_ns)
        replies, granted = self._answer(inputs)
        self._decide(inputs, health, selection, granted=granted)
        target = self._target(selection)
        speeds, limits = self._limit(target, estimate, health, dt)
        frames = self._command(speeds, health, dt=dt, now_ns=now_ns)
        measured, residual = estimate if estimate else (None, None)
        command = self._arbiter.moving(now_ns) if self._mode is Mode.IDLE else selection.command
        reason = waiting_for(self._mode, faults=health.faults, command=command, shutdown=self._shutdown)
        events = self._reporter.events(
            inputs,
            mode=self._mode,
            reason=reason,
            faults=health.faults,
            replies=replies,
            slipping=self._slip.slipping,
        )
        status = None
        if self._reporter.status_due(now_ns) or events:
            status = self._status(inputs, health, selection, reason=reason, limits=limits, measured=measured)
        return Outputs(
            frames,
            self._mode,
            events,
            replies,
            self._odometry.read(measured, residual) if self._reporter.odometry_due(now_ns) else None,
            status,
            Trace(
                target,
                self._limiter.setpoint,
                measured,
                self._odometry.pose,
                tuple(self._motors.setpoints),
                tuple(self._motors.speeds),
                tuple(self._motors.positions),
                _seconds(selection.age_ns),
                residual,
            ),
            self._shutdown and not self._energised and self._mode not in HOLDING,
        )

    def coast_frames(self) -> list[CanFrame]:
        """Frames that release every motor; valid in any state."""
        return self._motors.coast_frames()

    def stop_frames(self, *, now_ns: int) -> list[CanFrame]:
        """Frames that stop every motor when this core can no longer be trusted; sent until it is at rest."""
        return self._motors.stop_frames(now_ns=now_ns)

    def at_rest(self, frames: Sequence[CanFrame], *, now_ns: int) -> bool:
        """Takes frames in, and nothing else: whether every motor reports that it stands. Beside `stop_frames`."""
        self._motors.receive(frames)
        self._motors.measure(now_ns)
        return None not in self._motors.speeds and not self._motors.turning()

    # receive and measure

    def _elapsed(self, now_ns: int) -> float:
        last_ns, self._last_ns = self._last_ns, now_ns
        if last_ns is None:
            self._first_ns = now_ns
            return self._period
        elapsed, longest = max(now_ns - last_ns, 0) * 1e-9, MAX_STEP_PERIODS * self._period
        if elapsed > longest:
            self._health.look_anew()
        return min(elapsed, longest)

    def _receive(self, inputs: Inputs) -> None:
        self._motors.receive(inputs.frames)
        for command in inputs.commands:
            self._arbiter.receive(command)
        for event in inputs.bus_events:
            if event.kind is BusEventKind.DOWN:
                self._buses_down[event.bus] = event.text
            elif event.kind is BusEventKind.UP:
                self._buses_down.pop(event.bus, None)

    def _measure(self, now_ns: int, dt: float) -> Estimate | None:
        motors = self._motors
        motors.measure(now_ns)
        angles = self._trust.angles(motors.positions)
        deltas, jumped = self._odometry.deltas(angles, now_ns)
        self._trust.watch(angles, jumped, now_ns)
        self._angles = self._trust.trusted(angles)
        estimate = self._kinematics.twist(motors.speeds, self._angles)
        residual = estimate.residual if estimate else None
        measurable = estimate is not None or None not in motors.speeds
        self._standstill.measure(turning=motors.turning(), measurable=measurable, now_ns=now_ns)
        self._odometry.update(deltas, self._angles, residual=residual, dt=dt)
        self._slip.look(residual, dt)
        return estimate

    def _expected_speed(self, index: int) -> float | None:
        """Speed of one wheel as the other wheels have it, rad/s."""
        others = [None if place == index else speed for place, speed in enumerate(self._motors.speeds)]
        estimate = self._kinematics.twist(others, self._angles)
        if estimate is None:
            return None
        speeds = self._kinematics.wheel_speeds(estimate.twist, self._angles)
        return None if speeds is None else speeds[index]

    # judge and decide

    def _judge(self, now_ns: int, dt: float) -> Health:
        motors = self._motors
        return self._health.assess(
            motors.feedback,
            motors.samples(driving=self._mode in DRIVING, dt=dt, expected=self._expected_speed),
            others=self._other_faults(),
            out_of_reach=motors.on_buses(tuple(self._buses_down)) if self._buses_down else (),
            energised=self._energised,
            now_ns=now_ns,
        )

    def _other_faults(self) -> list[Fault]:
        """Buses that are down, and joints that are heard but stand at an angle nobody knows."""
        faults = [Fault(FaultKind.BUS, bus, text, latched=False) for bus, text in self._buses_down.items()]
        for index, why in self._trust.unknown.items():
            if self._motors.positions[index] is not None:
                text = f"joint angle unknown ({why}): drivegate reference {self._robot_name}"
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
            else:
                continue
            replies.append(Reply(request.id, refusal is None, refusal))
        if granted:
            self._health.reset()
            self._motors.clear_faults()
        return tuple(replies), granted

    def _refusal_of_reset(self, now_ns: int, *, estop: bool) -> str | None:
        if estop:
            return "an emergency stop arrived at the same moment"
        if self._mode in HOLDING:
            return f"nothing to reset in mode {self._mode.value}"
        command = self._arbiter.moving(now_ns)
        if command is not None:
            return f"{command.source} commands motion; commands must be zero"
        for index, why in self._trust.unknown.items():
            return f"{self._names[index]}: joint angle unknown ({why}): reference it first"
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
        position = self._motors.positions[steered[name]]
        if position is None:
            return f"{name} does not report its position"
        refusal = self._refusal_while_moving()
        if refusal is None:
            self._trust.reference(steered[name], request.angle or 0.0, position)
            self._odometry.forget(steered[name])
        return refusal

    def _decide(self, inputs: Inputs, health: Health, selection: Selection, *, granted: bool) -> None:
        now_ns = inputs.now_ns
        well = not health.faults and all(health.usable)
        blocked = not well and not self._kinematics.drivable(health.usable)
        unarmed = self._motors.not_operational(health.usable)
        overdue = self._mode is Mode.STARTING and now_ns - self._mode_since_ns > ARMING_TIMEOUT_NS
        mode = next_mode(
            self._mode,
            Situation(
                estop=bool(inputs.requests) and any(one.kind is RequestKind.ESTOP for one in inputs.requests),
                reset=granted,
                shutdown=self._shutdown,
                blocked=blocked,
                latched=not well and any(fault.latched for fault in health.faults),
                faulty=bool(health.faults),
                reduced=not well and not blocked and not all(health.usable),
                commanded=selection.command is not None,
                start=self._mode is Mode.IDLE
                and selection.command is not None
                and selection.command.twist == ZERO_TWIST
                and (well or self._had_time_to_answer(now_ns)),
                armed=not unarmed,
                overdue=overdue,
                rested=self._rested(now_ns),
            ),
        )
        if mode is self._mode:
            return
        if mode is Mode.FAULT and overdue:
            self._latch_unarmed(unarmed)
        self._enter(mode, now_ns)

    def _had_time_to_answer(self, now_ns: int) -> bool:
        return self._first_ns is not None and now_ns - self._first_ns >= ANSWER_TIME_NS

    def _rested(self, now_ns: int) -> bool:
        return not self._energised or self._standstill.rested(now_ns)

    def _latch_unarmed(self, unarmed: Sequence[int]) -> None:
        for index in unarmed:
            state = self._motors.feedback[index].state.value
            text = f"still {state} {ARMING_TIMEOUT_NS * 1e-9:g} s after arming began"
            self._health.latch(Fault(FaultKind.ARMING, self._names[index], text, latched=True))

    def _enter(self, mode: Mode, now_ns: int) -> None:
        self._mode = mode
        self._mode_since_ns = now_ns
        self._rolled = False
        self._blind = self._blind and mode in BRAKING
        if mode in DISMISSING:
            self._arbiter.dismiss(now_ns)
        if mode is Mode.IDLE:
            self._energised = False
            self._health.forgive()
        elif mode is Mode.STARTING:
            self._energised = True

    # limit

    def _target(self, selection: Selection) -> Twist:
        """What the winner asks for, in the body frame; zero in every mode that does not drive."""
        command = selection.command
        if self._mode not in DRIVING or command is None:
            return ZERO_TWIST
        if command.frame is TwistFrame.BODY:
            return command.twist
        vx, vy, wz = command.twist
        c, s = cos(self._odometry.pose.theta), sin(self._odometry.pose.theta)
        return Twist(c * vx + s * vy, c * vy - s * vx, wz)

    def _limit(
        self, target: Twist, estimate: Estimate | None, health: Health, dt: float
    ) -> tuple[list[float], tuple[str, ...]]:
        """Wheel speeds of a setpoint within every limit, and the names of the limits at work."""
        limits: tuple[str, ...] = ("slip",) if self._slip.slipping else ()
        if self._mode in DRIVING:
            headroom = self._motors.headroom()
            effort = DEGRADED_EFFORT if self._mode is Mode.DEGRADED else 1.0
            _, active = self._limiter.step(target, dt, effort=effort, headroom=headroom)
            limits = (*limits, *active, "torque") if headroom < 1.0 else (*limits, *active)
        elif self._mode in BRAKING:
            self._brake(estimate, health, dt)
        else:
            self._limiter.reset()
        speeds = None
        if not self._blind:
            speeds = self._kinematics.wheel_speeds(self._limiter.setpoint, self._angles_ahead())
        if speeds is None:
            self._blind = self._mode in BRAKING  # an angle that comes back would be a step
            return self._in_proportion(), limits
        factor = desaturate(speeds, self._top_speeds)
        if factor < 1.0:
            self._limiter.scale(factor)
            speeds, limits = [speed * factor for speed in speeds], (*limits, "motor_speed")
        self._ramp = excess(self._limiter.setpoint, self._velocity), speeds
        return speeds, limits

    def _angles_ahead(self) -> Sequence[float | None]:
        """Angles of the steered joints as they will be when the motors turn as commanded: a period from now."""
        if not self._kinematics.steered:
            return self._angles
        angles = list(self._angles)
        for index in self._kinematics.steered:
            angle, speed, age_ns = angles[index], self._motors.speeds[index], self._motors.feedback[index].age_ns
            if angle is not None and speed is not None and age_ns is not None:
                angles[index] = angle + speed * (age_ns * 1e-9 + self._period)
        return angles

    def _brake(self, estimate: Estimate | None, health: Health, dt: float) -> None:
        """The setpoint on its way to rest. While no motor follows it waits: they may still do what they were told."""
        if self._followed(health):
            self._limiter.brake(dt)
        if estimate is not None:
            self._fall_back(estimate.twist, dt)

    def _followed(self, health: Health) -> bool:
        """Whether any motor obeys, as far as can be seen."""
        return any(
            obeying and feedback.state is MotorState.OPERATIONAL
            for obeying, feedback in zip(health.obeying, self._motors.feedback, strict=True)
        )

    def _fall_back(self, measured: Twist, dt: float) -> None:
        """Take the setpoint back to what is measured along its direction, where the robot is much slower than that."""
        setpoint, top = self._limiter.setpoint, self._velocity
        size = excess(setpoint, top)
        if size == 0.0:
            return
        square = sum((s / limit) ** 2 for s, limit in zip(setpoint, top, strict=True))
        along = sum(s * m / limit**2 for s, m, limit in zip(setpoint, measured, top, strict=True)) / square
        bound = max(along, 0.0) * size + SLACK
        if bound < size:
            self._limiter.scale(max(bound, size - RETREAT * dt, 0.0) / size)

    def _in_proportion(self) -> list[float]:
        """Without the joint angle: the last wheel speeds known, all in the proportion in which the setpoint fell."""
        size, speeds = self._ramp
        factor = excess(self._limiter.setpoint, self._velocity) / size if size > 0.0 else 0.0
        return [speed * min(factor, 1.0) for speed in speeds]

    # command

    def _command(self, speeds: Sequence[float], health: Health, *, dt: float, now_ns: int) -> tuple[CanFrame, ...]:
        followed = self._followed(health)
        self._standstill.command(braking=self._limiter.at_rest or not followed, now_ns=now_ns)
        self._hold_or_release(now_ns)
        may = self._may_be_commanded(health)
        setpoints = [speed if self._energised and ok else None for speed, ok in zip(speeds, may, strict=True)]
        if self._mode in HOLDING or (self._mode is Mode.FAULT and self._energised):
            self._health.lose([index for index, setpoint in enumerate(setpoints) if setpoint is None])
        return self._motors.command(setpoints, braking=self._mode is Mode.ESTOP, dt=dt, now_ns=now_ns)

    def _may_be_commanded(self, health: Health) -> Sequence[bool]:
        if self._mode is Mode.ESTOP:
            # A fault that is not latched goes once the motor is asked to coast; then it can brake again.
            return [
                brakable and (feedback.fault is None or feedback.fault.latched)
                for brakable, feedback in zip(health.brakable, self._motors.feedback, strict=True)
            ]
        return health.obeying if self._mode in BRAKING else health.usable

    def _hold_or_release(self, now_ns: int) -> None:
        """At rest the motors are released, unless the stop category or a slope asks for more; what rolls is braked."""
        if self._mode in HOLDING:
            return
        if self._mode is Mode.ESTOP and not self._energised and self._standstill.rolls(now_ns):
            self._energised = self._rolled = True
        held = self._mode is Mode.ESTOP and (self._stop_category == HELD or self._rolled) and not self._shutdown
        if self._energised and not held and self._rested(now_ns):
            self._energised = False

    def _status(
        self,
        inputs: Inputs,
        health: Health,
        selection: Selection,
        *,
        reason: str | None,
        limits: tuple[str, ...],
        measured: Twist | None,
    ) -> Status:
        return Status(
            mode=self._mode,
            reason=reason,
            faults=tuple(map(str, health.faults)),
            winner=selection.command.source if selection.command else None,
            winner_age_s=_seconds(selection.age_ns),
            sources=self._arbiter.describe(selection, inputs.now_ns),
            motors=self._motors.status(),
            limits_active=limits,
            stop_category=self._stop_category,
            standing=self._standstill.standing,
            pose=self._odometry.pose,
            twist=measured,
            refused=self._reporter.refused,
            tx_dropped=self._reporter.tx_dropped,
            overruns=inputs.overruns,
            dropped_records=inputs.dropped_records,
            cycle=inputs.cycle,
        )


def _seconds(nanoseconds: int | None) -> float | None:
    return None if nanoseconds is None else nanoseconds * 1e-9
