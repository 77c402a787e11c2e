"""What `drivegate run --simulate` has instead of a bus, and does besides: the world, its sensors and its faults."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path

from gateway.client import Client
from gateway.config import ConfigError, RobotConfig, parse_as
from gateway.edges import keys
from gateway.edges.messages import QUANTITIES
from gateway.edges.zenoh_link import ZenohLink
from gateway.types import Outputs
from replay.drive.live_faults import LiveFaults, entries_of
from replay.drive.script import ON_THE_COMMAND_LINE, Script, read_script, script_of
from replay.sim.bus import SimulatedBus
from replay.sim.plants.contract import PlantName
from replay.sim.robot import SimulatedRobot, chosen_plant

AfterCycle = Callable[[int, Outputs], None]  # what is to be done last in every cycle


class Simulation:
    """The simulated robot of a robot file on its bus. Raises ConfigError, also for faults that are none of it."""

    def __init__(
        self,
        config: RobotConfig,
        origin: str,
        *,
        plant: PlantName,
        friction: float | None,
        faults: Sequence[str],
        script: Path | None,
    ) -> None:
        """`friction`: of the floor; None: no wheel slips. `faults` and `script`: what is to break from the start on."""
        self.plant = plant
        robot = SimulatedRobot(config, plant=chosen_plant(config, plant, origin))
        if friction is not None:
            robot.set_floor(friction)
        self.bus = SimulatedBus(config, robot)
        self._faults = LiveFaults(self.bus, config, plant)
        if faults:
            self._faults.give(script_of(entries_of(faults)), ON_THE_COMMAND_LINE)
        if script is not None:
            self._faults.give(read_script(script), str(script))

    def attach(self, config: RobotConfig, link: ZenohLink, stack: ExitStack) -> AfterCycle:
        """Takes faults from now on; what is to be called after every cycle."""
        calls = [_truth_teller(self.bus, link), _breaking(self._faults, link)]
        if self.bus.robot.signals:
            client = stack.enter_context(Client(config.robot.name, connect=config.zenoh.listen))
            calls.append(sensing(self.bus.robot, config, client))
        link.answer(keys.FAULT, partial(_take, self._faults))
        return together(*calls)


def together(*calls: AfterCycle) -> AfterCycle:
    """All of them, one after the other."""

    def every(now_ns: int, outputs: Outputs) -> None:
        for call in calls:
            call(now_ns, outputs)

    return every


def sensing(robot: SimulatedRobot, config: RobotConfig, client: Client) -> AfterCycle:
    """Publishes, with every odometry, what the sensors that come over Zenoh would; what there is not, none does."""
    names = {sensor.name: QUANTITIES[sensor.kind] for sensor in config.sensor if sensor.bus is None}

    def sense(now_ns: int, outputs: Outputs) -> None:
        if outputs.odometry is not None:
            for name, signal in robot.signals.items():
                told = dict(zip(names[name], signal.tell(now_ns), strict=True))
                if any(value is not None for value in told.values()):
                    client.sense(name, **told)

    return sense


def _truth_teller(bus: SimulatedBus, link: ZenohLink) -> AfterCycle:
    """Publishes, with every odometry, where the simulated robot really is."""

    def publish_truth(now_ns: int, outputs: Outputs) -> None:
        if outputs.odometry is not None:
            link.publish_truth(bus.robot.truth.pose, now_ns * 1e-9)

    return publish_truth


def _breaking(faults: LiveFaults, link: ZenohLink) -> AfterCycle:
    """Breaks what is due, and tells the recording."""

    def break_due(now_ns: int, outputs: Outputs) -> None:
        mark = faults.step(now_ns, outputs.events)
        if mark is not None:
            link.mark(mark, now_ns)

    return break_due


def _take(faults: LiveFaults, payload: bytes) -> str | None:
    """Why the faults of a payload are not taken; None: they are."""
    try:
        faults.give(parse_as(Script, payload.decode(errors="replace"), "faults"), "faults")
    except ConfigError as error:
        return "; ".join(error.problems)
    return None
