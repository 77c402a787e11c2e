"""What a commander does with a client: arm the robot, stream a twist, drive along a path, bring it to rest.

with Client("moby", zero_on_exit=True) as client:
    client.wait_alive(5.0)
    if start(client, "autonomy"):
        stream(client, "autonomy", 0.2, 0.0, 0.0, seconds=3.0)
        rest(client, "autonomy")
    result = drive_path(client, path_file.parse(text, "course.toml"), "course.toml", source="autonomy", speed=0.3)
"""

import time
from collections.abc import Callable
from math import sqrt
from typing import NamedTuple

from gateway.client import Client
from gateway.config import ConfigError, RobotConfig, parse
from gateway.core.settings import LINEAR_SPEED, SPEED_OVERRIDE
from gateway.edges.messages import OdometryMessage, StateMessage
from gateway.guess import guess
from gateway.paths.drive import PathDrive, check, demands_of
from gateway.paths.follower import Order
from gateway.paths.path import Path
from gateway.types import ZERO_TWIST, Mode, TwistFrame

COMMAND_RATE_HZ = 50.0
START_TIMEOUT_S = 8.0
REST_TIMEOUT_S = 10.0
DRIVING = frozenset({Mode.DRIVE, Mode.DEGRADED})
ENDED = frozenset({Mode.ESTOP, Mode.FAULT})  # left by a person, not by more commands
ANSWER_TIMEOUT_S = 2.0
ODOMETRY_TIMEOUT_S = 0.5  # without news of where it is nobody should lead it
END_DISTANCE = 0.1  # m, from the path's end: further off it has not been reached
INTERRUPTED = "interrupted"


class PathResult(NamedTuple):
    """How a drive along a path went: m and s; `end_deviation`: at rest, from the path's end.

    `reason`: why it was not driven to its end; None: it was. `mode`: at the end, None: not known.
    """

    reason: str | None
    length: float
    seconds: float
    max_deviation: float
    end_deviation: float | None
    mode: Mode | None


def objection(client: Client, source: str) -> str | None:
    """Why this source does not drive the robot now; None: it does."""
    state = client.state()
    if not client.alive:
        return "the robot is gone"
    if state is None:
        return "no state received"
    status = state.status
    reasons = {one.name: one.reason for one in status.sources}
    if source not in reasons:
        return f"no source {source}: the sources are {', '.join(reasons)}{guess(source, reasons)}"
    if status.mode not in DRIVING:
        return f"mode {status.mode.value}" + (f": {status.reason}" if status.reason else "")
    return None if status.winner == source else f"source {source}: {reasons[source]}"


def start(client: Client, source: str, timeout: float = START_TIMEOUT_S) -> bool:
    """Zero commands until the robot drives; True when it does, False also as soon as it is clear that it will not."""
    deadline = time.monotonic() + timeout
    before = client.state()
    while client.alive and time.monotonic() < deadline:
        client.send_twist(0.0, 0.0, 0.0, source=source)
        state = client.state()
        if state is not None and state is not before:
            if objection(client, source) is None:
                return True
            known = {one.name for one in state.status.sources}
            if source not in known or state.status.mode is Mode.ESTOP:
                return False
        time.sleep(1.0 / COMMAND_RATE_HZ)
    return False


def stream(
    client: Client,
    source: str,
    vx: float,
    vy: float,
    wz: float,
    *,
    seconds: float,
    width_rate: float | None = None,
    width: float | None = None,
) -> str | None:
    """One twist at the command rate for so long, or until the robot stops for good; why it does not drive at the end.

    `width_rate` (m/s), or `width` (m), beside it. A source that was outranked or late for a moment goes on.
    """
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        state = client.state()
        if not client.alive or (state is not None and state.status.mode in ENDED):
            break
        client.send_twist(vx, vy, wz, source=source, width_rate=width_rate, width=width)
        time.sleep(1.0 / COMMAND_RATE_HZ)
    return objection(client, source)


def rest(client: Client, source: str) -> bool:
    """Zero commands until the robot stands; True when it does, False also as soon as it is gone."""
    deadline = time.monotonic() + REST_TIMEOUT_S
    sent = client.state()
    while client.alive and time.monotonic() < deadline:
        client.send_twist(0.0, 0.0, 0.0, source=source)
        state = client.state()
        still = state is not None and state is not sent and state.status.standing
        if still and state is not None and not state.status.limits_active:
            return True
        time.sleep(1.0 / COMMAND_RATE_HZ)
    return False


def unrested(client: Client) -> str:
    """Why `rest` ended without rest."""
    if not client.alive:
        return "the robot is gone: whether it came to rest is not known"
    return f"did not come to rest within {REST_TIMEOUT_S:g} s"


