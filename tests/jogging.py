"""A jog in virtual time on a simulated robot whose wheels are off the ground, and what of it was true."""

from collections.abc import Callable
from dataclasses import dataclass, field
from math import pi

from drivers.contract import CanFrame
from gateway.config import RobotConfig
from gateway.setup.jog import SILENCE_NS, Jog, Outcome, Phase
from replay.sim.bus import SimulatedBus
from replay.sim.robot import SimulatedRobot
from tests.lifted import LiftedPlant

MS = 1_000_000
CYCLE_NS = 4 * MS
FIRST_NS = 1_000_000_000_000
QUARTER_TURN = pi / 2
ENDS_NS = 200 * MS
LONGEST_NS = 20_000 * MS


@dataclass
class Bench:
    """The true robot (`config`) and its bus; `given`: what the person wrote."""

    config: RobotConfig
    now_ns: int = FIRST_NS
    sent: list[tuple[int, CanFrame]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.plant = LiftedPlant(self.config)
        self.bus = SimulatedBus(self.config, SimulatedRobot(self.config, plant=self.plant))
        self.bus.receive(self.now_ns)

    def cycle(self) -> list[CanFrame]:
        """What was received in one more cycle."""
        self.now_ns += CYCLE_NS
        return self.bus.receive(self.now_ns)[0]

    def send(self, frames: list[CanFrame]) -> None:
        self.sent += [(self.now_ns, frame) for frame in frames]
        self.bus.send(frames, self.now_ns)

    def wait(self, seconds: float) -> None:
        for _ in range(round(seconds * 1e9 / CYCLE_NS)):
            self.cycle()


@dataclass
class Ride:
    """What became of a jog. `ways`: rad of the true output since the start, in the direction asked for, by time."""

    outcome: Outcome
    phases: list[tuple[int, Phase]]
    ways: list[tuple[int, float, float]]  # ns, rad, rad that were asked for by then

    def began(self, phase: Phase) -> int | None:
        return next((at for at, one in self.phases if one is phase), None)

    def furthest(self) -> float:
        """Rad beyond what was asked for, either way."""
        return max(max(way - asked, -way) for _, way, asked in self.ways)


def ride(
    bench: Bench,
    jog: Jog,
    motor: str,
    disturb: Callable[[Bench, Phase, int], None] = lambda _bench, _phase, _gone_ns: None,
    *,
    coasting: float = 1.0,
) -> Ride:
    """To the end of the jog and on. `motor`: that truly turns; `disturb`: called in every cycle."""
    place = list(bench.bus.robot.devices).index(motor)
    begun_ns, start = bench.now_ns, bench.bus.robot.truth.joint_angles[place]
    phases: list[tuple[int, Phase]] = []
    ways: list[tuple[int, float, float]] = []

    def look() -> None:
        way = (bench.bus.robot.truth.joint_angles[place] - start) * jog._sign
        asked = 0.0
        if jog.phase is Phase.TURN:
            asked = jog._planned(jog._gone(bench.now_ns))[1]
        elif any(phase is Phase.TURN for _, phase in phases):
            asked = ways[-1][2]
        ways.append((bench.now_ns, way, asked))

    while not jog.finished:
        assert bench.now_ns - begun_ns < LONGEST_NS, jog.phase
        disturb(bench, jog.phase, bench.now_ns - begun_ns)
        frames = bench.cycle()
        bench.send(jog.step(frames, bench.now_ns))
        if not phases or phases[-1][1] is not jog.phase:
            phases.append((bench.now_ns, jog.phase))
        look()
    for _ in range(round(coasting * 1e9 / CYCLE_NS)):
        bench.cycle()
        look()
    assert jog.outcome is not None
    return Ride(jog.outcome, phases, ways)


assert SILENCE_NS < ENDS_NS
