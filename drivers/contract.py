"""What the gateway and a motor-controller driver say to each other.

How this works
--------------
A driver is one instance per group of motors that share a protocol on one bus. It owns no bus, no clock and no
thread: `receive` takes frames in, `command` gives frames out once per cycle, and time is an argument. Bring-up
and recovery are states that `command` advances; nothing here blocks.

Everything is in SI at the *motor shaft* (rad, rad/s, N m). Gear ratio and mounting direction are not the
driver's business: `gateway.control.transmission` applies them, once.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from enum import Enum
from types import MappingProxyType
from typing import Final, NamedTuple, Protocol

from drivers.setpoint import MotorCommand
from drivers.sighting import Sighting

FD_LENGTHS: Final = (*range(9), 12, 16, 20, 24, 32, 48, 64)  # bytes that a CAN FD frame can carry (ISO 11898-1:2015)


class CanFrame(NamedTuple):
    """One CAN frame. `received_ns` is CLOCK_MONOTONIC; None on a frame that is to be sent.

    Classic: up to 8 bytes of data. `fd`: one of CAN FD, of one of FD_LENGTHS, never remote; `bit_rate_switch`: its data
    go at the faster rate of the bus.
    """

    bus: str
    id: int
    data: bytes
    extended: bool = False
    remote: bool = False
    received_ns: int | None = None
    fd: bool = False
    bit_rate_switch: bool = False


class MotorState(Enum):
    """Where a motor controller is on its way to obeying."""

    SILENT = "silent"  # never heard, or not heard within the feedback timeout
    IDLE = "idle"  # heard, motor de-energised (coasting)
    STARTING = "starting"  # bring-up under way
    OPERATIONAL = "operational"  # obeys setpoints
    FAULT = "fault"  # the controller, or the driver on its behalf, refuses; see `fault`


class DriverFault(NamedTuple):
    """Why a motor refuses: our code, the vendor's own words, and whether only an explicit reset may clear it."""

    code: str
    text: str
    latched: bool


class MotorFeedback(NamedTuple):
    """Measurement from one motor; whatever the controller did not report is None."""

    state: MotorState
    position: float | None = None  # rad at the motor shaft, multi-turn
    velocity: float | None = None  # rad/s
    torque: float | None = None  # N m
    voltage: float | None = None  # V
    temperature_c: float | None = None
    fault: DriverFault | None = None
    age_ns: int | None = None  # since the last position/velocity measurement
    silence: str | None = None  # of a SILENT motor that is heard in part: what is missing and what turns it on
    torque_age_ns: int | None = None  # since the torque was told: many tell it more seldom than speed


class Capabilities(NamedTuple):
    """What a controller can do on its own; every controller can be released, and one that takes a velocity can brake.

    `feed_forward` and `limit`: of a velocity command, with every command and at once; see `MotorCommand`.
    `coast`: released it rolls on; else its windings are as good as shorted, which brakes it while it turns.
    `speed_step`: rad/s at the shaft by which two measured speeds differ at least; None: not known.
    `least_speed`: rad/s at the shaft; a slower one that is asked for only brakes.
    """

    velocity: bool = False
    torque: bool = False
    voltage: bool = False
    brake: bool = False
    coast: bool = True
    feed_forward: bool = False
    limit: bool = False
    device_watchdog: bool = False
    speed_step: float | None = None
    least_speed: float = 0.0


OptionValue = bool | int | float | str  # what the robot file can say in `options`


class MotorSpec(NamedTuple):
    """What a driver is told of one motor; limits are at the motor shaft."""

    name: str
    id: int
    variant: str
    max_speed: float  # rad/s
    max_torque: float  # N m
    max_current: float  # A
    feedback_rate: float | None  # Hz, as configured in the controller; None: it only replies to commands
    command_rate: float  # Hz, at which `command` is called
    watchdog_s: float | None  # the controller's own command timeout; None: waived in the robot file, with the reason
    options: Mapping[str, OptionValue] = MappingProxyType({})  # the driver's own, as typed: it checks them itself
    supply: float | None = None  # V at the controller; None: the robot file does not tell


class Traffic(NamedTuple):
    """One cyclic frame on the bus, for the load budget."""

    name: str
    extended: bool
    length: int
    rate_hz: float
    fd: bool = False
    bit_rate_switch: bool = False


class ReceiveFilter(NamedTuple):
    """Frames whose id equals `id` where `mask` has ones; what no filter of a bus lets pass, its driver need not see."""

    id: int
    mask: int
    extended: bool


class IdUse(NamedTuple):
    """Ids that mean something to one user: those equal to `id` where `mask` has ones. `user`: who, in words."""

    user: str
    id: int
    mask: int
    extended: bool


