"""The newest sample of every sensor that does not come over CAN, and whether it may be believed.

How this works
--------------
A sample older than its sensor's timeout is none. A heading is only used by its change, from an unknown zero: it counts
anew, so that the pose does not move, with the first sample, after a silence, from another sender (a process that began
anew has another zero) and after a jump. A jump is more than the body can turn: changes beyond what JUMP_FACTOR times
top speed allows add up, and what they stay below that is taken off. So however a sensor errs, in no time does the pose
turn further with it than that speed and JUMP_SLACK allow.
"""

from collections.abc import Sequence
from math import remainder, tau
from typing import Final, NamedTuple

from gateway.config import Sensor
from gateway.types import Attitude, SensorKind, SensorSample, SensorStatus

JUMP_FACTOR: Final = 2.0  # of top speed; a robot that is pushed, or slips, may turn faster than it drives
JUMP_SLACK: Final = 0.1  # rad; source: ours, noise and unsteady delay of a cheap gyro stay far below


class Heading(NamedTuple):
    """Of a gyro, rad. `fresh`: sampled in this cycle. `anew`: it says nothing of the turn since the one before."""

    angle: float
    fresh: bool
    anew: bool


class Readings(NamedTuple):
    """What the sensors tell in one cycle; None is silent, or not there. `ranges`: m, in the order of the robot file."""

    heading: Heading | None = None
    attitude: Attitude | None = None
    ranges: tuple[float | None, ...] = ()


NOTHING: Final = Readings()


class Sensors:
    """One writer, the engine. `top_turn`: of the body, rad/s. `silent`, `jumped`: names, as of the last `read`."""

    def __init__(self, sensors: Sequence[Sensor], *, top_turn: float) -> None:
        self._top_turn = top_turn
        self._kinds = {sensor.name: sensor.kind for sensor in sensors}
        self._timeouts_ns = {sensor.name: round(sensor.timeout * 1e9) for sensor in sensors}
        self._latest: dict[str, SensorSample] = {}
        self._fresh: set[str] = set()  # sampled since the last `read`
        self._anew: set[str] = set()  # of these, whose zero may be another one
        self._excess = 0.0  # rad that the heading changed beyond what the body can turn
        self._jumps: dict[str, int] = {sensor.name: 0 for sensor in sensors}  # since start
        self._new_jumps: list[str] = []
        self.jumped: tuple[str, ...] = ()  # in this cycle
        self.silent: tuple[str, ...] = tuple(self._kinds)

    def receive(self, sample: SensorSample) -> None:
        """Take one valid sample; one of a sensor that is not in the robot file is left out, and so is an older one."""
        name = sample.source
        before = self._latest.get(name)
        if name not in self._kinds or (before is not None and sample.received_ns < before.received_ns):
            return
        if before is None or self._counts_anew(sample, before):
            self._anew.add(name)
        self._fresh.add(name)
        self._latest[name] = sample

    def read(self, now_ns: int) -> Readings:
        """What is known in this cycle."""
        if not self._kinds:
            return NOTHING
        heading: Heading | None = None
        attitude: Attitude | None = None
        ranges: list[float | None] = []
        for name, kind in self._kinds.items():
            sample = self._known(name, now_ns)
            if kind is SensorKind.RANGE:
                ranges.append(None if sample is None else sample.values[0])
            elif sample is not None and kind is SensorKind.ATTITUDE:
                attitude = _attitude(sample.values)
            elif sample is not None:
                heading = Heading(sample.values[0] or 0.0, name in self._fresh, name in self._anew)
        self.silent = tuple([name for name in self._kinds if self._known(name, now_ns) is None])
        self.jumped, self._new_jumps = tuple(self._new_jumps), []
        self._fresh.clear()
        self._anew.clear()
        return Readings(heading, attitude, tuple(ranges))

    def describe(self, now_ns: int) -> tuple[SensorStatus, ...]:
        """Every sensor, in the order of the robot file."""
        return tuple([self._status(name, now_ns) for name in self._kinds])

    def _known(self, name: str, now_ns: int) -> SensorSample | None:
        sample = self._latest.get(name)
        return None if sample is None or now_ns - sample.received_ns > self._timeouts_ns[name] else sample

    def _counts_anew(self, sample: SensorSample, before: SensorSample) -> bool:
        elapsed_ns = sample.received_ns - before.received_ns
        if sample.sender != before.sender or elapsed_ns > self._timeouts_ns[sample.source]:
            return True
        if self._kinds[sample.source] is not SensorKind.HEADING:
            return False
        change = abs(remainder((sample.values[0] or 0.0) - (before.values[0] or 0.0), tau))
        self._excess = max(0.0, self._excess + change - JUMP_FACTOR * self._top_turn * elapsed_ns * 1e-9)
        if self._excess <= JUMP_SLACK:
            return False
        self._excess = 0.0
        self._jumps[sample.source] += 1
        self._new_jumps.append(sample.source)
        return True

    def _status(self, name: str, now_ns: int) -> SensorStatus:
        newest, sample = self._latest.get(name), self._known(name, now_ns)
        age_s = None if newest is None else (now_ns - newest.received_ns) * 1e-9
        values = None if sample is None else sample.values
        return SensorStatus(name, self._kinds[name].value, values, age_s, self._jumps[name])


def _attitude(values: Sequence[float | None]) -> Attitude:
    roll, pitch, roll_rate, pitch_rate, yaw_rate = values
    return Attitude(roll or 0.0, pitch or 0.0, roll_rate, pitch_rate, yaw_rate)
