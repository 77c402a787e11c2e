"""A driver and a controller of a made-up protocol in which a controller speaks only when spoken to.

It is what the contract is held against for such controllers before there is one: a reply to each command, torques of
its own with each velocity, and a torque limit with each command. One frame of 8 bytes each way: 0x10 + id, 0x60 + id.
"""

from collections.abc import Collection, Sequence
from math import isfinite, isnan
from struct import Struct
from typing import ClassVar

from drivers.checks import check_count, check_options, check_specs, feedback_timeout_ns
from drivers.contract import (
    CanFrame,
    Capabilities,
    DecodedFrame,
    DriverFault,
    IdUse,
    MotorFeedback,
    MotorSpec,
    MotorState,
    ReceiveFilter,
    Renaming,
    Traffic,
)
from drivers.setpoint import BRAKE, COAST, CommandKind, MotorCommand
from drivers.sighting import Sighting
from drivers.twins import TwinWatch, twin_fault
from replay.sim.controllers.contract import STEP_S, Emission, MotorSetup, Shaft

COMMAND, REPLY = 0x10, 0x60
_COMMAND = Struct("<Bxeee")  # mode, value, feed-forward, torque limit
_REPLY = Struct("<Bxfe")  # fault, rad, rad/s
_MODES = {CommandKind.COAST: 0, CommandKind.BRAKE: 1, CommandKind.VELOCITY: 2, CommandKind.TORQUE: 3}


def reply_data(fault: int, position: float, velocity: float) -> bytes:
    return _REPLY.pack(fault, position, velocity)


def command_values(frame: CanFrame) -> tuple[float, ...]:
    """Setpoint and feed-forward of a command; nothing for other frames."""
    return _COMMAND.unpack(frame.data)[1:3] if frame.id >> 4 == COMMAND >> 4 else ()


def _reply_values(data: bytes) -> tuple[int, float, float] | None:
    if len(data) != _REPLY.size:
        return None
    fault, position, velocity = _REPLY.unpack(data)
    return (fault, position, velocity) if isfinite(position) and isfinite(velocity) else None


class _Motor:
    """What is known of one motor."""

    def __init__(self, spec: MotorSpec) -> None:
        self.spec = spec
        self.timeout_ns = feedback_timeout_ns(spec)
        self.unanswered_ns: int | None = None  # since when; None: nothing is
        self.heard_ns: int | None = None
        self.kind = CommandKind.COAST
        self.position = self.velocity = 0.0
        self.twins = TwinWatch(spec)
        self.fault: DriverFault | None = None

    def silent(self, now_ns: int) -> bool:
        since_ns = self.unanswered_ns
        return self.heard_ns is None or (since_ns is not None and now_ns - since_ns >= self.timeout_ns)

    def told(self, command: MotorCommand, now_ns: int) -> MotorCommand:
        """The command as far as it may be passed on; asking begins here."""
        kind, value, feed_forward, limit = command.kind, command.value, command.feed_forward, command.limit
        extra = kind is not CommandKind.VELOCITY and (feed_forward != 0.0 or limit is not None)
        if kind not in _MODES or isnan(value) or isnan(feed_forward) or extra or not (limit is None or limit >= 0.0):
            raise ValueError(f"motor {self.spec.name}: {command}: must be a number and one of ours")
        self.kind = kind
        passed = COAST if self.silent(now_ns) or self.fault is not None else command
        if self.unanswered_ns is None:
            self.unanswered_ns = now_ns
        return passed

    def data(self, command: MotorCommand) -> bytes:
        kind, value, feed_forward, limit = command.kind, command.value, command.feed_forward, command.limit
        torque = self.spec.max_torque
        most = self.spec.max_speed if kind is CommandKind.VELOCITY else torque if kind is CommandKind.TORQUE else 0.0
        bound = torque if limit is None else min(limit, torque)
        return _COMMAND.pack(_MODES[kind], _within(value, most), _within(feed_forward, torque), bound)

    def feedback(self, now_ns: int) -> MotorFeedback:
        if self.heard_ns is None:
            return MotorFeedback(MotorState.SILENT)
        state = MotorState.IDLE if self.kind is CommandKind.COAST else MotorState.OPERATIONAL
        if self.fault is not None:
            state = MotorState.FAULT
        if self.silent(now_ns):
            state = MotorState.SILENT
        age_ns = max(0, now_ns - self.heard_ns)
        return MotorFeedback(state, self.position, self.velocity, fault=self.fault, age_ns=age_ns)


