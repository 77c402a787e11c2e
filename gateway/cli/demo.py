"""`drivegate demo`: the whole path once, with the simulated robot: drive, record, verify, look.

The service is a process of its own, commanded by a real Zenoh client over loopback, exactly as a robot would be.
"""

import math
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, NamedTuple

import typer
from rich.progress import BarColumn, Progress, TextColumn
from rich.table import Table

from gateway import robot_files
from gateway.cli.output import complain, console, errors, print_json
from gateway.cli.replay_verify import show, verify_with_progress
from gateway.cli.viewer import view
from gateway.client import Client
from gateway.commander import COMMAND_RATE_HZ, rest, start
from gateway.config import load
from gateway.edges.messages import OdometryMessage, StateMessage, TruthMessage
from gateway.types import ZERO_TWIST, Twist
from replay.compare.verify import Verdict
from replay.sessions.reader import open_session
from replay.sim.plants.contract import PlantName
from replay.sim.robot import chosen_plant

SOURCE = "autonomy"
START_TIMEOUT_S = 30.0
STOP_TIMEOUT_S = 40.0

# What is driven, as shares of the top speed, and for which share of the time: each axis alone, then together.
COURSE: tuple[tuple[str, Twist, float], ...] = (
    ("forward", Twist(0.5, 0.0, 0.0), 0.2),
    ("left", Twist(0.0, 0.5, 0.0), 0.2),
    ("turn", Twist(0.0, 0.0, 0.6), 0.2),
    ("all at once", Twist(0.4, -0.3, 0.4), 0.25),
    ("rest", ZERO_TWIST, 0.15),
)


class Drive(NamedTuple):
    """What the client saw of the drive, at rest at its end."""

    state: StateMessage
    odometry: OdometryMessage
    truth: TruthMessage


def demo(
    *,
    robot: Annotated[str, typer.Option(help="moby, omni4, or a robot file.")] = "moby",
    seconds: Annotated[float, typer.Option(min=5.0, max=600.0, help="Length of the course, s.")] = 20.0,
    plant: Annotated[PlantName, typer.Option(help="By what the robot moves.")] = PlantName.SIMPLE,
    out: Annotated[Path, typer.Option(help="Directory for the session.")] = Path("sessions"),
    viewer: Annotated[bool, typer.Option("--viewer/--no-viewer", help="Show the session afterwards.")] = True,
    json: Annotated[bool, typer.Option("--json", help="Machine-readable result.")] = False,
) -> None:
    """Drive a simulated robot over Zenoh, record it, verify the recording, and show it."""
    path = robot_files.find_bundled(robot)
    config, _ = load(path)
    chosen_plant(config, plant, str(path))  # refused here, in the user's sight, and not by the service
    out.mkdir(parents=True, exist_ok=True)
    top = config.limits.velocity.as_twist()
    endpoint = f"tcp/127.0.0.1:{_free_port()}"
    with _service(path, plant, out, endpoint) as process, Client(config.robot.name, connect=[endpoint]) as client:
        drive = _drive(client, process, top, seconds)
    if process.returncode != 0:
        complain(f"the service ended with exit code {process.returncode}; its log is {out / 'service.log'}")
        raise typer.Exit(1)
    session = Path(str(_recording(drive.state)["session"]))
    verdict = verify_with_progress(open_session(session))
    result = _result(config.robot.name, session, seconds, drive, verdict)
    if json:
        print_json(result)
    else:
        _show(result, verdict)
    if viewer and not json:
        view(session)
    raise typer.Exit(verdict.exit_code)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def _service(path: Path, plant: PlantName, out: Path, endpoint: str) -> Iterator[subprocess.Popen[bytes]]:
    """The gateway with the simulated robot, as a process of its own; ended by SIGTERM, as systemd would."""
    command = [sys.executable, "-m", "gateway", "run", str(path), "--simulate"]
    command += ["--plant", plant.value, "--out", str(out)]
    with (out / "service.log").open("wb") as log:
        process = subprocess.Popen(
            [*command, "--endpoint", endpoint], stderr=log, stdin=subprocess.DEVNULL, env=os.environ
        )
        try:
            yield process
        finally:
            process.send_signal(signal.SIGTERM)
            try:
                process.wait(STOP_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _drive(client: Client, process: subprocess.Popen[bytes], top: Twist, seconds: float) -> Drive:
    if not client.wait_alive(START_TIMEOUT_S) or process.poll() is not None:
        complain("the service did not come up; see service.log")
        raise typer.Exit(1)
    if not start(client, SOURCE):
        state = client.state()
        complain(f"the robot does not start: {state.status.reason if state else 'no state received'}")
        raise typer.Exit(1)
    columns = (TextColumn("{task.description:12}"), BarColumn(), TextColumn("{task.completed:.0f} s"))
    with Progress(*columns, console=errors, disable=not errors.is_terminal, transient=True) as progress:
        task = progress.add_task("driving", total=seconds)
        for name, shares, part in COURSE:
            progress.update(task, description=name)
            twist = Twist(*(share * limit for share, limit in zip(shares, top, strict=True)))
            for _ in _ticks(part * seconds):
                client.send_twist(*twist, source=SOURCE)
                progress.advance(task, 1.0 / COMMAND_RATE_HZ)
    if not rest(client, SOURCE):
        complain("the robot did not come to rest")
        raise typer.Exit(1)
    return _last(client)


def _ticks(seconds: float) -> Iterator[int]:
    """Ticks of the command rate, on absolute deadlines."""
    begin = time.monotonic()
    for tick in range(round(seconds * COMMAND_RATE_HZ)):
        yield tick
        time.sleep(max(0.0, begin + (tick + 1) / COMMAND_RATE_HZ - time.monotonic()))


def _last(client: Client) -> Drive:
    """State, odometry and truth after the robot has come to rest."""
    state, odometry, truth = client.state(), client.odometry(), client.truth()
    if state is None or odometry is None or truth is None:
        complain("no state, odometry or simulated truth was received")
        raise typer.Exit(1)
    return Drive(state, odometry, truth)


def _recording(state: StateMessage) -> dict[str, object]:
    recording = state.extras.get("recording")
    return recording if isinstance(recording, dict) else {}


def _result(name: str, session: Path, seconds: float, drive: Drive, verdict: Verdict) -> dict[str, object]:
    error = math.hypot(drive.odometry.x - drive.truth.x, drive.odometry.y - drive.truth.y)
    return {
        "robot": name,
        "session": str(session),
        "seconds": seconds,
        "cycles": verdict.cycles,
        "overruns": drive.state.status.overruns,
        "dropped_records": drive.state.status.dropped_records,
        "odometry_error_m": round(error, 6),
        "verify": verdict.as_json(),
    }


def _show(result: dict[str, object], verdict: Verdict) -> None:
    table = Table("what", "value", title=f"demo of {result['robot']}")
    for key in ("session", "seconds", "cycles", "overruns", "dropped_records", "odometry_error_m"):
        table.add_row(key, str(result[key]))
    console.print(table)
    show(verdict)
