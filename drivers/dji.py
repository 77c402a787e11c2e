"""DJI RoboMaster C620 (M3508 motor) and C610 (M2006 motor): torque only, through the current.

How this works
--------------
Four motors share one command frame, 0x200 for ids 1 to 4 and 0x1FF for ids 5 to 8; every slot is always written, an
unused one with 0. So there must be one writer per command id: this driver, and nobody else on that bus. There is no
arming, no error report and no command timeout on CAN; whether a controller holds its last command when the host
falls silent is not documented, so assume that it does. A motor that is not heard gets current 0, and so does one whose
id two controllers have: whose speed is told is anybody's guess.

Braking without the host's speed loop (`stop_frames`) is a current against the measured speed, in proportion to it: it
fades as the motor comes to rest, and is 0 where the speed is unknown or too small to have a sign. A controller may
hold it until the next frame, so the longer it may be held or the older the measurement is, the weaker it is.

Rotor side throughout: the angle, speed and torque are those of the motor shaft before its gearbox.
"""

from collections.abc import Sequence
from math import ceil, isnan, pi, tau
from struct import Struct
from typing import ClassVar, Final, NamedTuple

from drivers.checks import (
    FASTEST_FEEDBACK_HZ,
    Bound,
    check_bounds,
    check_count,
    check_options,
    check_specs,
    feedback_timeout_ns,
    measuring_hz,
)
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
    Traffic,
)
from drivers.records import data_frame, maker
from drivers.setpoint import CommandKind, MotorCommand
from drivers.twins import TwinWatch, twin_fault

# Members of enumerations, each looked up once: where every cycle does, it takes a tenth of its time.
_SILENT: Final = MotorState.SILENT
_OPERATIONAL: Final = MotorState.OPERATIONAL
_IDLE: Final = MotorState.IDLE
_FAULT: Final = MotorState.FAULT

COMMAND_IDS: Final = (0x200, 0x1FF)  # ids 1 to 4, ids 5 to 8; RoboMaster C610 manual, p. 8
FEEDBACK_ID: Final = 0x200  # + id; same manual, p. 9
MOTORS_PER_FRAME: Final = 4
IDS: Final = range(1, 9)

AUTO_ID: Final = 0x700  # 8 bytes on it make controllers choose new ids; RoboRTS-Firmware, motor_auto_set_id

TICKS: Final = 8192  # per turn of the rotor; same manual, p. 9
RAD_PER_TICK: Final = tau / TICKS
RAD_S_PER_RPM: Final = tau / 60.0
TICKS_PER_RPM_NS: Final = TICKS / 60e9

SPEED_DOUBT: Final = 0.1  # of max_speed: how far the mean speed between two frames may be from that of its two ends
FULL_BRAKING: Final = 0.25  # of max_speed: from there on all of the current that is allowed brakes
REST: Final = 0.002  # of max_speed: below it nothing brakes
MIN_REST_RPM: Final = 2  # the speed is told in whole rpm, so that of 1 has no sure sign
FULL_BRAKING_NS: Final = 5_000_000  # a current held for longer could turn a wheel in the air the other way round

_made: Final = maker(MotorFeedback)
_TORQUE: Final = CommandKind.TORQUE
_COAST: Final = CommandKind.COAST
_COMMAND: Final = Struct(">4h")  # current raw of four motors
_FEEDBACK: Final = Struct(">HhhBx")  # angle ticks, speed rpm, current raw, temperature deg C (C610: nothing), unused
_WHOLE: Final = 6755399441055744.0  # 1.5 * 2^52: floats there are whole numbers, so adding it rounds to the nearest one
_FEEDBACK_SIZE: Final = _FEEDBACK.size
_feedback: Final = _FEEDBACK.unpack_from
_FEEDBACK_FIELDS: Final = ("angle_ticks", "speed_rpm", "current_raw", "temperature_c")


class Variant(NamedTuple):
    """What differs between the controllers."""

    raw_limit: int
    raw_per_ampere: float
    torque_constant: float  # N m/A at the rotor
    temperature: bool


