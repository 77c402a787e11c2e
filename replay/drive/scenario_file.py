"""The scenario file: TOML, everything in SI, unknown keys rejected. What people type is checked here, once."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from gateway import robot_files
from gateway.config import ConfigError, RobotConfig, parse_as, read
from gateway.core.settings import problems
from gateway.edges.messages import MAX_SPEED, MAX_TURN, MAX_WIDTH, MAX_WIDTH_RATE
from gateway.sections import Name
from gateway.types import Mode, Region
from replay.drive.commanders import SENDER
from replay.drive.faults import RULES, FaultKind, Target, sensors, wheels
from replay.sim.plants.contract import PlantName, WithCaster
from replay.sim.robot import chosen_plant

MAX_SECONDS = 3600.0

Time = Annotated[float, Field(ge=0.0, le=MAX_SECONDS, allow_inf_nan=False, description="s")]
Speed = Annotated[float, Field(ge=-MAX_SPEED, le=MAX_SPEED, allow_inf_nan=False, description="m/s")]
Turn = Annotated[float, Field(ge=-MAX_TURN, le=MAX_TURN, allow_inf_nan=False, description="rad/s")]
JointAngle = Annotated[float, Field(ge=-1e4, le=1e4, allow_inf_nan=False, description="rad at the output")]

ACTIONS = ("command", "silence", "request", "set", "fault")


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Command(_Section):
    """A twist that a source streams until it is told something else; `stamped`: with the time of sending.

    `sender`: which process sends as this source; `region`: the way round that it asks for; `width_rate` or `width`: of
    a robot whose wheels go apart.
    """

    source: Name
    vx: Speed
    vy: Speed
    wz: Turn
    rate: Annotated[float, Field(ge=0.1, le=1000.0, description="Hz")] = 50.0
    stamped: bool = False
    sender: Name = SENDER
    region: Region = Region.ANY
    width_rate: Annotated[float, Field(ge=-MAX_WIDTH_RATE, le=MAX_WIDTH_RATE, description="m/s")] | None = None
    width: Annotated[float, Field(ge=0.0, le=MAX_WIDTH, description="m")] | None = None

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        if self.width is not None and self.width_rate is not None:
            raise ValueError(f"width = {self.width:g}: give either width or width_rate")
        return self


class Fault(_Section):
    """Something breaks, or is whole again; which keys a kind takes is the table in `replay.drive.faults`."""

    kind: FaultKind
    motor: Name | None = None
    bus: Name | None = None
    sensor: Name | None = None
    value: Annotated[float, Field(allow_inf_nan=False)] | None = None
    seconds: Annotated[float, Field(gt=0.0, le=MAX_SECONDS)] | None = None

    @model_validator(mode="after")
    def _as_the_table_says(self) -> Self:
        problems = list(self._problems())
        if problems:
            raise ValueError("; ".join(problems))
        return self

    def _problems(self) -> Iterator[str]:
        rule = RULES[self.kind]
        if self.value is None and rule.value is not None and rule.default is None:
            yield f"value is missing: {rule.value.words}"
        if self.value is not None and rule.value is None:
            yield f"value = {self.value}: {self.kind.value} takes none"
        if self.value is not None and rule.value is not None and not rule.value.low <= self.value <= rule.value.high:
            yield f"value = {self.value}: must be {rule.value.words}"
        if self.motor is not None and rule.target not in (Target.MOTOR, Target.WHEEL):
            yield f"motor = {self.motor!r}: {self.kind.value} concerns no motor"
        if self.bus is not None and rule.target is not Target.BUS:
            yield f"bus = {self.bus!r}: {self.kind.value} concerns no bus"
        if self.sensor is not None and rule.target is not Target.SENSOR:
            yield f"sensor = {self.sensor!r}: {self.kind.value} concerns no sensor"
        if self.seconds is None and rule.timed:
            yield "seconds is missing: how long it lasts"
        if self.seconds is not None and not rule.timed and rule.end is None:
            yield f"seconds = {self.seconds}: {self.kind.value} does not end by itself"


class At(_Section):
    """What happens at one moment: exactly one of command, silence, request, set and fault."""

    t: Time
    command: Command | None = None
    silence: Name | None = None
    request: Literal["estop", "reset", "shutdown", "restart", "reference", "stand_up", "let_down"] | None = None
    angle: JointAngle | None = None  # of a reference, from the joint's zero
    set: dict[Name, float] | None = None  # settings with their new values
    fault: Fault | None = None

    @model_validator(mode="after")
    def _exactly_one(self) -> Self:
        given = [key for key in ACTIONS if getattr(self, key) is not None]
        if len(given) != 1:
            raise ValueError(f"must have exactly one of {', '.join(ACTIONS)}, has {' and '.join(given) or 'none'}")
        if self.angle is not None and self.request != "reference":
            raise ValueError(f"angle = {self.angle}: belongs to request = 'reference' only")
        wrong = problems(self.set or {})
        if wrong:
            raise ValueError("; ".join(wrong))
        return self


class Expect(_Section):
    """What must hold in every cycle from `from` until before `to`, or, with `within`, in one cycle of that time.

    An event must be seen once in either case.
    """

    start: Annotated[Time, Field(alias="from")] = 0.0
    to: Time | None = None
    within: Annotated[float, Field(gt=0.0, le=MAX_SECONDS)] | None = None
    mode: Annotated[list[Mode], Field(min_length=1)] | None = None  # any of these; a single one needs no brackets
    max_speed: Annotated[float, Field(ge=0.0, le=100.0, description="m/s")] | None = None
    min_speed: Annotated[float, Field(ge=0.0, le=100.0, description="m/s")] | None = None
    event: Annotated[str, Field(min_length=1, max_length=64)] | None = None

    @field_validator("mode", mode="before")
    @classmethod
    def _one_or_several(cls, value: object) -> object:
        return [value] if isinstance(value, str | Mode) else value

    @model_validator(mode="after")
    def _something_sometime(self) -> Self:
        if all(value is None for value in (self.mode, self.max_speed, self.min_speed, self.event)):
            raise ValueError("expects nothing: give mode, max_speed, min_speed or event")
        if self.within is not None and self.to is not None:
            raise ValueError(f"to = {self.to}: give either `to` or `within`")
        if self.to is not None and self.to < self.start:
            raise ValueError(f"to = {self.to}: must not be before from = {self.start}")
        return self

    def end(self, seconds: float) -> float:
        """End of the window in a drive of so many seconds."""
        if self.within is not None:
            return self.start + self.within
        return seconds if self.to is None else self.to


class Start(_Section):
    """How the robot stands at the beginning: rad at the output of a motor, from its zero.

    `swivel`: of the caster's fork against the chassis, counter-clockwise; -pi/2 as it trails behind a robot that drove
    forward.
    """

    joint: dict[Name, JointAngle] = {}
    swivel: JointAngle | None = None


class Scenario(_Section):
    """The whole file."""

    robot: Annotated[str, Field(min_length=1, max_length=256)]
    seconds: Annotated[float, Field(gt=0.0, le=MAX_SECONDS)]
    seed: Annotated[int, Field(ge=0, le=2**32 - 1)] = 0
    plant: PlantName = PlantName.SIMPLE
    start: Start = Start()
    at: list[At] = []
    expect: list[Expect] = []

    @model_validator(mode="after")
    def _within_the_drive(self) -> Self:
        late = [f"at[{i}].t = {at.t}: must be 0 to seconds = {self.seconds}" for i, at in self._late()]
        late += [
            f"expect[{i}].from = {one.start}: must be before seconds = {self.seconds}"
            for i, one in enumerate(self.expect)
            if one.start >= self.seconds
        ]
        if late:
            raise ValueError("; ".join(late))
        return self

    def _late(self) -> list[tuple[int, At]]:
        return [(place, at) for place, at in enumerate(self.at) if at.t > self.seconds]


def load_scenario(path: Path) -> Scenario:
    """The scenario in this file. Raises ConfigError."""
    return parse_as(Scenario, read(path), str(path))


def find_robot(scenario: Scenario, folder: Path, named: str | None = None) -> Path:
    """Its robot file, a path counted from the scenario's folder; `named` stands in for it. Raises ConfigError."""
    if named is None and (folder / scenario.robot).is_file():
        return folder / scenario.robot
    return robot_files.find(named) if named is not None else robot_files.find_bundled(scenario.robot)


