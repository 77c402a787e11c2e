"""The command timeout of an ODrive, and the options of the robot file that say where its parameters are.

A parameter has another number in every firmware, and for every hardware of one firmware; written to a wrong number, a
value lands in some other setting, from which it reads back as if all were well. So numbers carry what they belong to:
`firmware`, and `endpoints_of` once `drivegate setup prepare` has read them from the vendor's file, which nobody edits.
"""

from typing import Final, NamedTuple

from drivers.checks import Option, check_options, text, whole_number
from drivers.contract import MotorSpec
from drivers.odrive.firmware import FIRMWARES

_ENDPOINT: Final = "a parameter number from flat_endpoints.json of exactly this firmware"
_VERSION: Final = r"\d{1,3}\.\d{1,3}\.\d{1,3}"
OPTIONS: Final[dict[str, Option]] = {
    "firmware": text(_VERSION, 'the exact version as text, like "0.6.10"'),
    "watchdog_enable_endpoint": whole_number(1, 65535, _ENDPOINT),
    "watchdog_timeout_endpoint": whole_number(1, 65535, _ENDPOINT),
}
PROOF: Final = "endpoints_of"
PROVEN: Final[dict[str, Option]] = {
    PROOF: text(
        f"{_VERSION} {_VERSION}", 'firmware and hardware that the endpoints were read for, like "0.6.10 5.2.0"'
    ),
}


class Watchdog(NamedTuple):
    """Written, then read back before the axis may be armed; the endpoints are those of exactly this firmware."""

    timeout_s: float
    firmware: str
    hardware: str | None  # None: nobody knows for which hardware they were read
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
    check_options(motor, OPTIONS, of="an odrive with a watchdog", optional=PROVEN)
    given = motor.options
    return Watchdog(
        timeout_s=motor.watchdog_s,
        firmware=str(given["firmware"]),
        hardware=_proven_hardware(motor),
        enable_endpoint=int(given["watchdog_enable_endpoint"]),
        timeout_endpoint=int(given["watchdog_timeout_endpoint"]),
    )


def _proven_hardware(motor: MotorSpec) -> str | None:
    """Of the vendor's file that the numbers are from. Raises ValueError where they were taken to another firmware."""
    firmware, enable, timeout = (motor.options[key] for key in OPTIONS)
    if enable == timeout:
        where = f"motor {motor.name}: options.watchdog_timeout_endpoint = {timeout!r}"
        raise ValueError(f"{where}: must be another one than watchdog_enable_endpoint")
    proof = motor.options.get(PROOF)
    if proof is None:
        return None
    read_for, _, hardware = str(proof).partition(" ")
    if read_for != firmware:
        raise ValueError(
            f"motor {motor.name}: options.{PROOF} = {proof!r}: endpoints {enable} and {timeout} were read for firmware "
            f"{read_for}, and options.firmware is {firmware}, where they mean something else: "
            "`drivegate setup prepare FILE --endpoints flat_endpoints.json` writes its own"
        )
    return hardware
