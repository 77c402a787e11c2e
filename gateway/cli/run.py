"""`drivegate run`: the daemon."""

import logging
import os
import sys
from collections.abc import Mapping
from contextlib import ExitStack
from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from gateway import robot_files
from gateway.cli.endpoints import checked
from gateway.cli.parts import need
from gateway.config import RobotConfig, read
from gateway.core.examination import examine_text
from gateway.edges import log_queue, realtime
from gateway.edges.can_bus import CanBuses
from gateway.edges.estop_latch import EstopFile, EstopLatch
from gateway.edges.signals import EndRequest
from gateway.edges.systemd import Notifier
from gateway.edges.zenoh_link import ZenohLink
from gateway.recording.recorder import NullRecorder, Recorder
from gateway.service import Service
from replay.sim.plants.contract import PlantName

logger = logging.getLogger(__name__)

CLOSE_RECORDING_S = 20.0
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
    endpoint: Annotated[str | None, typer.Option(callback=checked, help="Zenoh endpoint to listen on instead.")] = None,
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
    simulation = None
    if simulate:
        from gateway.cli.simulation import Simulation  # noqa: PLC0415  # a real robot has no use for any of it

        simulation = Simulation(
            config, str(path), plant=plant or PlantName.SIMPLE, friction=friction, faults=fault or [], script=script
        )
    config = _with_overrides(config, out=out, endpoint=endpoint)
    wanted = config.recording.enabled or config.recording.incidents.enabled
    if wanted:
        need("rerun")  # of the recorder, whose process is another one
    notifier = Notifier()
    with ExitStack() as stack:
        # The bus first: a second service for the same motors is refused before it records or announces anything.
        bus = CanBuses(config) if simulation is None else simulation.bus
        stack.callback(bus.close)
        latch = EstopLatch(EstopFile(_state_directory(state, config, os.environ), config.robot.name))
        stack.callback(latch.close)
        told = None if simulation is None else simulation.plant.value
        recorder = Recorder(config, text, str(path), plant=told) if wanted else NullRecorder()
        stack.callback(recorder.close, CLOSE_RECORDING_S)
        link = stack.enter_context(ZenohLink(config, text))
        after_cycle = None if simulation is None else simulation.attach(config, link, stack)
        realtime.enter()  # now that every thread of the link exists
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
