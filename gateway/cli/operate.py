"""Commands that talk to a running robot: send, watch, events, stop."""

import time
from collections.abc import Iterator, Sequence
from typing import Annotated, NamedTuple

import typer
from rich.live import Live
from rich.table import Table

from gateway import robot_files
from gateway.cli.endpoints import checked
from gateway.cli.output import complain, console, note, print_json
from gateway.client import DEFAULT_ENDPOINT, Client
from gateway.commander import objection, rest, start, stream, unrested
from gateway.config import ConfigError, load
from gateway.edges.messages import EventMessage, ResetAnswer, StateMessage, encode_twist, state_document
from gateway.types import ZERO_TWIST, Level, Mode, Pose, SensorStatus, SourceStatus, Status, Twist

EXIT_NO_ROBOT = 69
EXIT_REFUSED = 1
NOTICE_S = 0.5  # after which a command says for whom it waits
ALIVE_TIMEOUT_S = 5.0
STOP_TIMEOUT_S = 3.0
STALE_S = 0.5  # a state that old says nothing of now
_EVENTS_SHOWN = 8

RobotName = Annotated[str, typer.Argument(help="Name of the robot, or its robot file.")]
Connect = Annotated[
    str | None, typer.Option(callback=checked, help="Zenoh endpoint of the robot, e.g. tcp/127.0.0.1:7447.")
]


def open_client(name_or_file: str, connect: str | None, *, zero_on_exit: bool = False) -> Client:
    """A client that has found its robot; says soon that it waits, and leaves the command with exit 69 when nobody came.

    A robot file, given, installed or bundled under that name, tells the endpoint; `connect` overrides it. Of a name it
    is said which file that was.
    """
    target = locate(name_or_file, connect)
    if target.told:
        note(f"{target.robot}: {target.source}")
    client = Client(target.robot, connect=[target.endpoint], zero_on_exit=zero_on_exit)
    if client.wait_alive(NOTICE_S):
        return client
    others = client.others_alive()
    there = f"; there answers {', '.join(others)}" if others else ""
    note(f"nobody answers as {target.robot} on {target.endpoint} yet{there}: waiting up to {ALIVE_TIMEOUT_S:g} s")
    if client.wait_alive(ALIVE_TIMEOUT_S):
        return client
    others = client.others_alive()
    client.close()
    complain(unanswered(target, others))
    raise typer.Exit(EXIT_NO_ROBOT)


class Target(NamedTuple):
    """Whom to talk to, where, and in words who says so; `told`: the caller did not, so that it is worth a line."""

    robot: str
    endpoint: str
    source: str
    told: bool = False


def locate(name_or_file: str, connect: str | None) -> Target:
    """Raises ConfigError for a robot file that is given and wrong; one that was looked up must not keep a stop away."""
    try:
        found = robot_files.locate(name_or_file)
    except ConfigError:
        if name_or_file.endswith(".toml"):
            raise
        source = "as given by --connect" if connect else "of no robot file, so the usual one"
        return Target(name_or_file, connect or DEFAULT_ENDPOINT, source)
    given = found.place is robot_files.Place.GIVEN
    try:
        config, _ = load(found.path)
    except ConfigError as error:
        if given:
            raise
        source = f"the usual endpoint, because of {found.words} {error.problems[0]}"
        return Target(name_or_file, connect or DEFAULT_ENDPOINT, source, told=True)
    listen = config.zenoh.listen
    source = f"as given by --connect, of {found.words}" if connect else f"zenoh.listen of {found.words}"
    return Target(config.robot.name, connect or (listen[0] if listen else DEFAULT_ENDPOINT), source, told=not given)


def unanswered(target: Target, others: Sequence[str]) -> str:
    """That nobody answers, and what to pass. `others`: robots that do answer there."""
    there = f"; there answers {', '.join(others)}: give that as NAME, if it is meant" if others else ""
    return (
        f"{target.robot} does not answer on {target.endpoint} ({target.source}){there}. Is `drivegate run` up? If it "
        "listens elsewhere, pass --connect tcp/ADDRESS:PORT (its zenoh.listen), or its robot file as NAME"
    )


