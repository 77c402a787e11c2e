"""The CAN buses of the simulated robot, in process and in virtual time: the same three calls as the real bus edge.

How this works
--------------
`receive` runs the world up to `now_ns`: per bus the devices' cyclic frames and the host's queue contend for the wire,
then the robot takes its substep. A command acts from the substep after its last bit. The first call sets the origin.
Faults are methods here for the bus and on `robot.devices[name]` for a controller,
on `robot.sensors[name]` for a sensor.
"""

from collections.abc import Sequence
from random import Random

from drivers.contract import CanFrame
from gateway.config import RobotConfig
from gateway.types import BusEvent
from replay.sim.attached_bus import Segment
from replay.sim.controllers.contract import SECOND_NS
from replay.sim.robot import SimulatedRobot
from replay.sim.wire import Stuffing


class SimulatedBus:
    """All buses of a robot file. `robot` is there to look at (`truth`) and to break (`devices`)."""

    def __init__(
        self, config: RobotConfig, robot: SimulatedRobot | None = None, *, stuffing: Stuffing = Stuffing.WORST
    ) -> None:
        self.robot = SimulatedRobot(config) if robot is None else robot
        self._segments = {bus.name: Segment(bus, self.robot.on_bus(bus.name), stuffing) for bus in config.bus}
        self._now_ns: int | None = None
        self._origin_ns = 0

    def receive(self, now_ns: int) -> tuple[list[CanFrame], list[BusEvent]]:
        """Advance the world to now: frames that arrived, stamped and in order of arrival, and what happened."""
        self._advance(now_ns)
        frames = [frame for segment in self._segments.values() for frame in segment.take_frames(now_ns)]
        if len(self._segments) > 1:
            frames.sort(key=lambda frame: frame.received_ns or 0)
        return frames, [event for segment in self._segments.values() for event in segment.take_events()]

    def send(self, frames: Sequence[CanFrame], now_ns: int) -> None:
        """Queue frames from now on; failures are events of the next `receive`."""
        self._advance(now_ns)
        for frame in frames:
            self._segments[frame.bus].send(frame, now_ns)

    def advance(self, now_ns: int) -> None:
        """Let the world go on until now while nobody listens; the first call sets the origin."""
        self._advance(now_ns)

    def reopen(self, now_ns: int) -> None:
        """Another process opens the interfaces now: it hears nothing from before, but that one is down it sees."""
        self._advance(now_ns)
        for segment in self._segments.values():
            segment.reopen(now_ns)

    def close(self) -> None:
        """Nothing to release; the world stands still from here."""

    def drop(self, bus: str, *, received: float = 0.0, sent: float = 0.0, seed: int = 0) -> None:
        """Lose these fractions of the frames to and from the host; wire time passes all the same."""
        self._segments[bus].drop(received=received, sent=sent, random=Random(seed))

    def double(self, bus: str, fraction: float, *, seed: int = 0) -> None:
        """Deliver this fraction of the frames twice."""
        self._segments[bus].double(fraction, Random(seed))

    def fail(self, bus: str) -> None:
        """Take the host's interface down: queue and pending frames are lost, sending fails."""
        self._segments[bus].fail()

    def restore(self, bus: str) -> None:
        """Bring the interface up again."""
        self._segments[bus].restore()

    def delay(self, bus: str, seconds: float) -> None:
        """Every frame to and from the host takes so much longer, as behind a slow adapter."""
        self._segments[bus].delay_ns = round(seconds * SECOND_NS)

    def add_twin(self, motor: str, angle: float) -> None:
        """A second controller on the bus with the id of this motor, its shaft so many rad away at the output."""
        self.remove_twin(motor)
        twin = self.robot.add_twin(motor, angle)
        self._segments[twin.setup.bus].connect(twin)

    def remove_twin(self, motor: str) -> None:
        """Take it off the bus again."""
        twin = self.robot.remove_twin(motor)
        if twin is not None:
            self._segments[twin.setup.bus].disconnect(twin)

    def babble(self, bus: str, frame: CanFrame, *, rate_hz: float) -> None:
        """Foreign traffic: this frame at this rate, arbitrated like any other; rate 0 ends it."""
        self._segments[bus].babble(frame, rate_hz=rate_hz)

    def load(self, bus: str) -> float:
        """Share of the time since the origin in which the bus was busy."""
        elapsed_ns = (self._now_ns or 0) - self._origin_ns
        return self._segments[bus].busy_ns / elapsed_ns if elapsed_ns > 0 else 0.0

    def _advance(self, now_ns: int) -> None:
        time_ns = self._start(now_ns) if self._now_ns is None else self._now_ns
        while time_ns < now_ns:
            step_ns = self.robot.next_step_ns
            time_ns = min(step_ns, now_ns)
            for segment in self._segments.values():
                segment.run(time_ns)
            if time_ns == step_ns:
                self.robot.advance(time_ns)
        self._now_ns = time_ns

    def _start(self, now_ns: int) -> int:
        self._origin_ns = now_ns
        self.robot.start(now_ns)
        return now_ns
