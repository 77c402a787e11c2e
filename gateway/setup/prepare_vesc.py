"""What a robot file needs of a VESC: what listening tells, and the rest in words for VESC Tool. Pure."""

from typing import Final

from drivers.vesc import STATUS, STATUS_4, STATUS_4_HZ, STATUS_5
from gateway.config import Bus, Motor
from gateway.setup.preparation import Ear, Line, Verdict, rate_line

_PAGE: Final = "VESC Tool, App Settings, General"
_WARM: Final = 1.0  # Hz, of the temperatures, at least


def heard_lines(ear: Ear, motor: Motor, _bus: Bus) -> list[Line]:
    """Whether it is there, and whether its status messages come as the robot file says."""
    rate = motor.feedback_rate or 0.0
    heard = {at: ear.of(at << 8 | motor.id, extended=True) for at in (STATUS, STATUS_5, STATUS_4)}
    if not any(heard.values()):
        todo = f"{_PAGE}: VESC ID {motor.id}, CAN Mode VESC, and status messages on; power, cable, bit rate"
        return [Line(motor.name, "answers", f"id {motor.id}", "no status message", Verdict.NO, todo)]
    page = f"{_PAGE}, CAN Status Messages"
    return [
        rate_line(motor.name, "STATUS", rate, heard[STATUS], f"{page}: rate 1 = {rate:g} Hz, with STATUS 1"),
        rate_line(motor.name, "STATUS_5", rate, heard[STATUS_5], f"{page}: rate 1 = {rate:g} Hz, with STATUS 5"),
        rate_line(
            *(motor.name, "STATUS_4", _WARM, heard[STATUS_4]),
            f"{page}: rate 2 = {STATUS_4_HZ:g} Hz, with STATUS 4",
            at_least=True,
        ),
        _timeout_line(motor),
    ]


def _timeout_line(motor: Motor) -> Line:
    what = "command timeout"
    if motor.watchdog is None:
        todo = "give it a watchdog in the robot file: a VESC has one"
        return Line(motor.name, what, f"waived: {motor.watchdog_waiver}", "not told", Verdict.UNKNOWN, todo)
    wanted = f"{1e3 * motor.watchdog.timeout:g} ms"
    todo = "nothing tells it over CAN; the driver sees it expire at each start before it drives"
    return Line(motor.name, what, wanted, "not told", Verdict.UNKNOWN, todo)


def by_hand(motor: Motor, bus: Bus) -> list[str]:
    """What to set in VESC Tool; names as of firmware 6."""
    timeout = "" if motor.watchdog is None else f"{1e3 * motor.watchdog.timeout:g} ms"
    rate = motor.feedback_rate or 0.0
    return [
        f"{_PAGE}: VESC ID = {motor.id}; CAN Mode = VESC; CAN Baud Rate = {bus.bitrate // 1000}K",
        f"{_PAGE}: Timeout = {timeout or 'some, never 0: that is none'}; Timeout Brake Current = what it brakes with "
        "when the host is silent, A (0: it coasts)",
        f"{_PAGE}, CAN Status Messages: rate 1 = {rate:g} Hz with STATUS 1 and STATUS 5, "
        f"rate 2 = {STATUS_4_HZ:g} Hz with STATUS 4",
        f"Motor Settings, General: motor current max = {motor.max_current:g} A, max brake = -{motor.max_current:g} A",
        f"PID Controllers, Speed PID: Minimum ERPM = {motor.options.get('min_erpm')}, no ramp",
        "write both configurations, motor and app",
    ]
