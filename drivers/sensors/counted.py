"""Sensors with a frame layout of this house: fixed-point values, then a counter and a state, then a checksum.

How this works
--------------
A measurement is one frame or several with ids that follow each other, sent in the order of their ids. All numbers are
little-endian. The last two bytes of each frame are the same for every sensor:

    last but one    low four bits: counter, one more with each measurement, from 15 on to 0
                    high four bits: state, see STATES; with any but 0 the values say nothing
    last            CRC-8 of SAE J1850 (polynomial 0x1D, from 0xFF on, inverted at the end) of the id as four bytes
                    and of the bytes before

The counter tells a sender that hangs from one that measures the same again, and which frames belong together; the id in
the checksum keeps a frame that strayed to another id from being believed. A frame that is repeated, damaged, of a
sensor that says itself that it does not measure, or without its others, is no measurement: the sensor is silent then.
"""

from collections.abc import Mapping
from struct import Struct
from typing import Final, NamedTuple

from drivers.checks import EXTENDED_IDS, STANDARD_IDS
from drivers.contract import CanFrame, DecodedFrame, IdUse, ReceiveFilter, Traffic
from drivers.sensors.contract import Heard, SensorSpec

TRAILER: Final = 2  # bytes
COUNTS: Final = 16
GOOD: Final = 0
STATES: Final = {1: "it has not begun to measure", 2: "out of its range", 3: "it reports a fault of its own"}

_PART: Final = Heard()
_DAMAGED: Final = Heard(flaw="its frames are damaged (wrong checksum)")
_REPEATED: Final = Heard(flaw="its counter stands still")
_INCOMPLETE: Final = Heard(flaw="some of its frames are missing")

_POLYNOMIAL: Final = 0x1D


def _remainder(value: int) -> int:
    for _ in range(8):
        value = value << 1 ^ _POLYNOMIAL if value & 0x80 else value << 1
    return value & 0xFF


_REMAINDERS: Final = bytes([_remainder(value) for value in range(256)])


class Field(NamedTuple):
    """One number of a frame: counts per SI unit, and the count that says that it is not told."""

    name: str
    per_unit: float
    untold: int


class FrameLayout(NamedTuple):
    """One frame: its numbers before the trailer."""

    message: str
    struct: Struct
    fields: tuple[Field, ...]


class Kind(NamedTuple):
    """What is told of one kind: fields of any frame, in the order of the kind; the first `needed` must be told."""

    names: tuple[str, ...]
    needed: int


class Layout(NamedTuple):
    """A sensor: its frames in the order of their ids, and what they tell."""

    frames: tuple[FrameLayout, ...]
    kinds: Mapping[str, Kind]


def checksum(identifier: int, data: bytes) -> int:
    """Of the bytes before it, and of the id."""
    value = 0xFF
    for byte in identifier.to_bytes(4, "little"):
        value = _REMAINDERS[value ^ byte]
    for byte in data:
        value = _REMAINDERS[value ^ byte]
    return value ^ 0xFF