def config_of(client: Client) -> RobotConfig:
    """Of the running robot. Raises ConfigError where it tells none."""
    text = client.config_text(ANSWER_TIMEOUT_S)
    if text is None:
        raise ConfigError("robot file", [f"the robot did not tell it within {ANSWER_TIMEOUT_S:g} s"])
    return parse(text, "robot file of the running robot")


def drive_path(
    client: Client,
    path: Path,
    origin: str,
    *,
    source: str,
    speed: float,
    watch: Callable[[Order], None] = lambda _: None,
) -> PathResult:
    """Drives along the path, in the frame of the odometry, and ends at rest; `watch` gets every order.

    Before anything is sent the path is checked against the robot, and its start against where that stands: raises
    ConfigError, with `origin` as the file's name. It is slower where the robot's settings say so. Ctrl-C ends it
    at rest too.
    """
    config = config_of(client)
    demands = demands_of(config)
    check(demands.problems(path, speed), origin)
    path = demands.fitted(path)
    # Odometry is what it waits for: news of that wake it as news of the state do.
    state = client.wait_for_state(lambda _: client.odometry() is not None, ANSWER_TIMEOUT_S)
    odometry = client.odometry()
    if state is None or odometry is None:
        return PathResult("the robot does not tell where it is", path.length, 0.0, 0.0, None, _mode(client))
    heading = _chassis_heading(config, state, odometry)
    check(demands.start_problems(path, odometry.x, odometry.y, heading), origin)
    slower = min(speed, _allowed_speed(state, demands.top_speed))
    drive = PathDrive(demands.follower(path, slower), period=1.0 / COMMAND_RATE_HZ)
    began = time.monotonic()
    reason = _driven(client, drive, source, watch)
    seconds, off = time.monotonic() - began, _off_the_end(client, path)
    if reason is None and (off is None or off > END_DISTANCE):
        reason = f"did not reach the end: {'it is not known where it is' if off is None else f'{off:.3f} m off'}"
    return PathResult(reason, path.length, seconds, drive.max_deviation, off, _mode(client))


def _driven(client: Client, drive: PathDrive, source: str, watch: Callable[[Order], None]) -> str | None:
    """From rest to rest; why not to the end."""
    try:
        if not start(client, source):
            return f"does not start: {objection(client, source) or 'it drove too late'}"
        reason = _follow(client, drive, source, watch)
    except KeyboardInterrupt:
        reason = INTERRUPTED
    if objection(client, source) is not None:
        client.send_twist(*ZERO_TWIST, source=source)  # whoever drives it now, we ask for nothing
    elif not rest(client, source):
        return reason or unrested(client)
    return reason


def _follow(client: Client, drive: PathDrive, source: str, watch: Callable[[Order], None]) -> str | None:
    """Orders at the command rate until the end of the path; why it ended before that."""
    heard, heard_at = None, time.monotonic()
    while (reason := objection(client, source)) is None:
        now, odometry = time.monotonic(), client.odometry()
        if odometry is not heard:
            heard, heard_at = odometry, now
        if odometry is None or now - heard_at > ODOMETRY_TIMEOUT_S:
            return f"no odometry for {ODOMETRY_TIMEOUT_S:g} s"
        order = drive.step(now, odometry.x, odometry.y)
        watch(order)
        if order.lost:
            return f"lost after {order.way:.3f} m: too far off to merge back, {order.deviation:+.3f} m beside the path"
        if order.arrived:
            return None
        client.send_twist(order.vx, order.vy, 0.0, source=source, frame=TwistFrame.ODOM, path_rate=order.path_rate)
        time.sleep(1.0 / COMMAND_RATE_HZ)
    return reason


def _chassis_heading(config: RobotConfig, state: StateMessage, odometry: OdometryMessage) -> float | None:
    """Of a trailing chassis, rad over the floor; None where there is none or its angle is not known."""
    trailing = config.robot.trailing()
    if trailing is None:
        return None
    channels = state.extras.get("channels")
    name = config.robot.motor_names()[trailing.joint]
    joint = channels.get(f"position.{name}") if isinstance(channels, dict) else None
    return odometry.theta - joint if isinstance(joint, float) else None


def _allowed_speed(state: StateMessage, top: float) -> float:
    """M/s that commands may use now, of this top speed."""
    values = {setting.name: setting.value for setting in state.status.settings}
    return min(values.get(SPEED_OVERRIDE.name, 1.0) * top, values.get(LINEAR_SPEED.name, top))


def _off_the_end(client: Client, path: Path) -> float | None:
    odometry = client.odometry()
    if odometry is None:
        return None
    end = path.at(path.length)
    return sqrt((odometry.x - end.x) ** 2 + (odometry.y - end.y) ** 2)


def _mode(client: Client) -> Mode | None:
    state = client.state()
    return None if state is None or not client.alive else state.status.mode
