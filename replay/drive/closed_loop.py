"""A drive in virtual time: the real engine and its drivers, the simulated controllers, the simulated world.

How this works
--------------
Cycles lie on a grid of the loop's period. A pause leaves out cycles of the grid while the world goes on: frames wait
for the loop as they would in a socket, and the missed cycles count as overruns. A restart is a pause too, but what
begins after it is a new engine that knows nothing: frames from before it are gone, and only the latch of an emergency
stop, which outlives the process, reaches it as a request in its first cycle.
"""

from collections.abc import Iterable, Mapping, Sequence

from gateway.config import RobotConfig
from gateway.core.engine import Engine
from gateway.types import Inputs, Mode, Outputs, Request, RequestKind, SensorSample, TwistCommand
from replay.sim.bus import SimulatedBus
from replay.sim.plants.contract import Plant
from replay.sim.robot import SimulatedRobot

FIRST_NS = 1_000_000_000_000  # the first cycle; far from zero, as a monotonic clock is
Cycle = tuple[Inputs, Outputs]


class ClosedLoop:
    """Steps engine and world together; `bus` is there to break, `bus.robot.truth` to look at.

    `joint_angles`: where motors stand at the start, rad at the output from the joint's zero. `plant`: instead of the
    one of this chassis kind; `commissioned`: as of `SimulatedRobot`.
    """

    def __init__(
        self,
        config: RobotConfig,
        *,
        first_ns: int = FIRST_NS,
        joint_angles: Mapping[str, float] | None = None,
        plant: Plant | None = None,
        commissioned: Sequence[float] | None = None,
    ) -> None:
        self.config = config
        robot = SimulatedRobot(config, joint_angles, plant=plant, commissioned=commissioned)
        self.bus = SimulatedBus(config, robot)
        self.engine = Engine(config)
        self.period_ns = round(1e9 / config.loop.rate)
        self.next_ns = first_ns
        self._number = 0
        self._overruns = 0
        self._latched = False  # an emergency stop outlived the engine before this one
        self._opening_ns: int | None = None  # when a new process began to listen

    @property
    def now_ns(self) -> int:
        """When the last cycle was due."""
        return self.next_ns - self.period_ns

    def cycle(
        self,
        *,
        commands: Iterable[TwistCommand] = (),
        requests: Iterable[Request] = (),
        samples: Iterable[SensorSample] = (),
    ) -> Cycle:
        """The next cycle of the grid, with what came in since the one before."""
        now_ns = self.next_ns
        if self._opening_ns is not None:
            self.bus.reopen(self._opening_ns)
            self._opening_ns = None
        frames, bus_events = self.bus.receive(now_ns)
        inputs = Inputs(
            cycle=self._number,
            now_ns=now_ns,
            frames=tuple(frames),
            commands=tuple(commands),
            requests=(*self._remembered(now_ns), *requests),
            bus_events=tuple(bus_events),
            samples=tuple(samples),
            overruns=self._overruns,
        )
        outputs = self.engine.step(inputs)
        self.bus.send(outputs.frames, now_ns)
        self.next_ns = now_ns + self.period_ns
        self._number += 1
        return inputs, outputs

    def pause(self, until_ns: int) -> None:
        """No cycle before then; the loop does not know why."""
        missed = max(0, -((self.next_ns - until_ns) // self.period_ns))
        self.next_ns += missed * self.period_ns
        self._overruns += missed

    def restart(self, until_ns: int) -> None:
        """The process dies, without a last frame, and a new one opens the buses then; nothing of it is left over."""
        self._latched = self._latched or self.engine.mode is Mode.ESTOP
        self.pause(until_ns)
        self._overruns = self._number = 0
        self.engine = Engine(self.config)
        self._opening_ns = until_ns

    def _remembered(self, now_ns: int) -> tuple[Request, ...]:
        if not self._latched:
            return ()
        self._latched = False
        return (Request(RequestKind.ESTOP, 0, now_ns),)
