"""DJI RoboMaster C620 (M3508 motor) and C610 (M2006 motor): torque only, through the current.

How this works
--------------
Four motors share one command frame, 0x200 for ids 1 to 4 and 0x1FF for ids 5 to 8; every slot is always written, an
unused one with 0. So there must be one writer per command id: this driver, and nobody else on that bus. There is no
arming, no error report and no command timeout on CAN; whether a controller holds its last command when the host
falls silent is not documented, so assume that it does. A motor that is not heard gets current 0.

Rotor side throughout: the angle, speed and torque are those of the motor shaft before its gearbox.
"""

from collections.abc import Sequence
from math import isnan, tau
from struct import Struct
from typing import ClassVar, NamedTuple

from drivers.checks import check_specs, feedback_timeout_ns
from drivers.interface import (
    CanFrame,
    Capabilities,
    CommandKind,
    DecodedFrame,
    MotorCommand,
    MotorFeedback,
    MotorSpec,
    MotorState,
    ReceiveFilter,
    Traffic,
)

COMMAND_IDS = (0x200, 0x1FF)  # ids 1 to 4, ids 5 to 8; RoboMaster C610 manual, p. 8
FEEDBACK_ID = 0x200  # + id; same manual, p. 9
MOTORS_PER_FRAME = 4
IDS = range(1, 9)

TICKS = 8192  # per turn of the rotor; same manual, p. 9
RAD_PER_TICK = tau / TICKS
RAD_S_PER_RPM = tau / 60.0
TICKS_PER_RPM_NS = TICKS / 60e9

_TORQUE, _COAST = CommandKind.TORQUE, CommandKind.COAST
_COMMAND = Struct(">4h")  # current raw of four motors
_FEEDBACK = Struct(">HhhBx")  # angle ticks, speed rpm, current raw, temperature deg C (C610: nothing), unused
_FEEDBACK_FIELDS = ("angle_ticks", "speed_rpm", "current_raw", "temperature_c")


class Variant(NamedTuple):
    """What differs between the controllers."""

    raw_limit: int
    raw_per_ampere: float
    torque_constant: float  # N m/A at the rotor
    temperature: bool


VARIANTS: dict[str, Variant] = {
    # raw 16384 = 20 A, 0.3 N m/A after the gearbox 3591/187; open-source drivers RoboRTS-Firmware, OneMotor
    "c620": Variant(16384, 16384 / 20.0, 0.3 * 187 / 3591, temperature=True),
    # raw 10000 = 10 A; RoboMaster C610 manual, p. 8. 0.18 N m/A after the gearbox 36; OneMotor
    "c610": Variant(10000, 1000.0, 0.18 / 36.0, temperature=False),
}


class _Motor:
    """What is known of one motor."""

    __slots__ = (
        "angle_ticks",
        "commanded",
        "current_raw",
        "heard_ns",
        "heard_until_ns",
        "raw_limit",
        "raw_per_torque",
        "slot",
        "spec",
        "speed_rpm",
        "temperature_c",
        "timeout_ns",
        "total_ticks",
        "variant",
    )

    def __init__(self, spec: MotorSpec) -> None:
        variant = VARIANTS[spec.variant]
        self.spec = spec
        self.variant = variant
        self.slot = spec.id - 1
        self.raw_per_torque = variant.raw_per_ampere / variant.torque_constant
        ampere = min(spec.max_current, spec.max_torque / variant.torque_constant)
        self.raw_limit = min(variant.raw_limit, int(ampere * variant.raw_per_ampere))
        self.timeout_ns = feedback_timeout_ns(spec.feedback_rate)
        self.commanded = False
        self.heard_ns: int | None = None
        self.heard_until_ns = 0
        self.angle_ticks = 0
        self.total_ticks = 0
        self.speed_rpm = 0
        self.current_raw = 0
        self.temperature_c: float | None = None

    def take(self, data: bytes, received_ns: int) -> bool:
        """A feedback frame; False for an angle that no encoder of these has."""
        angle_ticks, speed_rpm, current_raw, temperature = _FEEDBACK.unpack_from(data)
        if angle_ticks >= TICKS:
            return False
        if self.heard_ns is None:
            self.total_ticks = angle_ticks
        else:
            gap_ns = received_ns - self.heard_ns
            mean_rpm = 0.5 * (self.speed_rpm + speed_rpm) if gap_ns > 0 else 0.0
            self.total_ticks += _moved_ticks(angle_ticks - self.angle_ticks, mean_rpm * gap_ns * TICKS_PER_RPM_NS)
        self.angle_ticks = angle_ticks
        self.speed_rpm = speed_rpm
        self.current_raw = current_raw
        if self.variant.temperature:
            self.temperature_c = float(temperature)
        self.heard_ns = received_ns
        self.heard_until_ns = received_ns + self.timeout_ns
        return True

    def raw(self, torque: float) -> int:
        """Current for a torque, within all limits."""
        wanted = torque * self.raw_per_torque
        limit = self.raw_limit
        return limit if wanted >= limit else -limit if wanted <= -limit else round(wanted)

    def feedback(self, now_ns: int) -> MotorFeedback:
        """Measurement and state."""
        if self.heard_ns is None:
            return MotorFeedback(MotorState.SILENT)
        state = MotorState.OPERATIONAL if self.commanded else MotorState.IDLE
        return MotorFeedback(
            state if now_ns < self.heard_until_ns else MotorState.SILENT,
            self.total_ticks * RAD_PER_TICK,
            self.speed_rpm * RAD_S_PER_RPM,
            self.current_raw / self.raw_per_torque,
            None,
            self.temperature_c,
            None,
            max(0, now_ns - self.heard_ns),
        )


