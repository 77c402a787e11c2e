"""Simulated sensors on CAN, written from the tables of the README ("Sensors on CAN") only."""

from collections.abc import Callable, Mapping, Sequence
from math import remainder, tau
from struct import pack

from drivers.contract import CanFrame
from replay.sim.controllers.contract import Clock, Emission
from replay.sim.sensors.contract import Scene, SensorSetup
from replay.sim.sensors.signal import Signal, Values

DELAY_NS = 2_000_000  # of a measurement when it is sent; source: ours, as of the noises
WIRE_NOISE = 1e-4  # m
ANGLE_NOISE = 5e-4  # rad
RATE_NOISE = 3e-3  # rad/s

_NOT_BEGUN = 1  # state of a sensor that has nothing to tell yet
_OUT_OF_RANGE = 2
_LAST_STANDARD_ID = 0x7FF

NOISES: Mapping[str, Sequence[float]] = {
    "range": (WIRE_NOISE,),
    "attitude": (ANGLE_NOISE, ANGLE_NOISE, RATE_NOISE, RATE_NOISE, RATE_NOISE),
    "heading": (ANGLE_NOISE,),
}
Content = tuple[int, list[bytes]]  # state, and the values of each frame


class Sender:
    """One sensor. `signals`: by kind, to be disturbed at will."""

    def __init__(
        self, setup: SensorSetup, signals: Mapping[str, Signal], content: Callable[[Mapping[str, Values]], Content]
    ) -> None:
        self.setup = setup
        self.signals = dict(signals)
        self.acknowledges = True
        self._content = content
        self._clock = Clock(setup.rate, setup.id)
        self._count = 15
        self._frames: list[CanFrame] = []
        self._hung = False

    def start(self, scene: Scene, now_ns: int) -> None:
        """Power on."""
        self._clock.start(now_ns)
        self.step(scene, now_ns)

    def receive(self, frame: CanFrame, now_ns: int) -> Sequence[Emission]:
        """It listens to nobody."""
        return ()

    def poll(self, now_ns: int) -> Sequence[Emission]:
        """A measurement for each tick of its clock."""
        clock, emissions = self._clock, []
        while clock.due_ns <= now_ns:
            if not self._hung or not self._frames:
                self._frames = self._measured(clock.due_ns)
            if self.acknowledges:
                emissions += [Emission(clock.due_ns, frame) for frame in self._frames]
            clock.due_ns += clock.period_ns
        return emissions

    def step(self, scene: Scene, now_ns: int) -> None:
        """Look at the world."""
        for kind, signal in self.signals.items():
            signal.look(scene.of(kind), now_ns)

    def unplug(self) -> None:
        """Cut its cable."""
        self.acknowledges = False

    def plug(self) -> None:
        """Mend it."""
        self.acknowledges = True

    def hang(self, hung: bool) -> None:
        """The last frames again and again."""
        self._hung = hung

    def stick(self, stuck: bool) -> None:
        """The last values again and again."""
        for signal in self.signals.values():
            signal.stuck = stuck

    def shift(self, kind: str, amount: float) -> None:
        """So much more, of the angles of an attitude both."""
        signal = self.signals[kind]
        shifted = 2 if kind == "attitude" else 1
        signal.bias = [bias + amount * (place < shifted) for place, bias in enumerate(signal.bias)]

    def _measured(self, now_ns: int) -> list[CanFrame]:
        self._count = (self._count + 1) % 16
        state, values = self._content({kind: signal.tell(now_ns) for kind, signal in self.signals.items()})
        return [
            self._frame(self.setup.id + place, bytes_ + bytes([state * 16 + self._count]))
            for place, bytes_ in enumerate(values)
        ]

    def _frame(self, identifier: int, data: bytes) -> CanFrame:
        check = crc8_j1850(identifier.to_bytes(4, "little") + data)
        return CanFrame(self.setup.bus, identifier, data + bytes([check]), extended=identifier > _LAST_STANDARD_ID)


def signal(kind: str, *, seed: int) -> Signal:
    """One kind of value as such a sensor tells it."""
    return Signal(NOISES[kind], delay_ns=DELAY_NS, seed=seed)


def draw_wire(setup: SensorSetup) -> Sender:
    """Its wire goes from one pair of wheels to the other."""
    return Sender(setup, {"range": signal("range", seed=setup.id)}, _length)


def imu(setup: SensorSetup) -> Sender:
    """On the body."""
    signals = {"attitude": signal("attitude", seed=setup.id), "heading": signal("heading", seed=setup.id + 1)}
    return Sender(setup, signals, _inertial)


def _length(told: Mapping[str, Values]) -> Content:
    (length,) = told["range"]
    if length is None:
        return _NOT_BEGUN, [bytes(4)]
    micrometres = round(length * 1e6)
    if not 0 <= micrometres < 0xFFFFFFFF:
        return _OUT_OF_RANGE, [bytes(4)]
    return 0, [pack("<L", micrometres)]


def _inertial(told: Mapping[str, Values]) -> Content:
    roll, pitch, *rates = told["attitude"]
    (yaw,) = told["heading"]
    if yaw is None:
        return _NOT_BEGUN, [bytes(6), bytes(6)]
    angles = [None if angle is None else remainder(angle, tau) for angle in (roll, pitch, yaw)]
    return 0, [pack("<3h", *[_count(one, 1e-4) for one in angles]), pack("<3h", *[_count(one, 1e-3) for one in rates])]


def _count(value: float | None, unit: float) -> int:
    return -32768 if value is None else max(-32767, min(32767, round(value / unit)))


def crc8_j1850(data: bytes) -> int:
    """Bit by bit, as the standard draws it."""
    register = 0xFF
    for byte in data:
        for bit in range(7, -1, -1):
            out = register >> 7 ^ byte >> bit & 1
            register = register << 1 & 0xFF
            if out:
                register ^= 0x1D
    return register ^ 0xFF
