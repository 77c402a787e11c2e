"""The quantities of each cycle that people look at: name, unit, plot and where it is in the trace, each told once.

The recording's plots, the viewer's layout, `drivegate replay trace` and `drivegate watch --channels` all go by this
table: a new quantity is a field of `Trace`, and a row here. What only one kind of chassis has is told by its file.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Final, NamedTuple

from gateway.chassis.contract import ChassisChannels
from gateway.config import RobotConfig
from gateway.types import SensorKind, Trace

Numbers = Sequence[float | None]
Owners = Mapping[str, Sequence[str]]  # names of who has a quantity, by the kind of owner
ROBOT: Final = "robot"
AXIS: Final = "axis"
MOTOR: Final = "motor"
HEADING: Final = SensorKind.HEADING.value
ATTITUDE: Final = SensorKind.ATTITUDE.value
RANGE: Final = SensorKind.RANGE.value


class Channel(NamedTuple):
    """One number or several of a kind, of each owner: the robot, an axis of the body, a motor, a sensor.

    The name of the owner follows that of the channel, that of an axis stands before it. A channel of sensors that are
    not there has no numbers. `entity`: where it is in the recording, several may share one; `plot`: the view that shows
    it, "" for none. `asked`: what was wanted and not what was measured, which is drawn beneath it.
    """

    entity: str
    names: tuple[str, ...]
    unit: str
    plot: str
    read: Callable[[Trace], Numbers | None]
    asked: bool = False
    owner: str = ROBOT

    def labels(self, owners: Owners) -> list[str]:
        """One name per number; motors in chassis order, axes as the kinematics names them."""
        having = owners[self.owner]
        if self.owner == AXIS:
            return [f"{axis}{name}" for axis in having for name in self.names]
        return [f"{name}{owner}" for owner in having for name in self.names]

    def numbers(self, trace: Trace, size: int) -> Numbers:
        """As many numbers as there are labels, None where something is unknown or released."""
        found = self.read(trace)
        return (None,) * size if found is None else found


def owners(config: RobotConfig) -> Owners:
    """Of one robot."""
    sensors = {
        kind.value: [sensor.name if kind is SensorKind.RANGE else "" for sensor in config.sensor if sensor.kind is kind]
        for kind in SensorKind
    }
    return {ROBOT: [""], AXIS: config.robot.AXES, MOTOR: config.robot.motor_names(), **sensors}


def _targets(trace: Trace) -> Numbers:
    return (*trace.target, *[axis.target for axis in trace.more])


def _setpoints(trace: Trace) -> Numbers:
    return (*trace.setpoint, *[axis.setpoint for axis in trace.more])


def _measured(trace: Trace) -> Numbers | None:
    return None if trace.measured is None else (*trace.measured, *[axis.measured for axis in trace.more])


LEAN: Final = "Heading and attitude [rad]"
VELOCITY: Final = "Body velocity [m/s, rad/s]"
WHEELS: Final = "Wheel speeds [rad/s]"
SLIP: Final = "Slip residual [m/s]"
CHANNELS: Final = (
    Channel("wheels", ("commanded.",), "rad/s", WHEELS, lambda trace: trace.wheel_setpoints, asked=True, owner=MOTOR),
    Channel("wheels", ("speed.",), "rad/s", WHEELS, lambda trace: trace.wheel_speeds, owner=MOTOR),
    Channel("twist", ("_wanted",), "m/s, rad/s", VELOCITY, _targets, asked=True, owner=AXIS),
    Channel("twist/setpoint", ("_limited",), "m/s, rad/s", "", _setpoints, asked=True, owner=AXIS),
    Channel("twist", ("_measured",), "m/s, rad/s", VELOCITY, _measured, owner=AXIS),
    Channel("pose", ("x", "y", "theta"), "m, rad", "Pose [m, rad]", lambda trace: trace.pose),
    Channel("residual", ("residual",), "m/s", SLIP, lambda trace: (trace.residual,)),
    Channel("residual", ("residual.",), "m/s", SLIP, lambda trace: trace.residuals, owner=MOTOR),
    Channel("command_age", ("command_age",), "s", "Command age [s]", lambda trace: (trace.winner_age_s,)),
    Channel("heading", ("heading",), "rad", LEAN, lambda trace: (trace.heading,), owner=HEADING),
    Channel(
        "attitude", ("roll", "pitch"), "rad", LEAN, lambda trace: trace.attitude and trace.attitude[:2], owner=ATTITUDE
    ),
    Channel("range", ("range.",), "m", "Range [m]", lambda trace: trace.ranges, owner=RANGE),
)
# Not plotted: `replay trace`, `watch --channels`.
UNPLOTTED: Final = (
    Channel("", ("position.",), "rad", "", lambda trace: trace.wheel_positions, owner=MOTOR),
    Channel(
        "",
        ("roll_rate", "pitch_rate", "yaw_rate"),
        "rad/s",
        "",
        lambda trace: trace.attitude and trace.attitude[2:],
        owner=ATTITUDE,
    ),
)


def channels_of(config: RobotConfig) -> tuple[Channel, ...]:
    """Those that this robot has and that are recorded for people: of every robot, and of its kind of chassis."""
    having = owners(config)
    every = (*CHANNELS, *_chassis_channels(config))
    return tuple([channel for channel in every if channel.entity and having[channel.owner]])


def _chassis_channels(config: RobotConfig) -> list[Channel]:
    found: list[Channel] = []
    for group in config.robot.channels():
        entity = group.entity and f"chassis/{group.entity}"
        found.append(Channel(entity, group.names, group.unit, group.plot, partial(_of_chassis, group)))
    return found


def _of_chassis(group: ChassisChannels, trace: Trace) -> Numbers | None:
    return group.read(trace.chassis) if trace.chassis else None


class Layout:
    """Channels of one robot as one flat row."""

    def __init__(self, owners: Owners, channels: Sequence[Channel]) -> None:
        self._channels = [(channel, len(channel.labels(owners))) for channel in channels if channel.labels(owners)]
        self.labels = [label for channel in channels for label in channel.labels(owners)]

    def sizes(self) -> list[tuple[Channel, int]]:
        """Each channel with how many labels it has, in their order."""
        return self._channels

    def row(self, trace: Trace) -> list[float | None]:
        """The numbers of a cycle, in the order of the labels."""
        return [number for channel, size in self._channels for number in channel.numbers(trace, size)]

    def named(self, trace: Trace) -> dict[str, object]:
        """The same by label."""
        return dict(zip(self.labels, self.row(trace), strict=True))


def layout_of(config: RobotConfig) -> Layout:
    """Every channel of this robot, those included that are not plotted."""
    return Layout(owners(config), (*CHANNELS, *_chassis_channels(config), *UNPLOTTED))


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
