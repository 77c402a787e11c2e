"""The quantities of each cycle that people look at: name, unit, plot and where it is in the trace, each told once.

The recording's plots, the viewer's layout, `drivegate replay trace` and `drivegate watch --channels` all go by this
table: a new quantity is a field of `Trace`, and a row here.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Final, NamedTuple

from gateway.chassis.contract import Chassis
from gateway.types import Trace

Numbers = Sequence[float | None]


class Channel(NamedTuple):
    """One number or several of a kind. A name that ends in a dot is followed by the name of each motor, one that begins
    with an underscore follows that of each axis.

    `entity`: where it is in the recording, several may share one; `plot`: the view that shows it, "" for none.
    `asked`: what was wanted and not what was measured, which is drawn beneath it.
    """

    entity: str
    names: tuple[str, ...]
    unit: str
    plot: str
    read: Callable[[Trace], Numbers | None]
    asked: bool = False

    def labels(self, robot: Chassis) -> list[str]:
        """One name per number, motors in chassis order."""
        (first, *_) = self.names
        if first.startswith("_"):
            return [f"{axis}{first}" for axis in robot.AXES]
        return [f"{first}{motor}" for motor in robot.motor_names()] if first.endswith(".") else list(self.names)

    def numbers(self, trace: Trace, size: int) -> Numbers:
        """As many numbers as there are labels, None where something is unknown or released."""
        found = self.read(trace)
        return (None,) * size if found is None else found


def _targets(trace: Trace) -> Numbers:
    return (*trace.target, *[axis.target for axis in trace.more])


def _setpoints(trace: Trace) -> Numbers:
    return (*trace.setpoint, *[axis.setpoint for axis in trace.more])


def _measured(trace: Trace) -> Numbers | None:
    return None if trace.measured is None else (*trace.measured, *[axis.measured for axis in trace.more])


VELOCITY, WHEELS = "Body velocity [m/s, rad/s]", "Wheel speeds [rad/s]"
CHANNELS: Final = (
    Channel("wheels", ("commanded.",), "rad/s", WHEELS, lambda trace: trace.wheel_setpoints, asked=True),
    Channel("wheels", ("speed.",), "rad/s", WHEELS, lambda trace: trace.wheel_speeds),
    Channel("twist/target", ("_wanted",), "m/s, rad/s", VELOCITY, _targets, asked=True),
    Channel("twist/setpoint", ("_limited",), "m/s, rad/s", "", _setpoints, asked=True),
    Channel("twist/measured", ("_measured",), "m/s, rad/s", VELOCITY, _measured),
    Channel("pose", ("x", "y", "theta"), "m, rad", "Pose [m, rad]", lambda trace: trace.pose),
    Channel("residual", ("residual",), "m/s", "Slip residual [m/s]", lambda trace: (trace.residual,)),
    Channel("residual", ("residual.",), "m/s", "Slip residual [m/s]", lambda trace: trace.residuals),
    Channel("command_age", ("command_age",), "s", "Command age [s]", lambda trace: (trace.winner_age_s,)),
)
POSITIONS: Final = Channel("", ("position.",), "rad", "", lambda trace: trace.wheel_positions)


def channels_of(chassis: Chassis) -> tuple[Channel, ...]:
    """Those of every robot and those of this kind of chassis."""
    found: list[Channel] = [*CHANNELS]
    first = 0
    for group in chassis.CHANNELS:
        end = first + len(group.names)
        found.append(
            Channel(f"chassis/{group.entity}", group.names, group.unit, group.plot, partial(_of_chassis, first, end))
        )
        first = end
    return tuple(found)


def _of_chassis(first: int, end: int, trace: Trace) -> Numbers | None:
    return trace.chassis[first:end] if trace.chassis else None


class Layout:
    """Every channel of one robot as one flat row."""

    def __init__(self, robot: Chassis, channels: Sequence[Channel]) -> None:
        self._channels = [(channel, len(channel.labels(robot))) for channel in channels]
        self.labels = [label for channel in channels for label in channel.labels(robot)]

    def row(self, trace: Trace) -> list[float | None]:
        """The numbers of a cycle, in the order of the labels."""
        return [number for channel, size in self._channels for number in channel.numbers(trace, size)]

    def named(self, trace: Trace) -> dict[str, object]:
        """The same by label."""
        return dict(zip(self.labels, self.row(trace), strict=True))


def layout_of(chassis: Chassis) -> Layout:
    """Every channel of this robot, positions included, motors in chassis order."""
    return Layout(chassis, (*channels_of(chassis), POSITIONS))


def entities(channels: Sequence[Channel]) -> dict[str, list[Channel]]:
    """Channels by the entity that they share in the recording, in their order."""
    found: dict[str, list[Channel]] = {}
    for channel in channels:
        found.setdefault(channel.entity, []).append(channel)
    return found


def plots(channels: Sequence[Channel]) -> dict[str, list[str]]:
    """Entities by the plot that shows them, in their order."""
    found: dict[str, list[str]] = {}
    for channel in channels:
        shown = found.setdefault(channel.plot, [])
        if channel.entity not in shown:
            shown.append(channel.entity)
    found.pop("", None)
    return found
