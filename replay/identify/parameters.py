"""The unknown parameters of the simulated robot: their names, where they are in a robot file, and the file of them.

What is not told by a robot file no plant has, so every parameter is one of its numbers. `torque_scale` is the one more:
what really acts of a N m that a motor tells, that is, its torque constant in that of the robot file.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, Protocol, Self, TypeVar

import msgspec

from gateway.chassis.offset_differential import OffsetDifferentialRobot
from gateway.config import RobotConfig
from gateway.sections import Body
from replay.sim.plants.contract import PlantName

TORQUE_SCALE = "torque_scale"
OF_BODY = ("mass", "inertia", "joint_friction", "joint_drag", "joint_inertia")
OF_CHASSIS = ("chassis_inertia",)  # of the robot kinds that have it


class Parameter(NamedTuple):
    """One number. `least`: below it there is no such robot; `what`: in words."""

    name: str
    unit: str
    least: float
    what: str


PARAMETERS = {
    one.name: one
    for one in (
        Parameter("mass", "kg", 1e-3, "everything"),
        Parameter("inertia", "kg m^2", 1e-6, "what base_link turns with, about the vertical"),
        Parameter("chassis_inertia", "kg m^2", 1e-6, "the chassis below the joint, about its own vertical"),
        Parameter("joint_friction", "N m s/rad", 0.0, "viscous, at every joint"),
        Parameter("joint_drag", "N m", 0.0, "dry friction and rolling resistance at every joint"),
        Parameter("joint_inertia", "kg m^2", 0.0, "of every joint, rotor included"),
        Parameter(TORQUE_SCALE, "of the torque told", 1e-3, "what really acts of it"),
    )
}


class IdentifyError(ValueError):
    """A drive from which nothing can be learnt, or parameters that cannot be used; the text says why."""


class Found(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A parameter as a session tells it: `value`, within `low` to `high` with 95 %."""

    value: float
    low: float
    high: float
    unit: str


class Refused(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A parameter that the drive does not tell: `value` is the robot file's, or was given; `reason` in words."""

    value: float
    reason: str


class ParameterFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What `drivegate replay identify --out` writes. `residuals`: N m rms, of each motor."""

    robot: str
    kind: str
    session: str
    plant: str
    found: dict[str, Found]
    not_found: dict[str, Refused]
    residuals: dict[str, float]
    torques: dict[str, float]
    seconds: float
    moments: int

    @property
    def values(self) -> dict[str, float]:
        """All of them, those included that were not found."""
        return {name: one.value for name, one in self.not_found.items()} | {
            name: one.value for name, one in self.found.items()
        }


class RobotSection(Protocol):
    """The section `robot` of a robot file, of whatever kind."""

    @property
    def kind(self) -> str: ...
    @property
    def body(self) -> Body: ...
    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self: ...


def names_for(robot: RobotSection) -> tuple[str, ...]:
    """Those that a robot of this kind has, torque_scale last."""
    own = OF_CHASSIS if isinstance(robot, OffsetDifferentialRobot) else ()
    return (*OF_BODY, *own, TORQUE_SCALE)


def values_of(robot: RobotSection) -> dict[str, float]:
    """As the robot file has them; a torque told counts as true."""
    return {name: _value(robot, name) for name in names_for(robot)}


_Robot = TypeVar("_Robot", bound=RobotSection)


def with_values(robot: _Robot, values: Mapping[str, float]) -> _Robot:
    """The same robot with other parameters, unchecked: they may be off the range of a robot file."""
    body = robot.body.model_copy(update={name: values[name] for name in OF_BODY if name in values})
    own = {name: values[name] for name in OF_CHASSIS if name in values}
    return robot.model_copy(update={"body": body, **own})


def read_parameters(path: Path, config: RobotConfig) -> ParameterFile:
    """A file of parameters for this robot. Raises IdentifyError, OSError."""
    try:
        found = msgspec.json.decode(path.read_bytes(), type=ParameterFile)
        PlantName(found.plant)
    except (msgspec.DecodeError, ValueError) as error:
        raise IdentifyError(f"{path}: {error}") from None
    if found.kind != config.robot.kind:
        raise IdentifyError(f"{path}: is of a robot of kind {found.kind}, not {config.robot.kind}")
    known = names_for(config.robot)
    for name, value in found.values.items():
        if name not in known:
            raise IdentifyError(f"{path}: {name!r}: must be one of {', '.join(known)}")
        least = PARAMETERS[name].least
        if not least <= value < float("inf"):
            raise IdentifyError(f"{path}: {name} = {value:g}: must be {least:g} or more {PARAMETERS[name].unit}")
    return found


def _value(robot: RobotSection, name: str) -> float:
    if name == TORQUE_SCALE:
        return 1.0
    return float(getattr(robot if name in OF_CHASSIS else robot.body, name))
