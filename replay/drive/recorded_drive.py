"""What was asked of the robot of a session, to be asked once more: live on a bus, or in virtual time."""

from gateway.types import Request, RequestKind, SensorSample, TwistCommand
from replay.sessions.reader import Session
from replay.sim.plants.contract import PlantName

Asked = TwistCommand | Request | SensorSample
LEAD_NS = 2_000_000_000  # before the first command: so long a robot whose motors answer may look for its sensors
REST_S = 15.0  # at most, from the last of what was asked to rest; then the end is asked for all the same


class RedriveError(Exception):
    """The drive cannot be repeated; the text says why."""


def asked(session: Session) -> list[tuple[int, Asked]]:
    """Everything in order of arrival, each in ns since `LEAD_NS` before the first command.

    What was requested earlier still counts, and comes at once; what sensors told earlier does not. Raises RedriveError.
    """
    found: list[Asked] = []
    for inputs, _ in session.cycles():
        found += inputs.commands
        found += inputs.requests
        found += inputs.samples
    first_ns = next((one.received_ns for one in found if isinstance(one, TwistCommand)), None)
    if first_ns is None:
        raise RedriveError("nothing was commanded in this session")
    begin_ns = first_ns - LEAD_NS
    since = [(max(one.received_ns - begin_ns, 0), one) for one in found if _counts(one, begin_ns)]
    return sorted(since, key=lambda pair: pair[0])


def _counts(one: Asked, begin_ns: int) -> bool:
    return one.received_ns >= begin_ns or not isinstance(one, SensorSample)


def is_shutdown(one: Asked) -> bool:
    """Whether this asks for the end of the service."""
    return isinstance(one, Request) and one.kind is RequestKind.SHUTDOWN


def plant_told(session: Session) -> PlantName:
    """By what the robot of the session moved; of a real one, and where nothing is told, the simple plant.

    Raises RedriveError.
    """
    told = session.header.plant
    if told is None:
        return PlantName.SIMPLE
    try:
        return PlantName(told)
    except ValueError:
        raise RedriveError(f"its robot moved by plant {told!r}, which is not known here") from None