VARIANTS: Final[dict[str, Variant]] = {
    # raw 16384 = 20 A, 0.3 N m/A after the gearbox 3591/187; open-source drivers RoboRTS-Firmware, OneMotor
    "c620": Variant(16384, 16384 / 20.0, 0.3 * 187 / 3591, temperature=True),
    # raw 10000 = 10 A; RoboMaster C610 manual, p. 8. 0.18 N m/A after the gearbox 36; OneMotor
    "c610": Variant(10000, 1000.0, 0.18 / 36.0, temperature=False),
}


class _Motor:
    """What is known of one motor."""

    __slots__ = (
        "angle_ticks",
        "braking_raw_per_rpm",
        "command_period_ns",
        "commanded",
        "current_raw",
        "fault",
        "heard_ns",
        "heard_until_ns",
        "raw_limit",
        "raw_per_torque",
        "rest_rpm",
        "slot",
        "spec",
        "speed_rpm",
        "temperature_c",
        "timeout_ns",
        "total_ticks",
        "twins",
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
        max_rpm = spec.max_speed / RAD_S_PER_RPM
        self.braking_raw_per_rpm = self.raw_limit / (FULL_BRAKING * max_rpm)
        self.command_period_ns = int(1e9 / spec.command_rate)
        self.rest_rpm = max(MIN_REST_RPM, REST * max_rpm)
        self.timeout_ns = feedback_timeout_ns(spec)
        self.commanded = False
        self.heard_ns: int | None = None
        self.heard_until_ns = 0
        self.angle_ticks = 0
        self.total_ticks = 0
        self.speed_rpm = 0
        self.current_raw = 0
        self.temperature_c: float | None = None
        self.twins = TwinWatch(spec, turn=tau)
        self.fault: DriverFault | None = None

    def take(self, data: bytes, bus: str, received_ns: int) -> bool:
        """A feedback frame; False for one that no controller sends."""
        values = _feedback_values(data)
        if values is None:
            return False
        angle_ticks, speed_rpm, current_raw, temperature = values
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
        if self.twins.take(angle_ticks * RAD_PER_TICK, speed_rpm * RAD_S_PER_RPM, received_ns) and self.fault is None:
            self.fault = twin_fault(self.spec, bus)
        return True

    def trusted(self, now_ns: int) -> bool:
        """Whether it is heard, and is one."""
        return now_ns < self.heard_until_ns and self.fault is None

    def raw(self, torque: float) -> int:
        """Current for a torque, within all limits."""
        return self._limited(torque * self.raw_per_torque)

    def braking_raw(self, held_ns: int, now_ns: int) -> int:
        """Current against the measured speed; `held_ns`: how long the last frame was, and so the next one may be."""
        if not self.trusted(now_ns) or self.heard_ns is None or abs(self.speed_rpm) < self.rest_rpm:
            return 0
        longest_ns = max(self.command_period_ns, held_ns, now_ns - self.heard_ns, FULL_BRAKING_NS)
        return self._limited(-self.speed_rpm * self.braking_raw_per_rpm * FULL_BRAKING_NS / longest_ns)

    def _limited(self, wanted: float) -> int:
        limit = self.raw_limit
        return limit if wanted >= limit else -limit if wanted <= -limit else _nearest(wanted)

    def feedback(self, now_ns: int) -> MotorFeedback:
        """Measurement and state."""
        if self.heard_ns is None:
            return MotorFeedback(_SILENT)
        state = _OPERATIONAL if self.commanded else _IDLE
        if self.fault is not None:
            state = _FAULT
        return _made(
            (
                state if now_ns < self.heard_until_ns else _SILENT,
                self.total_ticks * RAD_PER_TICK,
                self.speed_rpm * RAD_S_PER_RPM,
                self.current_raw / self.raw_per_torque,
                None,
                self.temperature_c,
                self.fault,
                max(0, now_ns - self.heard_ns),
                None,
            )
        )


class DjiDriver:
    """The C620 and C610 controllers of one bus."""

    __slots__ = ("_bus", "_by_id", "_command_frames", "_motors", "_names", "_sent_ns", "_zero_frames")

    variants: ClassVar[tuple[str, ...]] = tuple(VARIANTS)

    def __init__(self, bus: str, motors: Sequence[MotorSpec]) -> None:
        check_specs(motors, driver="dji", variants=self.variants, ids=IDS)
        for motor in motors:
            if motor.watchdog_s is not None:
                raise ValueError(f"motor {motor.name}: watchdog: a {motor.variant} has none; give watchdog_waiver")
            check_options(motor, {}, of="driver dji")
            check_bounds(motor, _turn_bounds(motor))
        self._bus = bus
        self._motors = tuple(_Motor(motor) for motor in motors)
        _check_torque(self._motors)
        self._sent_ns: int | None = None
        self._names = {motor.spec.id: motor.spec.name for motor in self._motors}
        self._by_id = {FEEDBACK_ID + motor.spec.id: motor for motor in self._motors}
        used = sorted({motor.slot // MOTORS_PER_FRAME for motor in self._motors})
        self._command_frames = tuple((COMMAND_IDS[group], group * MOTORS_PER_FRAME) for group in used)
        self._zero_frames = [CanFrame(bus, identifier, bytes(8)) for identifier, _ in self._command_frames]

    @property
    def capabilities(self) -> tuple[Capabilities, ...]:
        """Torque only; braking is the host's speed loop."""
        return (Capabilities(torque=True, speed_step=RAD_S_PER_RPM),) * len(self._motors)

    def receive(self, frame: CanFrame) -> bool:
        """Take one received frame; True when it was ours."""
        bus, identifier, data, extended, remote, received_ns, fd, _ = frame
        motor = self._by_id.get(identifier)
        if motor is None or received_ns is None or extended or remote or fd or bus != self._bus:
            return False
        return motor.take(data, bus, received_ns)

    def command(self, commands: Sequence[MotorCommand], *, now_ns: int) -> list[CanFrame]:
        """The command frames; a motor that is not heard gets current 0."""
        check_count(commands, self._motors)
        raws = [0] * len(IDS)
        for motor, command in zip(self._motors, commands):
            kind, value = command.kind, command.value
            torque = kind is _TORQUE
            alone = command.feed_forward == 0.0 and command.limit is None
            if isnan(value) or not (torque or kind is _COAST) or not alone:
                raise ValueError(f"motor {motor.spec.name}: {command}: must be a torque in N m alone, or coast")
            motor.commanded = torque
            if torque and motor.trusted(now_ns):
                raws[motor.slot] = motor.raw(value)
        return self._frames(raws, now_ns)

    def feedback(self, *, now_ns: int) -> list[MotorFeedback]:
        """The latest measurement and state of each motor. The controllers report no faults; the driver finds one."""
        return [motor.feedback(now_ns) for motor in self._motors]

    def clear_faults(self) -> None:
        """Look anew for ids given twice; the controllers themselves report no faults."""
        for motor in self._motors:
            motor.fault = None
            motor.twins.forget()

    def coast_frames(self) -> list[CanFrame]:
        """Current 0 for every motor."""
        return list(self._zero_frames)

    def stop_frames(self, *, now_ns: int) -> list[CanFrame]:
        """A braking current against the measured speed of each motor; 0 where it is not known, or stands."""
        held_ns = 0 if self._sent_ns is None else now_ns - self._sent_ns
        raws = [0] * len(IDS)
        for motor in self._motors:
            raws[motor.slot] = motor.braking_raw(held_ns, now_ns)
        return self._frames(raws, now_ns)

    def decode(self, frame: CanFrame) -> DecodedFrame | None:
        """A sent or received frame in words, or None when it is not of these motors, too short or impossible."""
        if frame.bus != self._bus or frame.extended or frame.remote or frame.fd or len(frame.data) < _COMMAND.size:
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
        items = _feedback_values(frame.data)
        if items is None:
            return None
        return DecodedFrame(motor.spec.name, "feedback", tuple(zip(_FEEDBACK_FIELDS, items, strict=True)))

    def traffic(self, *, loop_rate_hz: float) -> tuple[Traffic, ...]:
        """Command frames and the feedback of each motor."""
        sent = [Traffic(f"command 0x{at:X}", False, 8, loop_rate_hz) for at, _ in self._command_frames]
        received = [
            Traffic(f"{motor.spec.name} feedback", False, 8, measuring_hz(motor.spec)) for motor in self._motors
        ]
        return (*sent, *received)

    def receive_filters(self) -> tuple[ReceiveFilter, ...]:
        """The feedback frame of each motor."""
        return tuple(ReceiveFilter(identifier, 0x7FF, extended=False) for identifier in self._by_id)

    def ids(self) -> tuple[IdUse, ...]:
        """The command frames, the feedback of each motor, and the one frame that would give the controllers new ids."""
        commands = [
            (f"dji command of motor {', '.join(self._sharers(first))}", identifier)
            for identifier, first in self._command_frames
        ]
        feedback = [(f"dji feedback of motor {motor.spec.name}", at) for at, motor in self._by_id.items()]
        uses = (*commands, *feedback, ("dji setting of ids", AUTO_ID))
        return tuple(IdUse(user, identifier, 0x7FF, extended=False) for user, identifier in uses)

    def _sharers(self, first: int) -> list[str]:
        """Names of the motors in the command frame that begins with this slot."""
        return [motor.spec.name for motor in self._motors if first <= motor.slot < first + MOTORS_PER_FRAME]

    def _frames(self, raws: Sequence[int], now_ns: int) -> list[CanFrame]:
        self._sent_ns = now_ns
        return [
            data_frame(self._bus, identifier, _COMMAND.pack(*raws[first : first + MOTORS_PER_FRAME]))
            for identifier, first in self._command_frames
        ]


def _feedback_values(data: bytes) -> tuple[int, int, int, int] | None:
    """Angle in ticks, speed in rpm, raw current, temperature; None for what no controller sends."""
    if len(data) < _FEEDBACK_SIZE:
        return None
    angle_ticks, speed_rpm, current_raw, temperature = _feedback(data)
    return None if angle_ticks >= TICKS else (angle_ticks, speed_rpm, current_raw, temperature)


def _check_torque(motors: Sequence[_Motor]) -> None:
    for motor in motors:
        if motor.raw_limit < 1:
            step = f"{1e3 / motor.variant.raw_per_ampere:.2g} mA"
            raise ValueError(f"motor {motor.spec.name}: max_current or max_torque allows less than {step}, one step")


def _turn_bounds(motor: MotorSpec) -> list[Bound]:
    """The angle is known within a turn only: between two frames the way must be foreseen to half a turn."""
    doubt = SPEED_DOUBT * motor.max_speed
    slowest = ceil(10.0 * doubt / pi) / 10.0
    top = f"max_speed times gear_ratio is {motor.max_speed:.0f} rad/s"
    why = f"the rotor's turns are counted from its angle and speed, and {top}"
    return [
        Bound("max_speed", motor.max_speed, 0.0, FASTEST_FEEDBACK_HZ * pi / SPEED_DOUBT, "rad/s at the rotor", why),
        Bound("feedback_rate", measuring_hz(motor), slowest, FASTEST_FEEDBACK_HZ, "Hz", why),
    ]


def _nearest(x: float) -> int:
    """`round(x)` of what is far below 2^51, in a fraction of its time when compiled."""
    return int((x + _WHOLE) - _WHOLE)


def _moved_ticks(difference: int, expected: float) -> int:
    """The movement nearest to what the speed promises, among those that end at the angle seen.

    Without a gap the promise is small and this is the shortest way round. After one it is right as long as the mean
    speed of its two ends is within half a turn per gap of the true mean.
    """
    return difference + TICKS * _nearest((expected - difference) / TICKS)