class DjiDriver:
    """The C620 and C610 controllers of one bus."""

    __slots__ = ("_bus", "_by_id", "_command_frames", "_motors", "_names", "_zero_frames")

    variants: ClassVar[tuple[str, ...]] = tuple(VARIANTS)

    def __init__(self, bus: str, motors: Sequence[MotorSpec]) -> None:
        check_specs(motors, driver="dji", variants=self.variants, ids=IDS)
        for motor in motors:
            if motor.watchdog is not None:
                raise ValueError(f"motor {motor.name}: watchdog: a {motor.variant} has none; give watchdog_waiver")
        self._bus = bus
        self._motors = tuple(_Motor(motor) for motor in motors)
        self._names = {motor.spec.id: motor.spec.name for motor in self._motors}
        self._by_id = {FEEDBACK_ID + motor.spec.id: motor for motor in self._motors}
        used = sorted({motor.slot // MOTORS_PER_FRAME for motor in self._motors})
        self._command_frames = tuple((COMMAND_IDS[group], group * MOTORS_PER_FRAME) for group in used)
        self._zero_frames = [CanFrame(bus, identifier, bytes(8)) for identifier, _ in self._command_frames]

    @property
    def capabilities(self) -> Capabilities:
        """Torque only; braking is the host's speed loop."""
        return Capabilities(velocity=False, torque=True, voltage=False, brake=False, device_watchdog=False)

    def receive(self, frame: CanFrame) -> bool:
        """Take one received frame; True when it was ours."""
        bus, identifier, data, extended, remote, received_ns = frame
        motor = self._by_id.get(identifier)
        if motor is None or received_ns is None or extended or remote or bus != self._bus:
            return False
        return len(data) >= _FEEDBACK.size and motor.take(data, received_ns)

    def command(self, commands: Sequence[MotorCommand], *, now_ns: int) -> list[CanFrame]:
        """The command frames; a motor that is not heard gets current 0."""
        raws = [0] * len(IDS)
        for motor, (kind, value) in zip(self._motors, commands, strict=True):
            torque = kind is _TORQUE
            if isnan(value) or not (torque or kind is _COAST):
                raise ValueError(f"motor {motor.spec.name}: {kind.value} {value}: must be torque in N m, or coast")
            motor.commanded = torque
            if torque and now_ns < motor.heard_until_ns:
                raws[motor.slot] = motor.raw(value)
        return [
            CanFrame(self._bus, identifier, _COMMAND.pack(*raws[first : first + MOTORS_PER_FRAME]))
            for identifier, first in self._command_frames
        ]

    def feedback(self, *, now_ns: int) -> list[MotorFeedback]:
        """The latest measurement and state of each motor. There are no faults: the controllers report none."""
        return [motor.feedback(now_ns) for motor in self._motors]

    def clear_faults(self) -> None:
        """Nothing to clear: the controllers report no faults."""

    def coast_frames(self) -> list[CanFrame]:
        """Current 0 for every motor."""
        return list(self._zero_frames)

    def stop_frames(self) -> list[CanFrame]:
        """Current 0: any braking current needs the sign of the speed, and would drive a motor once it stands."""
        return list(self._zero_frames)

    def decode(self, frame: CanFrame) -> DecodedFrame | None:
        """A sent or received frame in words, or None when it is not of these motors."""
        if frame.bus != self._bus or frame.extended or frame.remote or len(frame.data) < _FEEDBACK.size:
            return None
        for identifier, first in self._command_frames:
            if frame.id == identifier:
                raws = _COMMAND.unpack_from(frame.data)
                numbers = range(first + 1, first + 1 + len(raws))
                fields = tuple((f"current_raw_{number}", raw) for number, raw in zip(numbers, raws, strict=True))
                return DecodedFrame(None, "command", fields, tuple(map(self._names.get, numbers)))
        motor = self._by_id.get(frame.id)
        if motor is None:
            return None
        items = _FEEDBACK.unpack_from(frame.data)
        return DecodedFrame(motor.spec.name, "feedback", tuple(zip(_FEEDBACK_FIELDS, items, strict=True)))

    def traffic(self, *, loop_rate_hz: float) -> tuple[Traffic, ...]:
        """Command frames and the feedback of each motor."""
        sent = [Traffic(f"command 0x{at:X}", False, 8, loop_rate_hz) for at, _ in self._command_frames]
        received = [
            Traffic(f"{motor.spec.name} feedback", False, 8, motor.spec.feedback_rate) for motor in self._motors
        ]
        return (*sent, *received)

    def receive_filters(self) -> tuple[ReceiveFilter, ...]:
        """The feedback frame of each motor."""
        return tuple(ReceiveFilter(identifier, 0x7FF, extended=False) for identifier in self._by_id)


def _moved_ticks(difference: int, expected: float) -> int:
    """The movement nearest to what the speed promises, among those that end at the angle seen.

    Without a gap the promise is small and this is the shortest way round. After one it is right as long as the mean
    speed of its two ends is within half a turn per gap of the true mean.
    """
    return difference + TICKS * round((expected - difference) / TICKS)
