"""Commands that talk to a running robot: send, watch, stop."""

import time
from typing import Annotated

import typer
from rich.live import Live
from rich.table import Table

from gateway import robot_files
from gateway.cli.output import complain, console, print_json
from gateway.client import DEFAULT_ENDPOINT, Client
from gateway.config import ConfigError, load
from gateway.messages import EventMessage, StateMessage
from gateway.types import Mode

EXIT_NO_ROBOT = 69
EXIT_REFUSED = 1
COMMAND_RATE_HZ = 50.0
ALIVE_TIMEOUT_S = 5.0
START_TIMEOUT_S = 8.0
REST_TIMEOUT_S = 10.0
_EVENTS_SHOWN = 8

RobotName = Annotated[str, typer.Argument(help="Name of the robot, or its robot file.")]
Connect = Annotated[str | None, typer.Option(help="Zenoh endpoint of the robot, e.g. tcp/127.0.0.1:7447.")]


def open_client(name_or_file: str, connect: str | None, *, zero_on_exit: bool = False) -> Client:
    """A client that has found its robot; leaves the command with exit 69 when it does not answer.

    A robot file, given or bundled under that name, tells the endpoint; `connect` overrides it.
    """
    robot, endpoint = name_or_file, connect or DEFAULT_ENDPOINT
    try:
        config, _ = load(robot_files.find(name_or_file))
    except ConfigError:
        if name_or_file.endswith(".toml"):
            raise
    else:
        robot = config.robot.name
        endpoint = connect or (config.zenoh.listen[0] if config.zenoh.listen else DEFAULT_ENDPOINT)
    client = Client(robot, connect=[endpoint], zero_on_exit=zero_on_exit)
    if not client.wait_alive(ALIVE_TIMEOUT_S):
        client.close()
        complain(f"{robot} does not answer on {endpoint}: is `drivegate run` up, and is this its endpoint?")
        raise typer.Exit(EXIT_NO_ROBOT)
    return client


def send(  # noqa: PLR0917  # a command line: each parameter is an option with a name
    name: RobotName,
    vx: Annotated[float, typer.Option(help="Forward, m/s.")] = 0.0,
    vy: Annotated[float, typer.Option(help="Left, m/s.")] = 0.0,
    wz: Annotated[float, typer.Option(help="Counter-clockwise, rad/s.")] = 0.0,
    seconds: Annotated[float, typer.Option("--for", min=0.0, max=3600.0, help="Duration, s.")] = 1.0,
    source: Annotated[str, typer.Option(help="Command source as named in the robot file.")] = "teleop",
    connect: Connect = None,
) -> None:
    """Arm the robot with zero commands, drive one twist for a while, and bring it to rest."""
    with open_client(name, connect, zero_on_exit=True) as client:
        if not start(client, source):
            state = client.state()
            complain(f"{name} does not start: {state.status.reason if state else 'no state received'}")
            raise typer.Exit(EXIT_REFUSED)
        stream(client, source, vx, vy, wz, seconds=seconds)
        rested = rest(client, source)
        odometry = client.odometry()
        if odometry is not None:
            console.print(f"at x {odometry.x:.3f} m, y {odometry.y:.3f} m, theta {odometry.theta:.3f} rad")
        if not rested:
            complain(f"{name} did not come to rest within {REST_TIMEOUT_S:g} s")
            raise typer.Exit(EXIT_REFUSED)


def start(client: Client, source: str, timeout: float = START_TIMEOUT_S) -> bool:
    """Zero commands until the robot drives; True when it does."""
    deadline = time.monotonic() + timeout
    while time.monotonic() < deadline:
        client.send_twist(0.0, 0.0, 0.0, source=source)
        state = client.state()
        if state is not None and state.status.mode in (Mode.DRIVE, Mode.DEGRADED) and state.status.winner == source:
            return True
        time.sleep(1.0 / COMMAND_RATE_HZ)
    return False


def stream(client: Client, source: str, vx: float, vy: float, wz: float, *, seconds: float) -> None:
    """One twist at the command rate for so long."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        client.send_twist(vx, vy, wz, source=source)
        time.sleep(1.0 / COMMAND_RATE_HZ)


def rest(client: Client, source: str) -> bool:
    """Zero commands until the robot stands; True when it does."""
    deadline = time.monotonic() + REST_TIMEOUT_S
    sent = client.state()
    while time.monotonic() < deadline:
        client.send_twist(0.0, 0.0, 0.0, source=source)
        state = client.state()
        still = state is not None and state is not sent and state.status.standing
        if still and state is not None and not state.status.limits_active:
            return True
        time.sleep(1.0 / COMMAND_RATE_HZ)
    return False


def stop(
    name: RobotName,
    reset: Annotated[bool, typer.Option("--reset", help="Release the emergency stop instead.")] = False,
    connect: Connect = None,
    json: Annotated[bool, typer.Option("--json", help="Machine-readable answer.")] = False,
) -> None:
    """Emergency stop, latched; with --reset, ask to release it (refused unless commands are zero and it stands)."""
    with open_client(name, connect) as client:
        if reset:
            ok, reason = client.reset()
        else:
            client.stop()
            stopped = client.wait_for_state(lambda state: state.status.mode is Mode.ESTOP, 3.0)
            ok, reason = stopped is not None, None if stopped else "the robot did not confirm the stop"
    if json:
        print_json({"ok": ok, "reason": reason})
    else:
        console.print("done" if ok else f"refused: {reason}")
    raise typer.Exit(0 if ok else EXIT_REFUSED)


def watch(
    name: RobotName,
    connect: Connect = None,
    once: Annotated[bool, typer.Option("--once", help="Print the state once.")] = False,
) -> None:
    """Live table of a running robot; Ctrl-C ends it."""
    with open_client(name, connect) as client:
        events: list[EventMessage] = []
        if once:
            state = client.wait_for_state(lambda _: True, ALIVE_TIMEOUT_S)
            console.print(_table(name, state, events))
            return
        try:
            with Live(_table(name, None, events), console=console, refresh_per_second=10) as live:
                while True:
                    events = [*events, *client.events()][-_EVENTS_SHOWN:]
                    live.update(_table(name, client.state() if client.alive else None, events))
                    time.sleep(0.1)
        except KeyboardInterrupt:
            return


def _table(name: str, state: StateMessage | None, events: list[EventMessage]) -> Table:
    if state is None:
        return Table(title=f"{name}: no state received")
    status = state.status
    title = f"{name}: {status.mode.value}" + (f" ({status.reason})" if status.reason else "")
    caption = [
        f"pose x {status.pose.x:.3f} m  y {status.pose.y:.3f} m  theta {status.pose.theta:.3f} rad",
        f"winner {status.winner or '-'}  limits {', '.join(status.limits_active) or '-'}  cycle {status.cycle}",
        f"overruns {status.overruns}  refused {status.refused}  frames dropped {status.tx_dropped}",
        *(f"{event.level.value} {event.code}: {event.text}" for event in events),
    ]
    table = Table("motor", "state", "commanded", "measured", "torque", "age", title=title, caption="\n".join(caption))
    for motor in status.motors:
        table.add_row(
            motor.name,
            motor.fault or motor.state,
            _number(motor.commanded, "rad/s"),
            _number(motor.measured, "rad/s"),
            _number(motor.torque, "N m"),
            "-" if motor.age_s is None else f"{motor.age_s * 1e3:.0f} ms",
        )
    return table


def _number(value: float | None, unit: str) -> str:
    return "-" if value is None else f"{value:.2f} {unit}"
