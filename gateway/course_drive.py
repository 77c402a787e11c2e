"""Drives measured courses on a robot that runs, as a commander like any other."""

from collections.abc import Sequence
from typing import NamedTuple

from gateway.client import Client
from gateway.commander import ANSWER_TIMEOUT_S, objection, rest, start, stream, unrested
from gateway.edges.messages import StateMessage
from gateway.setup.courses import Leg
from gateway.types import Mode

STILL_S = 0.5  # that it stands before and after a course, so that the recording has it
STAND_TIMEOUT_S = 5.0


class CourseDriveError(RuntimeError):
    """Why a course was not driven to its end; the robot is at rest, or does not obey."""


class Driven(NamedTuple):
    """`begin`, `end`: cycles between which it went from rest to rest; `session`: the robot's folder of it."""

    begin: int
    end: int
    session: str


def drive_course(client: Client, source: str, legs: Sequence[Leg], *, rate: float) -> Driven:
    """From rest to rest. `rate`: cycles per second. Raises CourseDriveError."""
    before = _standing(client, 0)
    session = session_of(before)
    _driven(client, source, legs)
    now = client.state()
    if now is None:
        raise CourseDriveError(unrested(client))
    after = _standing(client, now.status.cycle + round(STILL_S * rate))
    if session_of(after) != session:
        raise CourseDriveError("the service was restarted meanwhile")
    return Driven(before.status.cycle, after.status.cycle, session)


def session_of(state: StateMessage) -> str:
    """The folder in which the robot records now. Raises CourseDriveError where it does not."""
    recording = state.extras.get("recording")
    found = recording.get("session") if isinstance(recording, dict) else None
    if not isinstance(found, str):
        raise CourseDriveError("the robot does not record: recording.enabled must be true, and the disk not full")
    return found


def _standing(client: Client, cycle: int) -> StateMessage:
    """A state from this cycle on, in which it stands, with all its motors."""
    asked = client.status(ANSWER_TIMEOUT_S)
    if asked is None:
        raise CourseDriveError(f"the robot did not tell its state within {ANSWER_TIMEOUT_S:g} s")
    least = max(cycle, asked.status.cycle)
    found = client.wait_for_state(lambda state: state.status.cycle >= least, STAND_TIMEOUT_S)
    if found is None or found.status.standing is False:
        raise CourseDriveError("the robot does not stand still")
    if found.status.mode is Mode.DEGRADED:
        raise CourseDriveError(f"mode {found.status.mode.value}: {found.status.reason}")
    return found


def _driven(client: Client, source: str, legs: Sequence[Leg]) -> None:
    if not start(client, source):
        raise CourseDriveError(f"does not start: {objection(client, source) or 'it drove too late'}")
    for leg in legs:
        reason = stream(client, source, *leg.twist, seconds=leg.seconds)
        if not rest(client, source):
            raise CourseDriveError(unrested(client))
        if reason is not None:
            raise CourseDriveError(reason)
