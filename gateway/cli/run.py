"""`drivegate run`: the daemon."""

import logging
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from gateway import robot_files
from gateway.client import Client
from gateway.config import ConfigError, RobotConfig, parse_as, read
from gateway.core.examination import examine_text
from gateway.edges import keys, log_queue, realtime
from gateway.edges.can_bus import CanBuses
from gateway.edges.estop_latch import EstopFile, EstopLatch
from gateway.edges.messages import MAX_WORDS, QUANTITIES
from gateway.edges.signals import EndRequest
from gateway.edges.systemd import Notifier
from gateway.edges.zenoh_link import ZenohLink
from gateway.recording.recorder import NullRecorder, Recorder
from gateway.service import Service
from gateway.types import Outputs
from replay.drive.live_faults import LiveFaults, entries_of
from replay.drive.script import Script, read_script, script_of
from replay.sim.bus import SimulatedBus
from replay.sim.plants.contract import PlantName
from replay.sim.robot import SimulatedRobot, chosen_plant

logger = logging.getLogger(__name__)

CLOSE_RECORDING_S = 20.0
AfterCycle = Callable[[int, Outputs], None]  # what is to be done last in every cycle
SWITCH_INTERVAL_S = 0.0005  # how long another thread may hold the loop up for the interpreter lock


class LogLevel(Enum):
    """Of the lines on standard error, the journal of a service."""

    DEBUG = "debug"
    INFO = "info"
    WARNING = "warning"
    ERROR = "error"


def run(  # noqa: PLR0913  # a command line: each parameter is an option with a name
    file: Annotated[str, typer.Argument(help="Robot file, or the name of an installed or bundled one.")],
    *,
    simulate: Annotated[bool, typer.Option("--simulate", help="Drive the simulated robot, not a bus.")] = False,
    plant: Annotated[
        PlantName | None, typer.Option(help="By what the simulated robot moves; simple unless told.")
    ] = None,
    friction: Annotated[
        float | None,
        typer.Option(min=0.0, max=10.0, help="Of the floor under the simulated wheels; they never slip unless told."),
    ] = None,
    fault: Annotated[
        list[str] | None,
        typer.Option(
            help="Of the simulated robot, in seconds since its start: power_off@5:front_left; see `drivegate fault`."
        ),
    ] = None,
    script: Annotated[
        Path | None, typer.Option(help="The same from a TOML file, with [[at]] as in a scenario.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Directory for sessions instead of the robot file's.")] = None,
    state: Annotated[
        Path | None,
        typer.Option(help="Directory that keeps a latched emergency stop; else $STATE_DIRECTORY, else that of --out."),
    ] = None,
    endpoint: Annotated[str | None, typer.Option(help="Zenoh endpoint to listen on instead.")] = None,
    log_level: Annotated[
        LogLevel, typer.Option("--log-level", help="The least that is logged; `debug` tells of every library.")
    ] = LogLevel.INFO,
) -> None:
    """Run the drive gateway of one robot until SIGTERM, or any other signal that would end it."""
    of_simulated = (("--plant", plant), ("--friction", friction), ("--fault", fault), ("--script", script))
    for name, value in of_simulated:
        if value is not None and not simulate:
            raise typer.BadParameter("belongs to --simulate", param_hint=name)
    ending = EndRequest()
    ending.listen()
    log_queue.take_over(
        level=logging.getLevelNamesMapping()[log_level.value.upper()], layout="%(levelname)s %(name)s: %(message)s"
    )
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    found = robot_files.locate(file)
    path = found.path
    text = read(path)
    config, _ = examine_text(text, str(path))
    logger.info("robot file: %s", found.words)
    if (unlike := robot_files.unlike(path, config.robot.name)) is not None:
        logger.warning("%s", unlike)
    simulated = _simulated(config, plant or PlantName.SIMPLE, str(path), friction) if simulate else None
    wanted_faults = _scripts(fault or [], script)
    config = _with_overrides(config, out=out, endpoint=endpoint)
    notifier = Notifier()
    with ExitStack() as stack:
        # The bus first: a second service for the same motors is refused before it records or announces anything.
        bus = CanBuses(config) if simulated is None else SimulatedBus(config, simulated)
        stack.callback(bus.close)
        latch = EstopLatch(EstopFile(_state_directory(state, config, os.environ), config.robot.name))
        stack.callback(latch.close)
        told = None if simulated is None else (plant or PlantName.SIMPLE).value
        wanted = config.recording.enabled or config.recording.incidents.enabled
        recorder = Recorder(config, text, str(path), plant=told) if wanted else NullRecorder()
        stack.callback(recorder.close, CLOSE_RECORDING_S)
        link = stack.enter_context(ZenohLink(config, text))
        realtime.enter()  # now that every thread of the link exists
        after_cycle = None
        if isinstance(bus, SimulatedBus):
            faults = LiveFaults(bus, config, plant or PlantName.SIMPLE)
            for origin, given in wanted_faults:
                faults.give(given, origin)
            after_cycle = _together(*_of_simulation(bus, config, link, faults, stack))
        service = Service(
            config,
            bus=bus,
            link=link,
            recorder=recorder,
            latch=latch,
            notifier=notifier,
            ending=ending,
            after_cycle=after_cycle,
        )
        code = service.run()
    raise typer.Exit(code)


