"""What the simulated world and a simulated motor controller say to each other; everything at the motor shaft, SI."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple, Protocol

from drivers.contract import CanFrame, OptionValue

SECOND_NS = 1_000_000_000
STEP_NS = 1_000_000  # fixed substep of the world and control period of every simulated controller
STEP_S = STEP_NS / SECOND_NS

_GOLDEN_RATIO = 0.6180339887498949  # spreads the phases of any number of clocks evenly
_MAX_SKEW_PPM = 100  # crystal tolerance assumed for controllers; source: ours


class MotorSetup(NamedTuple):
    """One motor as its controller was commissioned."""

    name: str
    bus: str
    id: int
    variant: str
    max_speed: float  # rad/s
    max_torque: float  # N m
    max_current: float  # A, the current that gives max_torque
    inertia: float  # kg m^2 felt at the shaft while the other joints are free; the speed loop is tuned to it
    feedback_rate: float | None  # Hz; None: it only replies
    watchdog_s: float | None  # the command timeout that the robot file wants
    absolute: bool = False  # the encoder knows the shaft's angle (all turns) also after a power cut
    options: Mapping[str, OptionValue] = MappingProxyType({})  # those of its driver
    supply: float | None = None  # V, where the robot file tells it
    bitrate: int | None = None  # bit/s of the bus that it is on; None: whatever it is set to


class Shaft(NamedTuple):
    """True motion of a motor shaft: rad (multi-turn), rad/s."""

    position: float
    velocity: float


class Emission(NamedTuple):
    """A frame that a device wants on its bus from `ready_ns` on."""

    ready_ns: int
    frame: CanFrame


class Placed(Protocol):
    """Who a device is, as far as a bus asks."""

    @property
    def name(self) -> str: ...
    @property
    def bus(self) -> str: ...


class BusDevice(Protocol):
    """Anything on a simulated bus."""

    @property
    def setup(self) -> Placed: ...

    @property
    def acknowledges(self) -> bool:
        """Whether the device takes part in the bus at all (connected and powered)."""
        ...

    def receive(self, frame: CanFrame, now_ns: int) -> Sequence[Emission]:
        """Take a frame from the bus; the replies. Foreign, short and wild frames never raise."""
        ...

    def poll(self, now_ns: int) -> Sequence[Emission]:
        """Cyclic frames that became ready since the last poll, oldest first."""
        ...


class SimulatedDevice(Protocol):
    """One simulated motor controller; it sees time only as an argument."""

    @property
    def setup(self) -> MotorSetup: ...

    @property
    def acknowledges(self) -> bool:
        """Whether the device takes part in the bus at all (connected and powered)."""
        ...

    def start(self, shaft: Shaft, now_ns: int) -> None:
        """Power on at this shaft angle; the phases of the cyclic frames count from here."""
        ...

    def receive(self, frame: CanFrame, now_ns: int) -> Sequence[Emission]:
        """Take a frame from the bus; the replies. Foreign, short and wild frames never raise."""
        ...

    def poll(self, now_ns: int) -> Sequence[Emission]:
        """Cyclic frames that became ready since the last poll, oldest first."""
        ...

    def step(self, shaft: Shaft, now_ns: int) -> float:
        """Sample the shaft and run one control period; the torque held until the next step."""
        ...

    def unplug(self) -> None:
        """Cut the CAN cable; the controller stays powered."""
        ...

    def plug(self) -> None:
        """Mend the cable."""
        ...

    def power_off(self) -> None:
        """Take the power away: no torque, no frames, volatile state lost."""
        ...

    def power_on(self) -> None:
        """Give the power back."""
        ...

    def freeze_encoder(self, frozen: bool) -> None:
        """The encoder goes on telling the angle it told last, and no speed."""
        ...

    def shift_encoder(self, angle: float) -> None:
        """The encoder tells so many radians more than before, as after a slipped magnet; a speed of it is not seen."""
        ...


class Clock:
    """When a controller's own free-running timer fires: own phase, own frequency error, both from the node id."""

    __slots__ = ("due_ns", "period_ns", "phase")

    def __init__(self, rate_hz: float | None, node_id: int) -> None:
        if rate_hz is None:
            raise ValueError(f"id {node_id}: a controller with cyclic frames needs a feedback_rate")
        skew = 1.0 + ((node_id * 61) % (2 * _MAX_SKEW_PPM + 1) - _MAX_SKEW_PPM) * 1e-6
        self.period_ns = round(SECOND_NS / rate_hz * skew)
        self.phase = (node_id * _GOLDEN_RATIO) % 1.0
        self.due_ns = 0

    def start(self, now_ns: int) -> None:
        """Restart at power-on; the first tick comes within one period."""
        self.due_ns = now_ns + 1 + int(self.phase * self.period_ns)
