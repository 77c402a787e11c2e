"""Sensors on CAN. A new one is one file here and one line in `SENSORS`."""

from functools import partial
from typing import Final

from drivers.sensors import draw_wire, imu
from drivers.sensors.contract import SensorType
from drivers.sensors.counted import CountedSensor, Layout


def _counted(layout: Layout) -> SensorType:
    return SensorType(tuple(layout.kinds), partial(CountedSensor, layout))


SENSORS: Final[dict[str, SensorType]] = {
    "draw_wire": _counted(draw_wire.LAYOUT),
    "imu": _counted(imu.LAYOUT),
}


def sensor_problem(driver: str, kind: str) -> str | None:
    """What is wrong with this pair of names and what is allowed instead; None when such a driver exists."""
    if driver not in SENSORS:
        return f"driver = {driver!r}: no such driver; there is {', '.join(SENSORS)}"
    kinds = SENSORS[driver].kinds
    if kind not in kinds:
        return f"kind = {kind!r}: driver {driver} tells {', '.join(kinds)}"
    return None
