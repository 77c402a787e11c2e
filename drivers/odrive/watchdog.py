"""The command timeout of an ODrive, and the options of the robot file that say where its parameters are."""

from typing import Final, NamedTuple

from drivers.checks import Option, check_options, text, whole_number
from drivers.contract import MotorSpec
from drivers.odrive.firmware import FIRMWARES

_ENDPOINT: Final = "a parameter number from flat_endpoints.json of exactly this firmware"
OPTIONS: Final[dict[str, Option]] = {
    "firmware": text(r"\d{1,3}\.\d{1,3}\.\d{1,3}", 'the exact version as text, like "0.6.10"'),
    "watchdog_enable_endpoint": whole_number(1, 65535, _ENDPOINT),
    "watchdog_timeout_endpoint": whole_number(1, 65535, _ENDPOINT),
}


class Watchdog(NamedTuple):
    """Written, then read back before the axis may be armed; the endpoints are those of exactly this firmware."""

    timeout_s: float
    firmware: str
    enable_endpoint: int
    timeout_endpoint: int


def watchdog_of(motor: MotorSpec) -> Watchdog | None:
    """From the robot file; None: waived. Raises ValueError naming motor, key, value and what is allowed."""
    if motor.watchdog_s is None:
        check_options(motor, {}, of="an odrive without a watchdog")
        return None
    if not FIRMWARES[motor.variant].tells_version:
        raise ValueError(
            f"motor {motor.name}: watchdog: firmware {motor.variant} cannot be read back over CAN; "
            "give watchdog_waiver with the reason instead, or use variant 0.6"
        )
    check_options(motor, OPTIONS, of="an odrive with a watchdog")
    given = motor.options
    return Watchdog(
        timeout_s=motor.watchdog_s,
        firmware=str(given["firmware"]),
        enable_endpoint=int(given["watchdog_enable_endpoint"]),
        timeout_endpoint=int(given["watchdog_timeout_endpoint"]),
    )
