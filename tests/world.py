"""A robot in virtual time for tests: the real engine, real drivers, simulated controllers and dynamics."""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from gateway.config import RobotConfig, parse
from gateway.core.engine import Engine
from gateway.types import (
    ZERO_TWIST,
    Event,
    Mode,
    Outputs,
    Region,
    Reply,
    Request,
    RequestKind,
    SensorSample,
    Twist,
    TwistCommand,
    TwistFrame,
)
from replay.drive.closed_loop import ClosedLoop, Cycle
from replay.sim.bus import SimulatedBus

ROBOTS = Path(__file__).parent.parent / "deploy" / "robots"
NAMES = ("moby", "omni4")  # one of each kind
BUNDLED = (*NAMES, "omni4_gm6020", "omni4_vesc", "mecanum4", "odd", "odd_balancing")  # where the controllers matter too
Record = Cycle


def robot_text(name: str, *, rate_hz: float = 250.0) -> str:
    """The bundled robot file, with another loop rate if asked."""
    text = (ROBOTS / f"{name}.toml").read_text()
    assert text.count("[loop]\nrate = 250.0") == 1
    return text.replace("[loop]\nrate = 250.0", f"[loop]\nrate = {rate_hz}")


class World:
    """A closed loop that keeps every cycle, and says in one word what tests want of it."""

    def __init__(
        self,
        name: str,
        *,
        rate_hz: float = 250.0,
        edit: Callable[[str], str] = str,
        joint_angles: Mapping[str, float] | None = None,
    ) -> None:
        self.text = edit(robot_text(name, rate_hz=rate_hz))
        self.loop = ClosedLoop(parse(self.text, name), joint_angles=joint_angles)
        self.records: list[Record] = []
        self.events: list[Event] = []

    @property
    def config(self) -> RobotConfig:
        return self.loop.config

    @property
    def bus(self) -> SimulatedBus:
        return self.loop.bus

    @property
    def engine(self) -> Engine:
        return self.loop.engine

    @property
    def period_ns(self) -> int:
        return self.loop.period_ns

    @property
    def now_ns(self) -> int:
        return self.loop.now_ns

    @property
    def last(self) -> Outputs:
        return self.records[-1][1]

    def is_in(self, mode: Mode) -> bool:
        return self.engine.mode is mode

    def cycle(
        self,
        *,
        commands: Iterable[TwistCommand] = (),
        requests: Iterable[Request] = (),
        samples: Iterable[SensorSample] = (),
    ) -> Outputs:
        record = self.loop.cycle(commands=commands, requests=requests, samples=samples)
        self.records.append(record)
        self.events += record[1].events
        return record[1]

    def command(
        self,
        twist: Twist,
        source: str = "teleop",
        frame: TwistFrame = TwistFrame.BODY,
        *,
        stamped: bool = False,
        region: Region = Region.ANY,
    ) -> TwistCommand:
        return TwistCommand(source, twist, frame, None, self.now_ns + self.period_ns, source, stamped, region=region)

    def run(
        self,
        seconds: float,
        twist: Twist | None = None,
        *,
        source: str = "teleop",
        frame: TwistFrame = TwistFrame.BODY,
        stamped: bool = False,
        region: Region = Region.ANY,
        until: Callable[[Outputs], bool] | None = None,
        sensed: Callable[[int], Iterable[SensorSample]] = lambda _: (),
    ) -> Outputs:
        """So many seconds with this twist streamed every 20 ms (None: silence). `sensed`: by the time of the cycle."""
        for index in range(round(seconds * 1e9 / self.period_ns)):
            due = twist is not None and index % 5 == 0
            wanted = twist if due else None
            commands = [] if wanted is None else [self.command(wanted, source, frame, stamped=stamped, region=region)]
            outputs = self.cycle(commands=commands, samples=sensed(self.now_ns + self.period_ns))
            if until is not None and until(outputs):
                break
        return self.last

    def start(self) -> None:
        """Motors answer, a zero command arrives, the robot is ready to drive."""
        self.run(0.3)
        if getattr(self.config.robot, "balance", None) is not None:
            self.request(RequestKind.STAND_UP)
        self.run(3.0, ZERO_TWIST, until=lambda outputs: outputs.mode is Mode.DRIVE)
        assert self.is_in(Mode.DRIVE)

    def request(self, kind: RequestKind) -> Reply | None:
        outputs = self.cycle(requests=[Request(kind, 7, self.now_ns + self.period_ns)])
        return outputs.replies[0] if outputs.replies else None

    def true_speed(self) -> float:
        """How fast the simulated body really moves (m/s plus rad/s, a plain measure of rest)."""
        twist = self.bus.robot.truth.twist
        return abs(twist[0]) + abs(twist[1]) + abs(twist[2])

    def codes(self) -> list[str]:
        return [event.code for event in self.events]
