"""CAN protocols of motor controllers. A new controller is one file here and one line in `DRIVERS`."""

from typing import Final

from drivers.contract import DriverType
from drivers.dji import DjiDriver
from drivers.odrive.group import OdriveDriver
from drivers.vesc import VescDriver

DRIVERS: Final[dict[str, DriverType]] = {
    "odrive": OdriveDriver,
    "dji": DjiDriver,
    "vesc": VescDriver,
}


def driver_problem(driver: str, variant: str) -> str | None:
    """What is wrong with this pair of names and what is allowed instead; None when such a driver exists."""
    if driver not in DRIVERS:
        return f"driver = {driver!r}: no such driver; there is {', '.join(DRIVERS)}"
    variants = DRIVERS[driver].variants
    if variant not in variants:
        return f"variant = {variant!r}: driver {driver} knows {', '.join(variants)}"
    return None
