"""The quantities of each cycle that people look at: name, unit, plot and where it is in the trace, each told once.

The recording's plots, the viewer's layout, `drivegate replay trace` and `drivegate watch --channels` all go by this
table: a new quantity is a field of `Trace`, and a row here.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from gateway.config import RobotConfig
from gateway.types import SensorKind, Trace

Numbers = Sequence[float | None]

AXES = ("vx", "vy", "wz")


class Channel(NamedTuple):
    """One number or several of a kind, of each owner: the robot, a motor, a sensor (`owners`).

    The names of motors and ranges follow those that end in a dot. A channel of sensors that are not there has none.
    `entity`: where it is in the recording, several may share one; `plot`: the view that shows it, "" for none.
    `asked`: what was wanted and not what was measured, which is drawn beneath it.
    """

    entity: str
    names: tuple[str, ...]
    unit: str
    plot: str
    read: Callable[[Trace], Numbers | None]
    asked: bool = False
    owner: str = "robot"

    def labels(self, owners: "Owners") -> list[str]:
        """One name per number, motors in chassis order."""
        return [f"{name}{owner}" for owner in owners[self.owner] for name in self.names]

    def numbers(self, trace: Trace, size: int) -> Numbers:
        """As many numbers as there are labels, None where something is unknown or released."""
        found = self.read(trace)
        return (None,) * size if found is None else found


Owners = Mapping[str, Sequence[str]]  # what follows the names of a channel, by the kind of its owner
MOTOR, HEADING, ATTITUDE, RANGE = "motor", "heading", "attitude", "range"


def owners(config: RobotConfig) -> Owners:
    """Of one robot."""
    sensors = {
        kind.value: [sensor.name if kind is SensorKind.RANGE else "" for sensor in config.sensor if sensor.kind is kind]
        for kind in SensorKind
    }
    return {"robot": [""], MOTOR: config.robot.motor_names(), **sensors}


def _of_axes(what: str) -> tuple[str, ...]:
    return tuple(f"{axis}_{what}" for axis in AXES)


LEAN = "Heading and attitude [rad]"
VELOCITY, WHEELS = "Body velocity [m/s, rad/s]", "Wheel speeds [rad/s]"
CHANNELS = (
    Channel("wheels", ("commanded.",), "rad/s", WHEELS, lambda trace: trace.wheel_setpoints, asked=True, owner=MOTOR),
    Channel("wheels", ("speed.",), "rad/s", WHEELS, lambda trace: trace.wheel_speeds, owner=MOTOR),
    Channel("twist/target", _of_axes("wanted"), "m/s, rad/s", VELOCITY, lambda trace: trace.target, asked=True),
    Channel("twist/setpoint", _of_axes("limited"), "m/s, rad/s", "", lambda trace: trace.setpoint, asked=True),
    Channel("twist/measured", _of_axes("measured"), "m/s, rad/s", VELOCITY, lambda trace: trace.measured),
    Channel("pose", ("x", "y", "theta"), "m, rad", "Pose [m, rad]", lambda trace: trace.pose),
    Channel("residual", ("residual",), "m/s", "Slip residual [m/s]", lambda trace: (trace.residual,)),
    Channel("command_age", ("command_age",), "s", "Command age [s]", lambda trace: (trace.winner_age_s,)),
    Channel("heading", ("heading",), "rad", LEAN, lambda trace: (trace.heading,), owner=HEADING),
    Channel(
        "attitude", ("roll", "pitch"), "rad", LEAN, lambda trace: trace.attitude and trace.attitude[:2], owner=ATTITUDE
    ),
    Channel("range", ("range.",), "m", "Range [m]", lambda trace: trace.ranges, owner=RANGE),
)
# Not plotted: `replay trace`, `watch --channels`.
UNPLOTTED = (
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


class Layout:
    """Every channel of one robot as one flat row."""

    def __init__(self, owners: Owners, channels: Sequence[Channel] = (*CHANNELS, *UNPLOTTED)) -> None:
        self._channels = [(channel, len(channel.labels(owners))) for channel in channels if channel.labels(owners)]
        self.labels = [label for channel in channels for label in channel.labels(owners)]

    def row(self, trace: Trace) -> list[float | None]:
        """The numbers of a cycle, in the order of the labels."""
        return [number for channel, size in self._channels for number in channel.numbers(trace, size)]

    def named(self, trace: Trace) -> dict[str, object]:
        """The same by label."""
        return dict(zip(self.labels, self.row(trace), strict=True))


def entities(owners: Owners, channels: Sequence[Channel] = CHANNELS) -> dict[str, list[Channel]]:
    """Channels of this robot by the entity that they share in the recording, in their order."""
    found: dict[str, list[Channel]] = {}
    for channel in channels:
        if not owners[channel.owner]:
            continue
        found.setdefault(channel.entity, []).append(channel)
    return found


def plots(owners: Owners, channels: Sequence[Channel] = CHANNELS) -> dict[str, list[str]]:
    """Entities of this robot by the plot that shows them, in their order."""
    found: dict[str, list[str]] = {}
    for channel in channels:
        if not owners[channel.owner]:
            continue
        shown = found.setdefault(channel.plot, [])
        if channel.entity not in shown:
            shown.append(channel.entity)
    found.pop("", None)
    return found
