"""The core: one pure step from everything known to everything said.

How this works
--------------
receive -> measure -> judge -> select -> decide -> limit -> kinematics -> motor commands -> frames. Each stage is a
part of its own with its own state; the engine only passes values along. Time is an argument, nothing blocks, and the
same inputs give the same outputs: the live service, the simulation and the replay run this very code.
The stages of later work have their place here: compensation and launch between `limit` and `wheel speeds`, traction
after `measure`, degraded driving inside the kinematics (fewer rows) and the limits (less effort).
"""

from collections.abc import Sequence
from math import cos, sin

from drivers.interface import CanFrame
from gateway.commands import Arbiter, Selection
from gateway.config import RobotConfig
from gateway.control.limits import TwistLimiter
from gateway.health import Fault, FaultKind, Health, HealthMonitor
from gateway.kinematics.interface import Estimate, desaturate
from gateway.motors import Motors
from gateway.odometry import WheelOdometry
from gateway.reporter import Reporter, waiting_for
from gateway.robot import build
from gateway.standstill import Standstill
from gateway.supervisor import Situation, next_mode
from gateway.types import (
    ZERO_TWIST,
    BusEventKind,
    Inputs,
    Mode,
    Outputs,
    Reply,
    RequestKind,
    Status,
    Trace,
    Twist,
    TwistCommand,
    TwistFrame,
)

DRIVING = frozenset({Mode.DRIVE, Mode.DEGRADED})
HOLDING = frozenset({Mode.STARTING, Mode.DRIVE, Mode.DEGRADED, Mode.STOPPING})
ARMING_TIMEOUT_NS = 3_000_000_000
ANSWER_TIME_NS = 3_000_000_000  # after start-up; only then is a motor that never answered one to drive without
DEGRADED_EFFORT = 0.5  # one motor of four lost: half the acceleration (Rojas section 11, corrected: E-001-14)
MAX_STEP_PERIODS = 5  # a longer pause of the loop is no time in which the setpoint may have moved on