def _simulated(config: RobotConfig, plant: PlantName, origin: str, friction: float | None) -> SimulatedRobot:
    robot = SimulatedRobot(config, plant=chosen_plant(config, plant, origin))
    if friction is not None:
        robot.set_floor(friction)
    return robot


def _with_overrides(config: RobotConfig, *, out: Path | None, endpoint: str | None) -> RobotConfig:
    """The robot file with the two settings that belong to a call rather than to a robot."""
    recording = config.recording if out is None else config.recording.model_copy(update={"directory": str(out)})
    zenoh = config.zenoh if endpoint is None else config.zenoh.model_copy(update={"listen": [endpoint]})
    return config.model_copy(update={"recording": recording, "zenoh": zenoh})


def _state_directory(option: Path | None, config: RobotConfig, environment: Mapping[str, str]) -> Path:
    """Systemd's StateDirectory= may name several, the first counts."""
    if option is not None:
        return option
    given, _, _ = environment.get("STATE_DIRECTORY", "").partition(":")
    return Path(given or config.recording.directory)


def _scripts(words: Sequence[str], path: Path | None) -> list[tuple[str, Script]]:
    """What is to break, with who says so. Raises ConfigError."""
    said = [("--fault", script_of(entries_of(words)))] if words else []
    return said if path is None else [*said, (str(path), read_script(path))]


def _together(*calls: AfterCycle) -> AfterCycle:
    def every(now_ns: int, outputs: Outputs) -> None:
        for call in calls:
            call(now_ns, outputs)

    return every


def _of_simulation(
    bus: SimulatedBus, config: RobotConfig, link: ZenohLink, faults: LiveFaults, stack: ExitStack
) -> Iterator[AfterCycle]:
    """What a simulated robot does besides, and a real one never."""
    yield _truth_teller(bus, link)
    if bus.robot.signals:
        yield _sensing(bus.robot, config, stack.enter_context(Client(config.robot.name, connect=config.zenoh.listen)))
    link.answer(keys.FAULT, partial(_take_faults, faults))
    yield _breaking(faults, link)


def _take_faults(faults: LiveFaults, payload: bytes) -> str | None:
    """Why they are not taken; None: they are."""
    try:
        faults.give(parse_as(Script, payload.decode(errors="replace"), "faults"), "faults")
    except ConfigError as error:
        return "; ".join(error.problems)
    return None


def _breaking(faults: LiveFaults, link: ZenohLink) -> AfterCycle:
    """Breaks what is due, and tells the recording."""

    def break_due(now_ns: int, _: Outputs) -> None:
        told = faults.step(now_ns)
        if told is not None:
            link.mark(f"simulated: {told}"[:MAX_WORDS], now_ns)

    return break_due


def _truth_teller(bus: SimulatedBus, link: ZenohLink) -> AfterCycle:
    """Publishes, with every odometry, where the simulated robot really is."""

    def publish_truth(now_ns: int, outputs: Outputs) -> None:
        if outputs.odometry is not None:
            link.publish_truth(bus.robot.truth.pose, now_ns * 1e-9)

    return publish_truth


def _sensing(robot: SimulatedRobot, config: RobotConfig, client: Client) -> AfterCycle:
    """Publishes, with every odometry, what the sensors that come over Zenoh would; what there is not, none does."""
    names = {sensor.name: QUANTITIES[sensor.kind] for sensor in config.sensor if sensor.bus is None}

    def sense(now_ns: int, outputs: Outputs) -> None:
        if outputs.odometry is not None:
            for name, signal in robot.signals.items():
                told = dict(zip(names[name], signal.tell(now_ns), strict=True))
                if any(value is not None for value in told.values()):
                    client.sense(name, **told)

    return sense