def send(  # noqa: PLR0913, PLR0917  # a command line: each parameter is an option with a name
    name: RobotName,
    vx: Annotated[float, typer.Option(help="Forward, m/s.")] = 0.0,
    vy: Annotated[float, typer.Option(help="Left, m/s.")] = 0.0,
    wz: Annotated[float, typer.Option(help="Counter-clockwise, rad/s.")] = 0.0,
    seconds: Annotated[float, typer.Option("--for", min=0.0, max=3600.0, help="Duration, s.")] = 1.0,
    source: Annotated[str, typer.Option(help="Command source as named in the robot file.")] = "teleop",
    width: Annotated[float | None, typer.Option(help="To which the wheels go apart, m.")] = None,
    width_rate: Annotated[float | None, typer.Option(help="By which they do, m/s; never beside a width.")] = None,
    connect: Connect = None,
    json: Annotated[bool, typer.Option("--json", help="Machine-readable result.")] = False,
) -> None:
    """Arm the robot with zero commands, drive one twist for a while, and bring it to rest."""
    twist = Twist(vx, vy, wz)
    try:
        encode_twist(twist, width=width, width_rate=width_rate)
    except ValueError as error:
        complain(str(error))
        raise typer.Exit(EXIT_REFUSED) from None
    with open_client(name, connect, zero_on_exit=True) as client:
        reason, limits = _send(client, source, twist, seconds, width=width, width_rate=width_rate)
        refusals = list(dict.fromkeys(event.text for event in client.events() if is_refusal(event, source)))
        odometry = client.odometry()
    pose = None if odometry is None else Pose(odometry.x, odometry.y, odometry.theta)
    if json:
        found = {"ok": reason is None, "reason": reason, "limits_active": limits, "refusals": refusals}
        print_json(found | {"pose": pose and pose._asdict()})
    elif pose is not None:
        console.print(f"at x {pose.x:z.3f} m, y {pose.y:z.3f} m, theta {pose.theta:z.3f} rad")
        if limits:
            console.print(f"held back to its end by: {', '.join(limits)}", highlight=False)
    for refusal in refusals:
        complain(f"refused: {refusal}")
    if reason is not None:
        complain(f"{name}: {reason}")
        raise typer.Exit(EXIT_REFUSED)


def _send(
    client: Client, source: str, twist: Twist, seconds: float, *, width: float | None, width_rate: float | None
) -> tuple[str | None, tuple[str, ...]]:
    """Drives; what was not as asked, None: all was; and the limits that held it back to the end of its time."""
    if not start(client, source):
        return f"does not start: {objection(client, source) or 'it drove too late'}", ()
    before = client.odometry()
    reason = stream(client, source, *twist, seconds=seconds, width=width, width_rate=width_rate)
    state = client.state()
    limits = () if state is None else state.status.limits_active
    if not rest(client, source) and reason is None:
        return unrested(client), limits
    after = client.odometry()
    moved = before is None or after is None or before[1:4] != after[1:4]
    if reason is None and twist != ZERO_TWIST and seconds > 0.0 and not moved:
        return "nothing moved", limits
    return reason, limits


def mode_words(client: Client) -> str:
    """The robot's mode and its reason; that they are unknown where the last state is old or the robot gone."""
    state, age = client.state(), client.state_age()
    if state is None:
        return "unknown: no state received"
    mode = state.status.mode.value
    if not client.alive:
        return f"unknown: the robot is gone (was {mode} {age:.1f} s ago)"
    if age > STALE_S:
        return f"unknown: no state for {age:.1f} s (was {mode})"
    return mode + (f" ({state.status.reason})" if state.status.reason else "")


def is_refusal(event: EventMessage, source: str) -> bool:
    """A command of this source was not taken, also because another sender holds the source."""
    return event.code.startswith("refused_") and event.text.startswith(f"{source}: ")


