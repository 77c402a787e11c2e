"""`drivegate sim`: the simulated robot as a process of its own, on the CAN interfaces of its robot file."""

import json
import logging
import signal
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from threading import Event, Thread
from typing import Annotated

import typer
import zenoh

from gateway import robot_files
from gateway.cli.endpoints import checked
from gateway.client import MAX_MESSAGE_SIZE
from gateway.config import ConfigError, RobotConfig, load
from gateway.core.examination import examine
from gateway.edges.messages import encode_truth
from gateway.edges.python_can import can
from gateway.edges.zenoh_session import Receivers, open_zenoh
from replay.sim.controllers.contract import SECOND_NS
from replay.sim.controllers.odrive import SimulatedODrive
from replay.sim.network_device import MotorsInterface
from replay.sim.plants.contract import PlantName
from replay.sim.robot import chosen_plant
from replay.sim.server import SimulationServer

TRUTH_RATE_HZ = 20.0
_ENDING = {signal.SIGTERM, signal.SIGINT}


def sim(  # noqa: PLR0917  # a command line: each parameter is an option with a name
    file: Annotated[str, typer.Argument(help="Robot file, or the name of an installed or bundled one.")],
    channel: Annotated[str | None, typer.Option(help="CAN interface instead of the robot file's, e.g. vcan0.")] = None,
    tick: Annotated[int, typer.Option(min=1, max=20, help="Exchange frames every so many ms.")] = 1,
    plant: Annotated[PlantName, typer.Option(help="By what the robot moves.")] = PlantName.SIMPLE,
    flat_endpoints: Annotated[
        Path | None, typer.Option(help="Write flat_endpoints.json of its ODrives here, for `drivegate setup prepare`.")
    ] = None,
    endpoint: Annotated[
        str | None,
        typer.Option(
            callback=checked, help="Tell on this Zenoh endpoint where the robot really is (key `<robot>/truth`)."
        ),
    ] = None,
) -> None:
    """Be the motors and the robot on a (virtual) CAN interface until SIGTERM or SIGINT. Never on a real robot's bus.

    Survives the interface going down, up, away and back. Use a larger --tick where system calls are slow.
    """
    logging.basicConfig(level=logging.INFO, stream=sys.stderr, format="%(levelname)s %(name)s: %(message)s")
    path = robot_files.find(file)
    config, _ = load(path)
    examine(config, str(path))
    moving = chosen_plant(config, plant, str(path))
    ended = Event()
    signal.pthread_sigmask(signal.SIG_BLOCK, _ENDING)
    Thread(target=_await_signal, args=(ended,), name="signals", daemon=True).start()
    with ExitStack() as stack:
        buses = _interfaces(config, channel, stack)
        server = SimulationServer(config, buses, tick_ns=tick * SECOND_NS // 1000, plant=moving)
        if flat_endpoints is not None:
            flat_endpoints.write_text(_flat(server, str(path)), encoding="utf-8")
        if endpoint is not None:
            stack.enter_context(_telling(server, config.robot.name, endpoint, ended))
        server.run(ended)


def _flat(server: SimulationServer, origin: str) -> str:
    """Raises ConfigError where there is no ODrive of firmware 0.6."""
    for device in server.robot.devices.values():
        if isinstance(device, SimulatedODrive) and device.setup.variant == "0.6":
            return json.dumps(device.flat_endpoints(), indent=1)
    raise ConfigError(origin, ["--flat-endpoints: has no motor with an odrive of variant 0.6"])


def _await_signal(ended: Event) -> None:
    """In a thread: a handler that sets the event may interrupt the very wait for it, which then never ends."""
    signal.sigwait(_ENDING)
    ended.set()


def _interfaces(config: RobotConfig, channel: str | None, stack: ExitStack) -> dict[str, can.BusABC]:
    """The motors' end of every bus of the robot file; one channel for all of them if it is given."""
    return {
        bus.name: stack.enter_context(
            MotorsInterface(
                channel or bus.channel, [motor for motor in config.motor if motor.bus == bus.name], fd=bus.fd
            )
        )
        for bus in config.bus
    }


@contextmanager
def _telling(server: SimulationServer, robot: str, endpoint: str, ended: Event) -> Iterator[None]:
    """Publishes the true pose from a thread of its own."""
    session = open_zenoh(listen=[endpoint], connect=[], max_message_size=MAX_MESSAGE_SIZE)
    publisher = session.declare_publisher(f"{robot}/truth", congestion_control=zenoh.CongestionControl.DROP)
    receivers = Receivers(session)

    def tell(_: int) -> None:
        truth = server.robot.truth
        publisher.put(encode_truth(truth.pose, truth.time_ns / SECOND_NS))

    receivers.pump("truth", _ticks(ended), tell)
    try:
        yield
    finally:
        ended.set()
        receivers.close()


def _ticks(ended: Event) -> Iterator[int]:
    while not ended.wait(1.0 / TRUTH_RATE_HZ):
        yield 0
