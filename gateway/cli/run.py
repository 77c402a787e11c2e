"""`drivegate run`: the daemon."""

import logging
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from gateway import realtime, robot_files
from gateway.can_bus import BusEdge, CanBuses
from gateway.check import examine
from gateway.config import RobotConfig, load
from gateway.recorder import NullRecorder, Recorder
from gateway.service import Service
from gateway.systemd import Notifier
from gateway.types import Outputs
from gateway.zenoh_link import ZenohLink
from replay.sim.bus import SimulatedBus

CLOSE_RECORDING_S = 20.0
SWITCH_INTERVAL_S = 0.0005  # how long another thread may hold the loop up for the interpreter lock


def run(
    file: Annotated[str, typer.Argument(help="Robot file, or the name of a bundled one.")],
    simulate: Annotated[bool, typer.Option("--simulate", help="Drive the simulated robot, not a bus.")] = False,
    out: Annotated[Path | None, typer.Option(help="Directory for sessions instead of the robot file's.")] = None,
    endpoint: Annotated[str | None, typer.Option(help="Zenoh endpoint to listen on instead.")] = None,
) -> None:
    """Run the drive gateway of one robot until SIGTERM or SIGINT."""
    logging.basicConfig(level=logging.INFO, stream=sys.stderr, format="%(levelname)s %(name)s: %(message)s")
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    path = robot_files.find(file)
    config, text = load(path)
    examine(config, str(path))
    config = _with_overrides(config, out=out, endpoint=endpoint)
    notifier = Notifier()
    recorder = Recorder(config, text, str(path)) if config.recording.enabled else NullRecorder()
    try:
        with ZenohLink(config, text) as link:
            bus, after_cycle = _simulated(config, link) if simulate else (CanBuses(config), None)
            realtime.enter()  # now that every thread of the link exists
            try:
                service = Service(
                    config, bus=bus, link=link, recorder=recorder, notifier=notifier, after_cycle=after_cycle
                )
                code = service.run()
            finally:
                bus.close()
    finally:
        recorder.close(CLOSE_RECORDING_S)
    raise typer.Exit(code)


def _with_overrides(config: RobotConfig, *, out: Path | None, endpoint: str | None) -> RobotConfig:
    """The robot file with the two settings that belong to a call rather than to a robot."""
    recording = config.recording if out is None else config.recording.model_copy(update={"directory": str(out)})
    zenoh = config.zenoh if endpoint is None else config.zenoh.model_copy(update={"listen": [endpoint]})
    return config.model_copy(update={"recording": recording, "zenoh": zenoh})


def _simulated(config: RobotConfig, link: ZenohLink) -> tuple[BusEdge, Callable[[int, Outputs], None]]:
    """The simulated robot on an in-process bus, telling with every odometry where it really is."""
    bus = SimulatedBus(config)

    def publish_truth(now_ns: int, outputs: Outputs) -> None:
        if outputs.odometry is not None:
            link.publish_truth(bus.robot.truth.pose, now_ns * 1e-9)

    return bus, publish_truth
