"""What a robot file needs of a C620, C610 or GM6020: reports as listening tells them; nothing of it is set over CAN."""

from drivers.dji import FEEDBACK_ID
from gateway.config import Bus, Motor
from gateway.setup.preparation import Ear, Line, Verdict, holds_line, rate_line

_BIT_RATE = 1_000_000  # the only one they have; RoboMaster C610 manual


def heard_lines(ear: Ear, motor: Motor, bus: Bus) -> list[Line]:
    """Whether it reports, how often, and what no message tells."""
    heard = ear.of(FEEDBACK_ID[motor.variant] + motor.id)
    rate = motor.feedback_rate or 0.0
    todo = "the report rate, in RoboMaster Assistant (from the factory 1 kHz)"
    if heard is None:
        lines = [Line(motor.name, "answers", f"id {motor.id}", "silent", Verdict.NO, _silent(motor))]
    else:
        lines = [rate_line(motor.name, "reports", rate, heard, todo)]
    if bus.bitrate != _BIT_RATE:
        found, cure = f"bus.{bus.name} {bus.bitrate}", "give it a bus of 1 Mbit/s"
        lines.append(Line(motor.name, "bit rate", str(_BIT_RATE), found, Verdict.NO, cure))
    if "mode" in motor.options:
        lines.append(
            Line(
                *(motor.name, "mode", str(motor.options["mode"]), "not told over CAN", Verdict.UNKNOWN),
                "look in RoboMaster Assistant; in the wrong one it reports and does not obey: `drivegate setup jog`",
            )
        )
    return [*lines, holds_line(motor.name)]


def _silent(motor: Motor) -> str:
    by = "its switches 1 to 3" if motor.variant == "gm6020" else "its SET button"
    return f"power of the motors, cable, 1 Mbit/s, id {motor.id} by {by}: `drivegate setup scan` tells who is there"


def by_hand(_motor: Motor, _bus: Bus) -> list[str]:
    """Nothing but what the lines say."""
    return []
