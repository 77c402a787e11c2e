"""The newest sample of every sensor, and whether it may be believed.

How this works
--------------
A sample comes over Zenoh, or from the driver of a sensor on a bus, which tells of its other frames why they are none.
A sample older than its sensor's timeout is none. A heading is only used by its change, from an unknown zero: it counts
anew, so that the pose does not move, with the first sample, after a silence, from another sender (a process that began
anew has another zero) and after a jump. A jump is more than the body can turn: changes beyond what JUMP_FACTOR times
top speed allows add up, and what they stay below that is taken off. So however a sensor errs, in no time does the pose
turn further with it than that speed and JUMP_SLACK allow.
An attitude that jumps, by more than LEAN_RATE and JUMP_SLACK, is not believed until it has gone on for its timeout
without a jump: a reading that comes and goes never is, one that has another zero since is.
"""

from collections.abc import Sequence
from math import remainder, tau
from typing import Final, NamedTuple

from drivers.contract import CanFrame
from gateway.config import Sensor
from gateway.core.assembly import Port
from gateway.types import Attitude, SensorKind, SensorSample, SensorStatus

LEANS: Final = 2  # of the numbers of an attitude: roll and pitch
JUMP_FACTOR: Final = 2.0  # of top speed; a robot that is pushed, or slips, may turn faster than it drives
LEAN_RATE: Final = 10.0  # rad/s; source: ours, a body that is hit hard, and falls, leans slower
NEVER_HEARD: Final = "never heard"
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
    """One writer, the engine. `top_turn`: of the body, rad/s. As of the last `read`: who is `silent` and why, `jumped`.

    `ports`: of the sensors on a bus.
    """

    def __init__(self, sensors: Sequence[Sensor], *, top_turn: float, ports: Sequence[Port] = ()) -> None:
        self.ports = tuple(ports)  # their drivers own state: not final, so that a snapshot takes and gives it
        ids = {use.id for port in ports for use in port.driver.ids()}
        self._listeners = {
            at: tuple([port for port in ports if at in [use.id for use in port.driver.ids()]]) for at in ids
        }
        self._flaws: dict[str, str] = {}  # why the frames of a sensor since its last sample were none
        self._jumped_ns: dict[str, int] = {}  # of attitudes, the last jump
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
        self.silent: dict[str, str] = dict.fromkeys(self._kinds, NEVER_HEARD)

    def hear(self, frames: Sequence[CanFrame]) -> None:
        """Take the frames of sensors on a bus; what belongs to nobody is left out."""
        for frame in frames:
            for port in self._listeners.get(frame.id, ()):
                heard = port.driver.receive(frame)
                if heard is None:
                    continue
                if heard.values is not None:
                    self._flaws.pop(port.name, None)
                    self.receive(SensorSample(port.name, heard.values, None, heard.measured_ns))
                elif heard.flaw is not None:
                    self._flaws[port.name] = heard.flaw

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
        self.silent = {name: self._why(name, now_ns) for name in self._kinds if self._known(name, now_ns) is None}
        self.jumped, self._new_jumps = tuple(self._new_jumps), []
        self._fresh.clear()
        self._anew.clear()
        return Readings(heading, attitude, tuple(ranges))

    def describe(self, now_ns: int) -> tuple[SensorStatus, ...]:
        """Every sensor, in the order of the robot file."""
        return tuple([self._status(name, now_ns) for name in self._kinds])

    def _known(self, name: str, now_ns: int) -> SensorSample | None:
        sample, timeout_ns = self._latest.get(name), self._timeouts_ns[name]
        if sample is None or now_ns - sample.received_ns > timeout_ns:
            return None
        jumped_ns = self._jumped_ns.get(name)
        return None if jumped_ns is not None and sample.received_ns - jumped_ns <= timeout_ns else sample

    def _why(self, name: str, now_ns: int) -> str:
        """Why nothing of this sensor is believed."""
        sample = self._latest.get(name)
        if sample is not None and now_ns - sample.received_ns <= self._timeouts_ns[name]:
            return "it jumped"
        return self._flaws.get(name, NEVER_HEARD if sample is None else "silent")

    def _counts_anew(self, sample: SensorSample, before: SensorSample) -> bool:
        elapsed_ns = sample.received_ns - before.received_ns
        if sample.sender != before.sender or elapsed_ns > self._timeouts_ns[sample.source]:
            return True
        if self._kinds[sample.source] is SensorKind.ATTITUDE:
            self._watch_lean(sample, before, elapsed_ns)
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

    def _watch_lean(self, sample: SensorSample, before: SensorSample, elapsed_ns: int) -> None:
        most = JUMP_SLACK + LEAN_RATE * elapsed_ns * 1e-9
        for now, then in zip(sample.values[:LEANS], before.values[:LEANS]):
            if abs(remainder((now or 0.0) - (then or 0.0), tau)) > most:
                self._jumped_ns[sample.source] = sample.received_ns
                self._jumps[sample.source] += 1
                self._new_jumps.append(sample.source)
                return

    def _status(self, name: str, now_ns: int) -> SensorStatus:
        newest, sample = self._latest.get(name), self._known(name, now_ns)
        age_s = None if newest is None else (now_ns - newest.received_ns) * 1e-9
        values = None if sample is None else sample.values
        kind, reason = self._kinds[name].value, None if sample is not None else self._why(name, now_ns)
        return SensorStatus(name, kind, values, age_s, self._jumps[name], reason)


def _attitude(values: Sequence[float | None]) -> Attitude:
    roll, pitch, roll_rate, pitch_rate, yaw_rate = values
    return Attitude(roll or 0.0, pitch or 0.0, roll_rate, pitch_rate, yaw_rate)