class Engine:
    """From `Inputs` to `Outputs`, once per cycle; one writer, one thread. Raises ConfigError at construction."""

    def __init__(self, config: RobotConfig) -> None:
        robot = build(config)
        self._names = robot.names
        self._top_speeds = robot.top_speeds
        self._kinematics = robot.kinematics
        self._motors = Motors(robot)
        self._arbiter = Arbiter(config.commands.source)
        self._limiter = TwistLimiter(
            velocity=config.limits.velocity.as_twist(),
            acceleration=config.limits.acceleration.as_twist(),
            jerk=config.limits.jerk.as_twist(),
        )
        self._health = HealthMonitor(robot.names, top_speeds=robot.top_speeds)
        self._odometry = WheelOdometry(robot.kinematics, top_speeds=robot.top_speeds)
        self._reporter = Reporter(config)
        self._period = 1.0 / config.loop.rate
        self._last_ns: int | None = None
        self._first_ns: int | None = None
        self._mode = Mode.IDLE
        self._mode_since_ns = 0
        self._standstill = Standstill()
        self._energised = False  # motors were armed and have not been released since
        self._shutdown = False
        self._stop_category = config.stop.category
        self._buses_down: dict[str, str] = {}

    @property
    def mode(self) -> Mode:
        """The operating mode decided by the last step."""
        return self._mode

    def step(self, inputs: Inputs) -> Outputs:
        """One cycle."""
        now_ns = inputs.now_ns
        dt = self._elapsed(now_ns)
        self._receive(inputs)
        estimate, jumped = self._measure(now_ns, dt)
        health = self._judge(jumped, now_ns)
        selection = self._arbiter.select(now_ns)
        replies, granted = self._answer(inputs, selection)
        self._decide(inputs, health, selection, granted=granted)
        target = self._target(selection)
        setpoint, speeds, limits = self._limit(target, dt)
        held = self._hold(now_ns)
        frames = self._motors.command(
            [speed if held and usable else None for speed, usable in zip(speeds, health.usable, strict=True)],
            braking=self._mode is Mode.ESTOP,
            dt=dt,
            now_ns=now_ns,
        )
        measured, residual = estimate if estimate else (None, None)
        reason = waiting_for(self._mode, faults=health.faults, command=selection.command, shutdown=self._shutdown)
        events = self._reporter.events(inputs, mode=self._mode, reason=reason, faults=health.faults, replies=replies)
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
                setpoint,
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

    def stop_frames(self) -> list[CanFrame]:
        """Frames that stop every motor when this core can no longer be trusted."""
        return self._motors.stop_frames()

    # receive and measure

    def _elapsed(self, now_ns: int) -> float:
        last_ns, self._last_ns = self._last_ns, now_ns
        if last_ns is None:
            self._first_ns = now_ns
            return self._period
        return min(max(now_ns - last_ns, 0) * 1e-9, MAX_STEP_PERIODS * self._period)

    def _receive(self, inputs: Inputs) -> None:
        self._motors.receive(inputs.frames)
        for command in inputs.commands:
            self._arbiter.receive(command)
        for event in inputs.bus_events:
            if event.kind is BusEventKind.DOWN:
                self._buses_down[event.bus] = event.text
            elif event.kind is BusEventKind.UP:
                self._buses_down.pop(event.bus, None)

    def _measure(self, now_ns: int, dt: float) -> tuple[Estimate | None, list[int]]:
        motors = self._motors
        motors.measure(now_ns)
        estimate = self._kinematics.twist(motors.speeds, motors.positions)
        residual = estimate.residual if estimate else None
        self._standstill.measure(turning=motors.turning(), measurable=estimate is not None, now_ns=now_ns)
        return estimate, self._odometry.update(motors.positions, residual=residual, dt=dt, now_ns=now_ns)

    # judge and decide

    def _judge(self, jumped: Sequence[int], now_ns: int) -> Health:
        for index in jumped:
            if index in self._kinematics.steered:
                text = "position jumped: reference the joint, then reset"
                self._health.latch(Fault(FaultKind.POSITION_UNKNOWN, self._names[index], text, latched=True))
        motors = self._motors
        health = self._health.assess(
            motors.feedback,
            setpoints=motors.setpoints,
            speeds=motors.speeds,
            driving=self._mode in DRIVING,
            now_ns=now_ns,
        )
        if not self._buses_down:
            return health
        down = tuple(Fault(FaultKind.BUS, bus, text, latched=False) for bus, text in self._buses_down.items())
        lost = motors.on_buses(tuple(self._buses_down))
        return Health(tuple(ok and i not in lost for i, ok in enumerate(health.usable)), health.faults + down)

    def _answer(self, inputs: Inputs, selection: Selection) -> tuple[tuple[Reply, ...], bool]:
        """Replies to this cycle's requests, and whether a reset was granted."""
        if not inputs.requests:
            return (), False
        kinds = {request.kind for request in inputs.requests}
        self._shutdown = self._shutdown or RequestKind.SHUTDOWN in kinds
        resets = [request.id for request in inputs.requests if request.kind is RequestKind.RESET]
        if not resets:
            return (), False
        refusal = self._refusal_of_reset(selection, estop=RequestKind.ESTOP in kinds)
        if refusal is None:
            self._health.reset()
            self._motors.clear_faults()
        return tuple(Reply(request_id, refusal is None, refusal) for request_id in resets), refusal is None

    def _refusal_of_reset(self, selection: Selection, *, estop: bool) -> str | None:
        if estop:
            return "an emergency stop arrived at the same moment"
        if self._mode in HOLDING:
            return f"nothing to reset in mode {self._mode.value}"
        command = selection.command
        if command is not None and command.twist != ZERO_TWIST:
            return f"{command.source} commands motion; commands must be zero"
        if self._standstill.standing is None:
            return "too few motors report their speed, so the robot is not known to stand"
        return None if self._standstill.standing else "the robot still moves"

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
                and (granted or self._fresh_zero(selection.command))
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

    def _fresh_zero(self, command: TwistCommand | None) -> bool:
        return command is not None and command.twist == ZERO_TWIST and command.received_ns > self._mode_since_ns

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
        if mode is Mode.IDLE:
            self._energised = False
            self._health.forgive()
        elif mode is Mode.STARTING:
            self._energised = True

    # limit and hold

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

    def _limit(self, target: Twist, dt: float) -> tuple[Twist, list[float], tuple[str, ...]]:
        """Setpoint within every limit, its wheel speeds, and the names of the limits at work."""
        limiter = self._limiter
        limits: tuple[str, ...] = ()
        if self._mode in DRIVING or self._mode in (Mode.STOPPING, Mode.FAULT):
            effort = DEGRADED_EFFORT if self._mode is Mode.DEGRADED else 1.0
            _, limits = limiter.step(target, dt, effort=effort)
        else:
            limiter.reset()
        speeds = self._kinematics.wheel_speeds(limiter.setpoint, self._motors.positions)
        if speeds is None:  # a joint angle is unknown: that is a fault, and the wheels are braked
            return limiter.setpoint, [0.0] * len(self._names), limits
        factor = desaturate(speeds, self._top_speeds)
        if factor < 1.0:
            limiter.scale(factor)
            speeds, limits = [speed * factor for speed in speeds], (*limits, "motor_speed")
        return limiter.setpoint, speeds, limits

    def _hold(self, now_ns: int) -> bool:
        """Whether the motors are driven (at speed or at zero) rather than released."""
        self._standstill.command(zero=self._limiter.at_rest, now_ns=now_ns)
        if self._energised and self._mode not in HOLDING and self._rested(now_ns):
            self._energised = False
        return self._energised

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
