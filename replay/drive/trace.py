"""The trace of a drive as CSV: a row per cycle, SI, empty where something is unknown or released."""

from collections.abc import Sequence
from typing import TextIO

from gateway.types import Twist
from replay.drive.moment import Moment

Row = Sequence[float | None]

_NONE: Row = (None, None, None)


def columns(motors: Sequence[str]) -> list[str]:
    """Names of the columns, motors in chassis order."""
    names = ["t", "mode"]
    names += [f"{axis}_{what}" for what in ("cmd", "set", "true") for axis in Twist._fields]
    names += ["x_true", "y_true", "theta_true"]
    return names + [f"{what}.{motor}" for what in ("set", "speed", "torque") for motor in motors]


class TraceWriter:
    """Writes rows into an open text file. Numbers are written so that they read back as the same floats."""

    def __init__(self, file: TextIO, motors: Sequence[str]) -> None:
        self._file = file
        file.write(",".join(columns(motors)) + "\n")

    def write(self, moment: Moment) -> None:
        """One row."""
        trace, truth = moment.outputs.trace, moment.truth
        cells = [f"{moment.t!r},{moment.outputs.mode.value}"]
        body: tuple[Row, ...] = (moment.asked or _NONE, trace.setpoint, truth.twist, truth.pose)
        motors: tuple[Row, ...] = (trace.wheel_setpoints, truth.joint_rates, truth.joint_torques)
        for part in (*body, *motors):
            cells += _cells(part)
        self._file.write(",".join(cells) + "\n")


def _cells(values: Row) -> list[str]:
    return ["" if value is None else repr(value) for value in values]