def stop(
    name: RobotName,
    reset: Annotated[bool, typer.Option("--reset", help="Release the emergency stop instead.")] = False,
    connect: Connect = None,
    json: Annotated[bool, typer.Option("--json", help="Machine-readable answer.")] = False,
) -> None:
    """Emergency stop, latched; with --reset, ask to release it (refused unless commands are zero and it stands)."""
    with open_client(name, connect) as client:
        if reset:
            answer = client.reset()
            left = client.wait_for_state(lambda state: state.status.mode is not Mode.ESTOP, STOP_TIMEOUT_S)
            done = f"reset granted: {mode_words(client)}" if left else "reset granted"
        elif client.stop(STOP_TIMEOUT_S):
            answer, done = ResetAnswer(True, None), f"emergency stop confirmed: {_stopped(client, name)}"
        else:
            answer = ResetAnswer(
                False, f"no emergency stop confirmed within {STOP_TIMEOUT_S:g} s: {mode_words(client)}"
            )
            done = ""
    tell(answer, json=json, done=done)


def _stopped(client: Client, name: str) -> str:
    """How a robot is that was stopped, and how it is released."""
    state = client.state()
    standing = None if state is None else state.status.standing
    how = {True: "it stands", False: "it is braking", None: "whether it stands is not known"}[standing]
    return f"{how}; latched until `drivegate stop {name} --reset`"


def tell(answer: ResetAnswer, *, json: bool, done: str) -> None:
    """What the robot answered, or in words what is done now; leaves the command with exit 0 when it did that."""
    if json:
        print_json(answer._asdict())
    elif answer.ok:
        console.print(done, markup=False, highlight=False, soft_wrap=True)
    else:
        complain(f"refused: {answer.reason}")
    raise typer.Exit(0 if answer.ok else EXIT_REFUSED)


def watch(
    name: RobotName,
    *,
    connect: Connect = None,
    once: Annotated[bool, typer.Option("--once", help="Print the table once.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print the state once, as the robot publishes it.")] = False,
    channels: Annotated[bool, typer.Option("--channels", help="Show every number that is recorded for plots.")] = False,
    viewer: Annotated[
        bool, typer.Option("--viewer", help="In the Rerun viewer on this machine, as a session.")
    ] = False,
    web: Annotated[
        bool, typer.Option("--web", help="With --viewer: as a page on loopback, also with a display.")
    ] = False,
) -> None:
    """Live table of a running robot, or its live view; Ctrl-C ends it."""
    for option, given, apart in (("--viewer", viewer, once or json or channels), ("--web", web, not viewer)):
        if given and apart:
            raise typer.BadParameter("needs --viewer, which goes with nothing else", param_hint=option)
    table = _channel_table if channels else _table
    if viewer:
        from gateway.cli.viewer import installed  # noqa: PLC0415  # for those who want it only

        installed()  # said before anything of Rerun is imported, which may be missing too
    with open_client(name, connect) as client:
        if viewer:
            from gateway.cli.look import look  # noqa: PLC0415  # Rerun is for those who want it only

            look(client, web=web)
        events: list[EventMessage] = []
        if once or json:
            state = client.wait_for_state(lambda _: True, ALIVE_TIMEOUT_S)
            if state is None:
                complain(f"{name} tells no state")
                raise typer.Exit(EXIT_NO_ROBOT)
            if json:
                print_json(state_document(state))
            else:
                console.print(table(name, client, state, events))
            return
        try:
            with Live(table(name, client, None, events), console=console, refresh_per_second=10) as live:
                while True:
                    events = [*events, *client.events()][-_EVENTS_SHOWN:]
                    live.update(table(name, client, client.state(), events))
                    time.sleep(0.1)
        except KeyboardInterrupt:
            return


def source_words(source: SourceStatus) -> str:
    """Whether it drives, and why not."""
    age = "" if source.age_s is None else f" ({source.age_s * 1e3:.0f} ms old)"
    return f"{source.name}: {source.reason or 'drives'}{age}"