class CountedSensor:
    """Driver of one sensor. Raises ValueError naming sensor, key, value and range."""

    __slots__ = (
        *("_begun_ns", "_bus", "_count", "_counts", "_extended", "_layout", "_needed", "_next", "_places", "_sizes"),
        *("_spec", "_taken", "_values"),
    )

    def __init__(self, layout: Layout, bus: str, spec: SensorSpec) -> None:
        last = spec.id + len(layout.frames) - 1
        if last > EXTENDED_IDS or spec.id <= STANDARD_IDS < last:
            allowed = f"0 to 0x{STANDARD_IDS + 1 - len(layout.frames):X}, or, extended, 0x{STANDARD_IDS + 1:X} to "
            allowed += f"0x{EXTENDED_IDS + 1 - len(layout.frames):X}: it sends {len(layout.frames)} ids from it on"
            raise ValueError(f"sensor {spec.name}: id = {spec.id}: must be {allowed}")
        kind = layout.kinds[spec.kind]
        names = [field.name for frame in layout.frames for field in frame.fields]
        self._layout = layout
        self._bus = bus
        self._spec = spec
        self._extended = spec.id > STANDARD_IDS
        self._places = {spec.id + place: place for place in range(len(layout.frames))}
        self._sizes = tuple([frame.struct.size + TRAILER for frame in layout.frames])
        self._taken = tuple([names.index(name) for name in kind.names])
        self._needed = kind.needed
        self._counts: list[int | None] = [None] * len(layout.frames)  # the last of each frame
        self._next = 0  # place of the frame that goes on with the measurement
        self._count = 0  # of the measurement that was begun
        self._begun_ns = 0
        self._values: list[float | None] = []  # of the frames of it so far

    def receive(self, frame: CanFrame) -> Heard | None:
        """Take one received frame; None when it was not ours."""
        place = self._place(frame)
        received_ns = frame.received_ns
        if place is None or received_ns is None:
            return None
        data = frame.data
        if data[-1] != checksum(frame.id, data[:-1]):
            return _DAMAGED
        state, count = divmod(data[-2], COUNTS)
        if count == self._counts[place]:
            return _REPEATED
        self._counts[place] = count
        if state != GOOD:
            return Heard(flaw=STATES.get(state, f"it reports state {state}, which is none"))
        return self._take(place, count, self._read(place, data), received_ns)

    def decode(self, frame: CanFrame) -> DecodedFrame | None:
        """A frame in words; what the sensor does not tell is left out."""
        place = self._place(frame)
        if place is None or frame.data[-1] != checksum(frame.id, frame.data[:-1]):
            return None
        state, count = divmod(frame.data[-2], COUNTS)
        layout = self._layout.frames[place]
        values = zip(layout.fields, self._read(place, frame.data), strict=True)
        told = tuple([(field.name, value) for field, value in values if value is not None])
        return DecodedFrame(self._spec.name, layout.message, (*told, ("count", count), ("state", state)))

    def traffic(self) -> tuple[Traffic, ...]:
        """Every frame that it sends."""
        named = zip(self._layout.frames, self._sizes, strict=True)
        return tuple(
            [
                Traffic(f"{self._spec.name} {frame.message}", self._extended, size, self._spec.rate)
                for frame, size in named
            ]
        )

    def receive_filters(self) -> tuple[ReceiveFilter, ...]:
        """One for each of its ids."""
        mask = EXTENDED_IDS if self._extended else STANDARD_IDS
        return tuple([ReceiveFilter(identifier, mask, self._extended) for identifier in self._places])

    def ids(self) -> tuple[IdUse, ...]:
        """Every id that it sends."""
        mask = EXTENDED_IDS if self._extended else STANDARD_IDS
        return tuple(
            [IdUse(f"sensor {self._spec.name}", identifier, mask, self._extended) for identifier in self._places]
        )

    def _place(self, frame: CanFrame) -> int | None:
        """Which of its frames this is; None: not one, or not a whole one."""
        place = self._places.get(frame.id)
        if place is None or frame.extended is not self._extended or frame.remote or frame.fd or frame.bus != self._bus:
            return None
        return place if len(frame.data) == self._sizes[place] else None

    def _read(self, place: int, data: bytes) -> list[float | None]:
        layout = self._layout.frames[place]
        counts: tuple[int, ...] = layout.struct.unpack_from(data)
        return [
            None if count == field.untold else count / field.per_unit
            for field, count in zip(layout.fields, counts, strict=True)
        ]

    def _take(self, place: int, count: int, values: list[float | None], received_ns: int) -> Heard:
        """One more frame of a measurement; it itself with the last of them."""
        missing = place != self._next or (place > 0 and count != self._count)
        if place == 0:
            self._count, self._begun_ns, self._values = count, received_ns, []
        elif missing:
            self._next = 0
            return _INCOMPLETE
        self._values += values
        self._next = place + 1
        if self._next < len(self._sizes):
            return _INCOMPLETE if missing else _PART
        self._next = 0
        return self._measurement()

    def _measurement(self) -> Heard:
        told = tuple([self._values[place] for place in self._taken])
        if None in told[: self._needed]:
            return Heard(flaw=f"it does not tell its {self._spec.kind}")
        return Heard(told, None, self._begun_ns)
