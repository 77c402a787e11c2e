"""What may be set while the robot runs: one row for each setting. A restart goes back to the robot file's value.

A setting is asked for by a request, which is recorded and replayed as every input is. None may move a robot by itself:
whoever reads one applies it through the limits, and only to what a command asks for. None makes a stop weaker: those of
speed are less than the robot file's, and those of acceleration and jerk hold for speeding up alone. What the floor is
taken for (`GROUND_FRICTION`) is what a commanded zero brakes on; braking of the core itself never asks it.
"""

from collections.abc import Mapping
from math import ceil, isfinite, sqrt
from typing import Final, NamedTuple

from gateway.config import Axes
from gateway.control.compensation import WHOLE_CIRCLE
from gateway.control.drive_law import DriveLaw
from gateway.control.launch import FRICTION, LEAST_FRICTION, MOST_FRICTION
from gateway.control.limits import NO_EASE, Ease
from gateway.guess import guess
from gateway.types import SettingStatus

LEAST_SHARE: Final = 0.05  # of a limit of the robot file: with less a robot seems not to obey
_PER_M_S: Final = 1000.0  # steps to which the top of `linear_speed` is rounded up: what is shown can be set
_DIGITS: Final = 6  # likewise of the least


class Setting(NamedTuple):
    """`low` to `high`, in `unit`; `default` where the robot file's [settings] do not name it, None: never there.

    `keys`: of the robot file, which it holds back while the robot runs, or which say what it is at the start.
    """

    name: str
    unit: str
    low: float
    high: float
    default: float | None
    keys: tuple[str, ...]

    def refusal(self, value: float) -> str | None:
        """Why this value is none; None: it is one."""
        if isfinite(value) and self.low <= value <= self.high:
            return None
        return f"{self.name} = {value:g}: must be {self.low:g} to {self.high:g} {self.unit}"


# What commands may use: of all limits of velocity, of translation whatever its direction, and of turning. Of the latter
# two `of_robot` knows the range.
SPEED_OVERRIDE: Final = Setting("speed_override", "of limits.velocity", LEAST_SHARE, 1.0, 1.0, ("limits.velocity",))
LINEAR_SPEED: Final = Setting(
    "linear_speed", "m/s", 1e-5, 1e5, 1e5, ("limits.velocity", "limits.velocity.vx", "limits.velocity.vy")
)
ANGULAR_SPEED: Final = Setting("angular_speed", "rad/s", 1e-5, 1e5, 1e5, ("limits.velocity.wz",))
# With what of the limits a setpoint may speed up.
ACCELERATION_OVERRIDE: Final = Setting(
    "acceleration_override", "of limits.acceleration", LEAST_SHARE, 1.0, 1.0, ("limits.acceleration",)
)
JERK_OVERRIDE: Final = Setting("jerk_override", "of limits.jerk", LEAST_SHARE, 1.0, 1.0, ("limits.jerk",))
# Only where the robot file has [robot.compensation], which also says what they are at the start.
COMPENSATION_GAIN: Final = Setting("compensation_gain", "(no unit)", 0.0, 4.0, None, ("robot.compensation.gain",))
COMPENSATION_REGION: Final = Setting(
    "compensation_region", "rad", 0.01, WHOLE_CIRCLE, None, ("robot.compensation.region",)
)
# Only where the robot file has [robot.grip], which also says what it is at the start.
GROUND_FRICTION: Final = Setting(FRICTION, "of the load", LEAST_FRICTION, MOST_FRICTION, None, ("robot.grip.friction",))
SETTINGS: Final = {
    setting.name: setting
    for setting in (
        *(SPEED_OVERRIDE, LINEAR_SPEED, ANGULAR_SPEED, ACCELERATION_OVERRIDE, JERK_OVERRIDE),
        *(COMPENSATION_GAIN, COMPENSATION_REGION, GROUND_FRICTION),
    )
}
LIMITING: Final = tuple(one.name for one in SETTINGS.values() if one.default is not None)  # below their high they slow
KNOWN: Final = f"must be one of {', '.join(SETTINGS)}"


def of_robot(velocity: Axes) -> dict[str, Setting]:
    """All of them, with the ranges that these limits of velocity leave."""
    vx, vy, wz = velocity.as_twist()
    fastest = ceil(sqrt(vx * vx + vy * vy) * _PER_M_S) / _PER_M_S
    tops = {LINEAR_SPEED.name: fastest, ANGULAR_SPEED.name: wz}
    return SETTINGS | {
        name: SETTINGS[name]._replace(low=round(LEAST_SHARE * top, _DIGITS), high=top, default=top)
        for name, top in tops.items()
    }


def problems(asked: Mapping[str, float], rows: Mapping[str, Setting] = SETTINGS) -> list[str]:
    """What is wrong with values that somebody gives to settings; without `rows` whatever the robot."""
    found = [
        rows[name].refusal(value) if name in rows else f"{name!r}: {KNOWN}{guess(name, rows)}"
        for name, value in asked.items()
    ]
    return [problem for problem in found if problem is not None]


def problems_of_file(given: Mapping[str, float], velocity: Axes | None = None) -> list[str]:
    """The same of the robot file's [settings]; `velocity`: its limits, where they are sound."""
    elsewhere = [
        f"{name}: is said in the section of the robot that has it"
        for name in given
        if name in SETTINGS and SETTINGS[name].default is None
    ]
    return elsewhere or problems(given, SETTINGS if velocity is None else of_robot(velocity))


class Settings:
    """The values now. One writer, the engine. Those of the drive law are the law's, asked of it."""

    def __init__(self, given: Mapping[str, float], law: DriveLaw, velocity: Axes) -> None:
        """`given`: of the robot file; `velocity`: limits of the body."""
        self._rows = of_robot(velocity)
        self._law = law
        # Besides this one only what was given or set: who has not been touched holds nothing back.
        self._own = {SPEED_OVERRIDE.name: 1.0, **given}

    def value(self, setting: Setting) -> float:
        """What it is now."""
        own = self._own.get(setting.name, self._rows[setting.name].default)
        return self._law.settings[setting.name] if own is None else own

    def held(self, setting: Setting) -> float | None:
        """What one that was given or set is now; None: it holds nothing back."""
        return self._own.get(setting.name)

    @property
    def ease(self) -> Ease:
        """Of speeding up."""
        acceleration, jerk = self.held(ACCELERATION_OVERRIDE), self.held(JERK_OVERRIDE)
        if acceleration is None and jerk is None:
            return NO_EASE
        return Ease(1.0 if acceleration is None else acceleration, 1.0 if jerk is None else jerk)

    def set(self, name: str | None, value: float | None) -> str | None:
        """Takes a new value; why not, if not."""
        setting = self._rows.get(name or "")
        if setting is None or value is None or setting.name not in self._names():
            known = self._names()
            return f"setting = {name!r}: must be one of {', '.join(known)}{guess(name or '', known)}"
        refusal = setting.refusal(value)
        if refusal is not None:
            return refusal
        if setting.default is None:
            return self._law.set(setting.name, value)
        self._own[setting.name] = value
        return None

    def describe(self) -> tuple[SettingStatus, ...]:
        """All that this robot has."""
        rows = [self._rows[name] for name in self._names()]
        return tuple([SettingStatus(one.name, self.value(one), one.unit, one.low, one.high) for one in rows])

    def _names(self) -> tuple[str, ...]:
        return (*LIMITING, *self._law.settings)
