"""What a commander does with a client: arm the robot, stream a twist, drive along a path, bring it to rest.

with Client("moby", zero_on_exit=True) as client:
    if start(client, "autonomy"):
        stream(client, "autonomy", 0.2, 0.0, 0.0, seconds=3.0)
        rest(client, "autonomy")
"""

import time

from gateway.client import Client
from gateway.types import Mode

COMMAND_RATE_HZ = 50.0
START_TIMEOUT_S = 8.0
REST_TIMEOUT_S = 10.0
DRIVING = frozenset({Mode.DRIVE, Mode.DEGRADED})
ENDED = frozenset({Mode.ESTOP, Mode.FAULT})  # left by a person, not by more commands


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
        return f"no source {source}: the sources are {', '.join(reasons)}"
    if status.mode not in DRIVING:
        return f"mode {status.mode.value}" + (f": {status.reason}" if status.reason else "")
    return None if status.winner == source else f"source {source}: {reasons[source]}"


def start(client: Client, source: str, timeout: float = START_TIMEOUT_S) -> bool:
    """Zero commands until the robot drives; True when it does, False also as soon as it is clear that it will not."""
    deadline = time.monotonic() + timeout
    before = client.state()
    while time.monotonic() < deadline:
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


def stream(client: Client, source: str, vx: float, vy: float, wz: float, *, seconds: float) -> str | None:
    """One twist at the command rate for so long, or until the robot stops for good; why it does not drive at the end.

    A source that was outranked or late for a moment goes on.
    """
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        state = client.state()
        if not client.alive or (state is not None and state.status.mode in ENDED):
            break
        client.send_twist(vx, vy, wz, source=source)
        time.sleep(1.0 / COMMAND_RATE_HZ)
    return objection(client, source)


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
