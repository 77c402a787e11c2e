"""What a robot file needs of a controller beside how it is found: the lines of `drivegate setup prepare`. Pure.

How this works
--------------
`Ear` takes every frame that is heard. Each kind of controller has a room of its own that makes lines of that: what is
wanted, what was found, whether it fits, and what to do. `UNKNOWN` is what nobody can tell over the bus.
"""

from collections.abc import Iterable
from enum import Enum
from typing import Final, NamedTuple

from drivers.contract import CanFrame

LEAST_FRAMES: Final = 3  # of which a rate can be told
TOO_SLOW, SLOW, FAST = 0.5, 0.8, 1.5  # of the rate that is wanted; between the first two a busy computer may be why


class Verdict(Enum):
    """Whether a controller is as the robot file needs it."""

    OK = "ok"
    NO = "no"
    UNKNOWN = "unknown"


class Line(NamedTuple):
    """`wanted`, `found`: in words, empty where there is nothing to say. `todo`: empty where nothing is to do."""

    motor: str
    what: str
    wanted: str
    found: str
    verdict: Verdict
    todo: str = ""


class Heard(NamedTuple):
    """Frames of one id: their rate, where it can be told, and the data of the last one."""

    frames: int
    rate_hz: float | None
    data: bytes


class Ear:
    """Takes frames in the order of their stamps."""

    def __init__(self) -> None:
        self._heard: dict[tuple[int, bool], tuple[int, int, int, bytes]] = {}  # count, first and last stamp, data

    def take(self, frame: CanFrame) -> None:
        """One that was received."""
        if frame.remote or frame.fd:
            return
        now_ns = frame.received_ns or 0
        count, first_ns, _, _ = self._heard.get((frame.id, frame.extended), (0, now_ns, now_ns, b""))
        self._heard[frame.id, frame.extended] = (count + 1, first_ns, now_ns, frame.data)

    def of(self, can_id: int, *, extended: bool = False) -> Heard | None:
        """None: never."""
        found = self._heard.get((can_id, extended))
        if found is None:
            return None
        count, first_ns, last_ns, data = found
        measured = count >= LEAST_FRAMES and last_ns > first_ns
        return Heard(count, (count - 1) * 1e9 / (last_ns - first_ns) if measured else None, data)


def rate_line(
    motor: str, what: str, wanted_hz: float, heard: Heard | None, todo: str, *, at_least: bool = False
) -> Line:
    """A cyclic message that must come so often; `at_least`: or more often."""
    wanted = f"{wanted_hz:g} Hz" + (" or more" if at_least else "")
    if heard is None:
        return Line(motor, what, wanted, "never heard", Verdict.NO, todo)
    if heard.rate_hz is None:
        return Line(motor, what, wanted, f"heard {heard.frames} times", Verdict.NO, todo)
    found, share = f"{heard.rate_hz:.0f} Hz", heard.rate_hz / wanted_hz
    if share < TOO_SLOW or (share > FAST and not at_least):
        return Line(motor, what, wanted, found, Verdict.NO, todo)
    if share < SLOW:
        return Line(motor, what, wanted, found, Verdict.UNKNOWN, f"a busy bus or computer? else {todo}")
    return Line(motor, what, wanted, found, Verdict.OK)


def holds_line(motor: str) -> Line:
    """Of a controller without a command timeout."""
    return Line(
        motor,
        "silence of the host",
        "stops by itself",
        "no command timeout",
        Verdict.UNKNOWN,
        "it may hold its last command when its cable is cut or this computer dies, and no software ends that: "
        "a relay that cuts the supply of the motors, worked by the emergency stop",
    )


def wrong(lines: Iterable[Line]) -> list[Line]:
    """Those that are not as the robot file needs them."""
    return [line for line in lines if line.verdict is Verdict.NO]
