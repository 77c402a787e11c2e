"""Which controller drives which wheel, and which way: from trials that a person watches, or from wheels turned by hand.

How this works
--------------
Controllers are known by what answers on the bus, not by the robot file, which may have wrong ids. Each is tried once: a
trial is the robot file with the id of the controller given to some motor that it may belong to. What was seen becomes a
finding: the motor, its controller's id, and the sign of its shaft with which the wheel turns positively. All findings
together are the corrections, unless something is left that would make two motors of one id. Pure.
"""

from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

from gateway.config import Motor, RobotConfig
from gateway.setup.census import Found
from gateway.setup.correction import Change

KEYS: Final = ("id", "direction")


class Device(NamedTuple):
    """A controller that a motor of the robot file may have."""

    driver: str
    variants: tuple[str, ...]  # that it can be
    id: int

    def may_be_of(self, motor: Motor) -> bool:
        """Whether a motor of the robot file says such a controller, whatever its id."""
        return motor.driver == self.driver and motor.variant in self.variants

    @property
    def name(self) -> str:
        """In words."""
        return f"{self.driver} id {self.id}"


class Trial(NamedTuple):
    """Turn `motor` of `config` forward, which is this controller; `guess`: whether the robot file says so too."""

    device: Device
    config: RobotConfig
    motor: str
    guess: bool


class Finding(NamedTuple):
    """What drives a motor."""

    device: Device
    direction: int


class FindingError(ValueError):
    """What was said cannot be: ask again."""


class Directions:
    """The controllers of one bus; `found`: those that answer there."""

    def __init__(self, config: RobotConfig, bus: str, found: Sequence[Found]) -> None:
        self._config = config
        self._motors = [motor for motor in config.motors_in_order() if motor.bus == bus]
        every = [Device(one.driver, one.variants, one.id) for one in found]
        self.devices = tuple(one for one in every if any(map(one.may_be_of, self._motors)))
        self.findings: dict[str, Finding] = {}
        self.idle: list[Device] = []  # that turned nothing

    @property
    def names(self) -> tuple[str, ...]:
        """Motors of this bus, in chassis order."""
        return tuple(motor.name for motor in self._motors)

    @property
    def missing(self) -> tuple[str, ...]:
        """Motors whose controller is not found yet."""
        return tuple(motor.name for motor in self._motors if motor.name not in self.findings)

    def trials(self) -> Iterable[Trial]:
        """One for each controller, as long as a motor is missing: what else is on the bus may be somebody's arm.

        Made when it is asked for: answers tell what may still be whose. Those that the robot file names come first.
        """
        for device in sorted(self.devices, key=lambda one: not self._named(one)):
            motor = self._guess(device)
            if self.missing and motor is not None:
                yield Trial(device, self._config_for(device, motor), motor.name, motor.id == device.id)

    def nothing_turned(self, device: Device) -> None:
        """So said who watches."""
        self.idle.append(device)

    def note(self, device: Device, motor: str, direction: int) -> None:
        """This controller turns that motor's wheel; `direction`: of its shaft, when the wheel turns positively.

        Raises FindingError.
        """
        wheel = next((one for one in self._motors if one.name == motor), None)
        if wheel is None:
            raise FindingError(f"{motor}: no such motor on this bus; there is {', '.join(self.names)}")
        if motor in self.findings:
            raise FindingError(f"{motor}: {self.findings[motor].device.name} turned it already")
        if not device.may_be_of(wheel):
            kind = f"{wheel.driver} {wheel.variant}"
            raise FindingError(f"{motor}: has a controller of {kind} in the robot file, which {device.name} is not")
        self.findings[motor] = Finding(device, direction)

    def changes(self) -> list[Change]:
        """What the robot file gets wrong. Raises FindingError where not enough is known to write it."""
        for motor in self._motors:
            owner = self._owner(motor)
            if motor.name not in self.findings and owner is not None:
                raise FindingError(f"motor {motor.name} was not found, and its id {motor.id} is that of {owner}")
        return [
            Change(motor.name, key, old, new)
            for motor in self._motors
            if motor.name in self.findings
            for key, old, new in self._compared(motor, self.findings[motor.name])
            if old != new
        ]

    def _owner(self, motor: Motor) -> str | None:
        """Which motor was found to have the id that the file gives this one."""
        return next(
            (name for name, (device, _) in self.findings.items() if device.id == motor.id and device.may_be_of(motor)),
            None,
        )

    @staticmethod
    def _compared(motor: Motor, finding: Finding) -> list[tuple[str, int, int]]:
        return [("id", motor.id, finding.device.id), ("direction", motor.direction, finding.direction)]

    def _named(self, device: Device) -> bool:
        return any(device.may_be_of(motor) and device.id == motor.id for motor in self._motors)

    def _guess(self, device: Device) -> Motor | None:
        """The motor that the file gives it to; else one whose controller does not answer, or any that is left."""
        alike = [motor for motor in self._motors if device.may_be_of(motor)]
        left = [motor for motor in alike if motor.name not in self.findings] or alike
        silent = [
            motor for motor in left if not any(one.may_be_of(motor) and one.id == motor.id for one in self.devices)
        ]
        named = [motor for motor in left if motor.id == device.id]
        return next(iter([*named, *silent, *left]), None)

    def _config_for(self, device: Device, chosen: Motor) -> RobotConfig:
        """The robot file in which this motor has that id, and turns no wheel that it may have too fast or too hard."""
        alike = [motor for motor in self._motors if device.may_be_of(motor)]
        ratio = min(motor.gear_ratio for motor in alike)
        torque = ratio * min(motor.max_torque / motor.gear_ratio for motor in alike)
        motors = []
        for motor in self._config.motor:
            one = motor
            if motor.name == chosen.name:
                one = motor.model_copy(update={"id": device.id, "gear_ratio": ratio, "max_torque": torque})
            elif motor.bus == chosen.bus and motor.id == device.id and device.may_be_of(motor):
                one = motor.model_copy(update={"id": chosen.id})
            motors.append(one)
        return self._config.model_copy(update={"motor": motors})


def says(answer: str, trial: Trial, names: Sequence[str]) -> tuple[str, bool] | None:
    """What a person says of a trial: which motor's wheel turned, and whether positively; None: nothing turned.

    `f` and `b`: that of the trial; `NAME f` or `NAME b`: another's; `n`: none. Raises FindingError.
    """
    words = answer.lower().split()
    if words == ["n"]:
        return None
    ways = {"f": True, "b": False}
    if len(words) == 1 and words[0] in ways:
        return trial.motor, ways[words[0]]
    if len(words) == 2 and words[0] in names and words[1] in ways:
        return words[0], ways[words[1]]
    known = " or ".join(names)
    raise FindingError(f"{answer.strip()!r}: must be f, b or n, or a wheel and f or b: {known}")