class ReplyOnlyDriver:
    """The controllers of one bus."""

    variants: ClassVar[tuple[str, ...]] = ("replier",)
    words: ClassVar[tuple[str, ...]] = ()

    def __init__(self, bus: str, motors: Sequence[MotorSpec]) -> None:
        check_specs(motors, driver="reply_only", variants=self.variants, ids=range(1, 16), cyclic=False)
        for motor in motors:
            if motor.watchdog_s is not None:
                raise ValueError(f"motor {motor.name}: watchdog: a replier has none; give watchdog_waiver")
            check_options(motor, {}, of="driver reply_only")
        self._bus = bus
        self._motors = [_Motor(motor) for motor in motors]

    @staticmethod
    def sighted(frame: CanFrame) -> list[Sighting]:
        return []

    @staticmethod
    def questions(bus: str, heard: Collection[int]) -> list[CanFrame]:
        return []

    @staticmethod
    def renaming(variant: str) -> Renaming:
        return Renaming(range(1, 16), lambda at: (f"turn its switch to {at}",))

    @property
    def capabilities(self) -> tuple[Capabilities, ...]:
        able = Capabilities(velocity=True, torque=True, brake=True, feed_forward=True, limit=True)
        return (able,) * len(self._motors)

    def receive(self, frame: CanFrame) -> bool:
        motor, values = self._reply(frame)
        if motor is None or values is None or frame.received_ns is None or frame.fd:
            return False
        fault, motor.position, motor.velocity = values
        motor.heard_ns, motor.unanswered_ns = frame.received_ns, None
        if fault:
            motor.fault = DriverFault("device_error", f"fault {fault}", latched=True)
        if motor.twins.take(motor.position, motor.velocity, frame.received_ns):
            motor.fault = twin_fault(motor.spec, self._bus)
        return True

    def command(self, commands: Sequence[MotorCommand], *, now_ns: int) -> list[CanFrame]:
        check_count(commands, self._motors)
        pairs = list(zip(self._motors, commands, strict=True))
        return [self._frame(motor, motor.told(command, now_ns)) for motor, command in pairs]

    def feedback(self, *, now_ns: int) -> list[MotorFeedback]:
        return [motor.feedback(now_ns) for motor in self._motors]

    def clear_faults(self) -> None:
        for motor in self._motors:
            motor.fault = None
            motor.twins.forget()

    def coast_frames(self) -> list[CanFrame]:
        return [self._frame(motor, COAST) for motor in self._motors]

    def stop_frames(self, *, now_ns: int) -> list[CanFrame]:
        return [self._frame(motor, BRAKE) for motor in self._motors]

    def decode(self, frame: CanFrame) -> DecodedFrame | None:
        motor, values = self._reply(frame)
        if motor is not None and values is not None:
            fields = tuple(zip(("fault", "position", "velocity"), values, strict=True))
            return DecodedFrame(motor.spec.name, "reply", fields)
        for motor in self._motors:
            if frame[:2] == (self._bus, COMMAND + motor.spec.id) and len(frame.data) == _COMMAND.size:
                named = zip(("mode", "value", "feed_forward", "limit"), _COMMAND.unpack(frame.data), strict=True)
                return DecodedFrame(motor.spec.name, "command", tuple(named))
        return None

    def traffic(self, *, loop_rate_hz: float) -> tuple[Traffic, ...]:
        names = [motor.spec.name for motor in self._motors]
        sent = [Traffic(f"{name} command", extended=False, length=8, rate_hz=loop_rate_hz) for name in names]
        replies = [Traffic(f"{name} reply", extended=False, length=8, rate_hz=loop_rate_hz) for name in names]
        return (*sent, *replies)

    def receive_filters(self) -> tuple[ReceiveFilter, ...]:
        return tuple(ReceiveFilter(REPLY + motor.spec.id, 0x7FF, extended=False) for motor in self._motors)

    def ids(self) -> tuple[IdUse, ...]:
        return tuple(
            IdUse(f"{what} of motor {motor.spec.name}", first + motor.spec.id, 0x7FF, extended=False)
            for motor in self._motors
            for what, first in (("command", COMMAND), ("reply", REPLY))
        )

    def _reply(self, frame: CanFrame) -> tuple[_Motor | None, tuple[int, float, float] | None]:
        known = {REPLY + motor.spec.id: motor for motor in self._motors}
        motor = known.get(frame.id)
        if frame.bus != self._bus or frame.extended or frame.remote or motor is None:
            return None, None
        return motor, _reply_values(frame.data)

    def _frame(self, motor: _Motor, command: MotorCommand) -> CanFrame:
        return CanFrame(self._bus, COMMAND + motor.spec.id, motor.data(command))


class SimulatedReplier:
    """The controller: a PI velocity loop whose torque is within the limit of the last command. It has no faults."""

    def __init__(self, setup: MotorSetup) -> None:
        self.setup = setup
        self.acknowledges = True
        self._gain = 60.0 * setup.inertia  # N m per rad/s
        self._command = (0, 0.0, 0.0, 0.0)
        self._integral = 0.0
        self._shaft = Shaft(0.0, 0.0)

    def start(self, shaft: Shaft, now_ns: int) -> None:
        self._shaft = shaft

    def receive(self, frame: CanFrame, now_ns: int) -> Sequence[Emission]:
        if not self.acknowledges or frame.id != COMMAND + self.setup.id or len(frame.data) != _COMMAND.size:
            return ()
        self._command = _COMMAND.unpack(frame.data)
        reply = CanFrame(self.setup.bus, REPLY + self.setup.id, reply_data(0, *self._shaft))
        return (Emission(now_ns, reply),)

    def poll(self, now_ns: int) -> Sequence[Emission]:
        return ()

    def step(self, shaft: Shaft, now_ns: int) -> float:
        self._shaft = shaft
        mode, value, feed_forward, limit = self._command
        if mode in (0, 3):
            self._integral = 0.0
            return _within(value, limit) if mode == 3 else 0.0
        error = value - shaft.velocity
        wanted = self._gain * error + self._integral + feed_forward
        if abs(wanted) <= limit:
            self._integral += 10.0 * self._gain * error * STEP_S
        return _within(wanted, limit)

    def unplug(self) -> None:
        self.acknowledges = False

    def plug(self) -> None:
        self.acknowledges = True

    def power_off(self) -> None:
        self.acknowledges, self._command = False, (0, 0.0, 0.0, 0.0)

    def power_on(self) -> None:
        self.acknowledges = True

    def freeze_encoder(self, frozen: bool) -> None:
        raise NotImplementedError

    def shift_encoder(self, angle: float) -> None:
        raise NotImplementedError


def _within(value: float, most: float) -> float:
    return max(-most, min(most, value))