class DecodedFrame(NamedTuple):
    """A frame in words: motor or sensor concerned (None: several or none), message name, fields in wire order.

    `owners` names the motor of each field of a frame that several share; None where a slot is nobody's.
    """

    motor: str | None
    message: str
    fields: tuple[tuple[str, float | int], ...]
    owners: tuple[str | None, ...] = ()


class Identity(NamedTuple):
    """What a controller says of itself: its serial number, and its id; None: it has none yet."""

    serial: int
    id: int | None


class RenamingOverCan(NamedTuple):
    """How controllers get ids by their serial numbers; none of it moves a motor.

    `ask`: every controller on a bus who it is; `told`: what a frame says of that; `give`: on a bus the controller of a
    serial number an id; `keep`: the one of an id keeps it, also after a power cut; it starts anew for that. `claim`:
    the identifier that whoever commands the one of an id holds.
    """

    ask: Callable[[str], list[CanFrame]]
    told: Callable[[CanFrame], Identity | None]
    give: Callable[[str, int, int], list[CanFrame]]
    keep: Callable[[str, int], list[CanFrame]]
    claim: Callable[[int], int]


class Renaming(NamedTuple):
    """How a controller gets another of these ids: over CAN, or by a person, with what is to be done for an id."""

    ids: range
    how: RenamingOverCan | Callable[[int], tuple[str, ...]]


class Driver(Protocol):
    """Sans-IO state machine of one group of motors. Per-motor sequences are always in the order of the specs."""

    @property
    def capabilities(self) -> tuple[Capabilities, ...]:
        """What the controller of each motor can do; it differs within a group where variants do."""
        ...

    def receive(self, frame: CanFrame) -> bool:
        """Take one received frame; True when it was ours. Foreign, short and wild frames never raise."""
        ...

    def command(self, commands: Sequence[MotorCommand], *, now_ns: int) -> list[CanFrame]:
        """Advance every motor's state towards its command; the frames to send in this cycle.

        A motor commanded anything but COAST is brought up (armed) if it is not; one commanded COAST is released.
        Controllers that only reply are all asked in every cycle, whatever their command.
        Values beyond a limit saturate. A NaN, or anything that the capabilities do not claim, raises ValueError
        naming the motor: that is our own bug.
        """
        ...

    def feedback(self, *, now_ns: int) -> list[MotorFeedback]:
        """The latest measurement and state of each motor.

        One whose measurement is missing for `checks.feedback_timeout_ns` is SILENT. Cyclic ones are missing since the
        last; replies since the first command that nobody answered: without a command nothing is missing.
        """
        ...

    def clear_faults(self) -> None:
        """Forget latched faults and ask the controllers to do the same; arms nothing."""
        ...

    def coast_frames(self) -> list[CanFrame]:
        """Frames that release every motor; valid in any state."""
        ...

    def stop_frames(self, *, now_ns: int) -> list[CanFrame]:
        """Frames that brake every motor now; sent again and again they bring it to rest. Valid in any state.

        They never drive a motor that stands, and ask nothing of one whose motion is not known.
        """
        ...

    def decode(self, frame: CanFrame) -> DecodedFrame | None:
        """A sent or received frame in words, or None when it is not of this driver.

        Nor is what `receive` refuses: a short or impossible message is not shown as a measurement.
        """
        ...

    def traffic(self, *, loop_rate_hz: float) -> tuple[Traffic, ...]:
        """Every cyclic frame of this group and every reply, both directions."""
        ...

    def receive_filters(self) -> tuple[ReceiveFilter, ...]:
        """At least every frame that `receive` may take; the kernel keeps the rest of a busy bus away."""
        ...

    def ids(self) -> tuple[IdUse, ...]:
        """Every id that this driver or its controllers send or listen to: nobody else on the bus may use them."""
        ...


class DriverType(Protocol):
    """Makes the driver of one group: the value type of the registry `drivers.DRIVERS`."""

    variants: tuple[str, ...]
    words: tuple[str, ...]  # of the vendor, which the text of a fault may have

    def __call__(self, bus: str, motors: Sequence[MotorSpec]) -> Driver:
        """Build the driver. Raises ValueError naming motor, key, value, allowed range and why."""
        ...

    def sighted(self, frame: CanFrame) -> list[Sighting]:
        """What a frame of an unknown bus would be to these controllers, one for each way to read it; never raises."""
        ...

    def questions(self, bus: str, heard: Collection[int]) -> list[CanFrame]:
        """Asks controllers who they are, and moves and changes nothing; `heard`: ids that were seen to be theirs."""
        ...

    def renaming(self, variant: str) -> Renaming:
        """How a controller of this variant gets another id."""
        ...