def events(
    name: RobotName,
    follow: Annotated[bool, typer.Option("--follow", help="Go on with every event that comes, until Ctrl-C.")] = False,
    connect: Connect = None,
    json: Annotated[bool, typer.Option("--json", help="One JSON document for each line.")] = False,
) -> None:
    """What holds now, mode and faults; with --follow also each event that comes. See `doctor --explain CODE`."""
    with open_client(name, connect) as client:
        state = client.wait_for_state(lambda _: True, ALIVE_TIMEOUT_S)
        if state is None:
            complain(f"{name} tells no state")
            raise typer.Exit(EXIT_NO_ROBOT)
        for event in _present(state.status, state.t):
            _tell_event(event, json=json)
        if not follow:
            return
        try:
            while client.alive:
                for event in client.events():
                    _tell_event(event, json=json)
                time.sleep(0.05)
        except KeyboardInterrupt:
            return
        for event in client.events():
            _tell_event(event, json=json)
    complain(f"{name} is gone")
    raise typer.Exit(EXIT_NO_ROBOT)


def _present(status: Status, t: float) -> Iterator[EventMessage]:
    """What events have told before, as far as it still holds."""
    yield EventMessage(t, Level.INFO, f"mode_{status.mode.value}", status.reason or "drives as commanded")
    for fault in status.faults:
        yield EventMessage(t, Level.ERROR, "fault", fault)


def _tell_event(event: EventMessage, *, json: bool) -> None:
    if json:
        print_json(event._asdict() | {"level": event.level.value})
        return
    style = {Level.INFO: "dim", Level.WARNING: "yellow", Level.ERROR: "red"}[event.level]
    console.print(f"{event.t:12.3f}  [{style}]{event.level.value:8}[/]", end="", highlight=False)
    console.print(f"{event.code}: {event.text}", markup=False, highlight=False, soft_wrap=True)


def _sensed(sensor: SensorStatus) -> str:
    """What it tells, or why nothing of it is believed."""
    if sensor.values is None:
        return f"{sensor.name}: {sensor.reason or 'silent'}"
    return " ".join((sensor.name, *["-" if value is None else f"{value:z.3f}" for value in sensor.values]))


def _channel_table(name: str, client: Client, state: StateMessage | None, _: list[EventMessage]) -> Table:
    table = Table("channel", "value", title=f"{name}: {mode_words(client)}")
    numbers = state.extras.get("channels") if state is not None else None
    for label, number in numbers.items() if isinstance(numbers, dict) else ():
        table.add_row(str(label), "-" if number is None else f"{number:z.4f}")
    return table


def _table(name: str, client: Client, state: StateMessage | None, events: list[EventMessage]) -> Table:
    title = f"{name}: {mode_words(client)}"
    if state is None:
        return Table(title=title)
    status = state.status
    caption = [
        f"pose x {status.pose.x:z.3f} m  y {status.pose.y:z.3f} m  theta {status.pose.theta:z.3f} rad",
        f"winner {status.winner or '-'}  limits {', '.join(status.limits_active) or '-'}  cycle {status.cycle}",
        "  ".join(f"{setting.name} {setting.value:g}" for setting in status.settings),
        f"overruns {status.overruns}  refused {status.refused}  frames dropped {status.tx_dropped}",
        *(f"{event.level.value} {event.code}: {event.text}" for event in events),
    ]
    facts = [f"{name} {_fact(fact)}" for name, fact in status.chassis.items() if fact is not None]
    sensors = [_sensed(sensor) for sensor in status.sensors]
    caption[2:2] = ["  ".join(line) for line in (facts, sensors) if line]
    caption[1:1] = ["sources " + "  ".join(map(source_words, status.sources))]
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


def _fact(fact: float | str | bool) -> str:
    return f"{fact:.3g}" if isinstance(fact, float) else str(fact)


def _number(value: float | None, unit: str) -> str:
    return "-" if value is None else f"{value:z.2f} {unit}"
