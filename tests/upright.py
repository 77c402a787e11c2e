"""A robot that balances, in virtual time on the plant of its dynamics; its IMU tells what the plant does."""

from collections.abc import Callable
from typing import Any

from gateway.chassis.odd import OddRobot
from gateway.config import parse
from gateway.types import (
    ZERO_TWIST,
    Attitude,
    Event,
    Mode,
    Outputs,
    Reply,
    Request,
    RequestKind,
    SensorSample,
    Twist,
    TwistCommand,
    TwistFrame,
)
from replay.drive.closed_loop import ClosedLoop, Cycle
from replay.sim.plants.odd_dynamics import plant
from tests.world import robot_text

NAME = "odd_balancing"


class Upright:
    """`attended`: somebody holds it while nothing drives it. `can`: its sensors are those of the robot file.

    Else it has an IMU over Zenoh alone, without noise and delay, and `imu` is what that makes of the truth, or None.
    """

    def __init__(
        self,
        *,
        edit: Callable[[str], str] = str,
        attended: bool = True,
        can: bool = False,
        moved_by: Callable[[OddRobot], Any] = plant,
    ) -> None:
        text = edit(robot_text(NAME))
        config = parse(text if can else _over_zenoh(text), NAME)
        assert isinstance(config.robot, OddRobot)
        self.plant: Any = moved_by(config.robot)
        self.plant.attended = attended
        self.loop = ClosedLoop(config, plant=self.plant)
        self.records: list[Cycle] = []
        self.events: list[Event] = []
        self.imu: Callable[[Attitude], Attitude | None] = lambda attitude: attitude
        self._asked = 0
        self._can = can

    @property
    def mode(self) -> Mode:
        return self.loop.engine.mode

    def is_in(self, mode: Mode) -> bool:
        return self.mode is mode

    @property
    def last(self) -> Outputs:
        return self.records[-1][1]

    def told(self) -> list[float]:
        """Torques that act at the joints, N m."""
        return list(self.loop.bus.robot.truth.joint_torques)

    def cycle(self, twist: Twist | None = None, *requests: Request) -> Outputs:
        due_ns = self.loop.next_ns
        told = None if self._can else self.imu(_noisy(self.plant.attitude, len(self.records)))
        commands = [] if twist is None else [TwistCommand("teleop", twist, TwistFrame.BODY, None, due_ns, "test")]
        samples = [] if told is None else [SensorSample("imu", tuple(told), None, due_ns)]
        record = self.loop.cycle(commands=commands, requests=requests, samples=samples)
        self.records.append(record)
        self.events += record[1].events
        return record[1]

    def ask(self, kind: RequestKind, twist: Twist | None = None) -> Reply:
        """The answer to a request in one cycle."""
        self._asked += 1
        outputs = self.cycle(twist, Request(kind, self._asked, self.loop.next_ns))
        return outputs.replies[0] if outputs.replies else Reply(self._asked, True, None)

    def run(
        self, seconds: float, twist: Twist | None = None, *, until: Callable[["Upright"], bool] | None = None
    ) -> float:
        """So many seconds with this twist in each cycle (None: silence), or until then; seconds that it took."""
        first = len(self.records)
        for _ in range(round(seconds * self.loop.config.loop.rate)):
            self.cycle(twist)
            if until is not None and until(self):
                break
        return (len(self.records) - first) / self.loop.config.loop.rate

    def stand_up(self) -> "Upright":
        """From the stand to standing still on its own."""
        self.run(0.3, ZERO_TWIST)
        assert self.ask(RequestKind.STAND_UP, ZERO_TWIST).ok
        self.run(2.0, ZERO_TWIST)
        assert self.is_in(Mode.DRIVE)
        return self


def _noisy(told: Attitude, cycle: int) -> Attitude:
    """Never the very same twice, as of a sensor that works."""
    return told._replace(pitch=told.pitch + (1e-9 if cycle % 2 else 0.0))


def _over_zenoh(text: str) -> str:
    before, _, rest = text.partition("\n[[sensor]]")
    _, _, after = rest.partition("\n[commands]")
    return f'{before}\n[[sensor]]\nname = "imu"\nkind = "attitude"\ntimeout = 0.02\n\n[commands]{after}'