def check_names(scenario: Scenario, config: RobotConfig, origin: str) -> None:
    """Everything that the file names is there on this robot. Raises ConfigError."""
    problems = [problem for place, at in enumerate(scenario.at) for problem in _unknown(f"at[{place}]", at, config)]
    motors = config.robot.motor_names()
    problems += [_no_such(f"start.joint.{name}", name, motors) for name in scenario.start.joint if name not in motors]
    if not isinstance(chosen_plant(config, scenario.plant, origin), WithCaster):
        needed = f"needs a caster: an offset_differential robot with plant = {PlantName.DYNAMICS.value!r}"
        problems += [f"{key}: {needed}" for key in _about_the_caster(scenario)]
    if problems:
        raise ConfigError(origin, problems)


def _about_the_caster(scenario: Scenario) -> Iterator[str]:
    if scenario.start.swivel is not None:
        yield f"start.swivel = {scenario.start.swivel:g}"
    for place, at in enumerate(scenario.at):
        if at.fault is not None and RULES[at.fault.kind].target is Target.CASTER:
            yield f"at[{place}].fault.kind = {at.fault.kind.value!r}"


def _unknown(key: str, at: At, config: RobotConfig) -> Iterator[str]:
    sources = [source.name for source in config.commands.source]
    if at.command is not None and at.command.source not in sources:
        yield _no_such(f"{key}.command.source", at.command.source, sources)
    if at.silence is not None and at.silence not in sources:
        yield _no_such(f"{key}.silence", at.silence, sources)
    if at.fault is None:
        return
    rule = RULES[at.fault.kind]
    if rule.target is Target.WHEEL and not config.robot.body.joint_inertia > 0.0:
        yield f"{key}.fault.kind = {at.fault.kind.value!r}: needs robot.body.joint_inertia above 0 in the robot file"
    motors = wheels(config) if rule.target is Target.WHEEL else config.robot.motor_names()
    buses = [bus.name for bus in config.bus]
    if at.fault.motor is not None and at.fault.motor not in motors:
        yield _no_such(f"{key}.fault.motor", at.fault.motor, motors)
    if at.fault.bus is not None and at.fault.bus not in buses:
        yield _no_such(f"{key}.fault.bus", at.fault.bus, buses)
    if rule.target is Target.SENSOR and not sensors(config):
        yield f"{key}.fault.kind = {at.fault.kind.value!r}: needs a [[sensor]] on a bus in the robot file"
    elif at.fault.sensor is not None and at.fault.sensor not in sensors(config):
        yield _no_such(f"{key}.fault.sensor", at.fault.sensor, sensors(config))


def _no_such(key: str, value: str, known: object) -> str:
    names = ", ".join(known) if isinstance(known, list | tuple) else str(known)
    return f"{key} = {value!r}: there is {names}"
