"""What the simulated world and a simulated sensor say to each other; SI."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from drivers.contract import CanFrame
from gateway.types import Attitude
from replay.sim.controllers.contract import Emission


class Scene(NamedTuple):
    """The truth of one instant. `width`: m, None where the wheels do not go apart; `heading`: rad, all turns."""

    width: float | None
    attitude: Attitude
    heading: float

    def of(self, kind: str) -> tuple[float | None, ...]:
        """What a sensor of this kind (`SensorKind`) would tell of it."""
        return {"range": (self.width,), "attitude": tuple(self.attitude), "heading": (self.heading,)}[kind]


class SensorSetup(NamedTuple):
    """One sensor as it was commissioned."""

    name: str
    bus: str
    id: int
    rate: float  # Hz


class SimulatedSensor(Protocol):
    """One simulated sensor on a bus; it sees time only as an argument."""

    @property
    def setup(self) -> SensorSetup: ...

    @property
    def acknowledges(self) -> bool:
        """Whether it takes part in the bus at all."""
        ...

    def start(self, scene: Scene, now_ns: int) -> None:
        """Power on."""
        ...

    def receive(self, frame: CanFrame, now_ns: int) -> Sequence[Emission]:
        """Take a frame from the bus; the replies."""
        ...

    def poll(self, now_ns: int) -> Sequence[Emission]:
        """Frames that became ready since the last poll, oldest first."""
        ...

    def step(self, scene: Scene, now_ns: int) -> None:
        """Look at the world."""
        ...

    def unplug(self) -> None:
        """Cut its cable."""
        ...

    def plug(self) -> None:
        """Mend it."""
        ...

    def hang(self, hung: bool) -> None:
        """Its program hangs: the frames that it sent last go out again and again."""
        ...

    def stick(self, stuck: bool) -> None:
        """What it measures stands still (a wire that is caught), and it tells that as ever."""
        ...

    def shift(self, kind: str, amount: float) -> None:
        """From now on it tells so much more: of a range, of a heading, of the angles of an attitude."""
        ...
