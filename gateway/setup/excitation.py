"""Turns one motor as `jog` does, by steps of speed, and keeps what was told and measured: how it answers. Pure.

For motors whose speed loop is ours. It is bounded as a jog is, by the same code: by the way, by the speed, by the share
of torque and by that of the gains of the robot file. The steps are short against half a turn and long against the loop.
"""

from typing import Final, NamedTuple

from gateway.config import RobotConfig
from gateway.control.drive_law import Measured
from gateway.setup.course import Course, stairs
from gateway.setup.jog import FASTEST, Jog, JogError, Phase

SECONDS: Final = 3.1  # at top speed all the time it would be what a jog may turn at most
LOW: Final = 0.4  # of the speed, the lower of the two
RISE: Final = 0.1  # of the time
STEP: Final = 0.25  # s


class Told(NamedTuple):
    """One cycle: ns; rad and rad/s at the output, None if not told; N m at the output, told from now on.

    Of a motor that is told voltages those that its voltage would give at rest: its windings brake what turns.
    """

    now_ns: int
    position: float | None
    speed: float | None
    torque: float


class Excitation(Jog):
    """One motor of a robot file. Raises JogError, or ConfigError, before anything is sent."""

    def __init__(self, config: RobotConfig, motor: str) -> None:
        check_hosted(config, motor)
        super().__init__(
            config, motor, speed=min(FASTEST, config.limits.motor_speed.get(motor, FASTEST)), seconds=SECONDS
        )
        self.told: list[Told] = []
        gear = self._robot.transmissions[self._place]
        self.damping = 0.0  # N m per rad/s at the output, with which its windings brake at a voltage
        if gear.winding is not None:
            self.damping = gear.winding.back_emf / gear.winding.volts_per_torque * gear.ratio * gear.ratio

    @property
    def way(self) -> float:
        """Rad at the output that it will turn."""
        return self._plan.at(self._plan.seconds)[1]

    @property
    def top(self) -> float:
        """Rad/s at the output, at most."""
        return self._plan.top

    def _course(self, top: float, seconds: float) -> Course:
        return stairs(top, seconds, low=LOW, ramp=RISE, step=STEP)

    def _note(self, measured: Measured) -> None:
        if self.phase in (Phase.TURN, Phase.REST):
            speed, torque = measured.speeds[self._place], self._motors.wanted[self._place] or 0.0
            self.told.append(
                Told(measured.now_ns, measured.positions[self._place], speed, torque + self.damping * (speed or 0.0))
            )


def check_hosted(config: RobotConfig, motor: str) -> None:
    """Raises JogError where the speed loop is not ours."""
    one = next((one for one in config.motor if one.name == motor), None)
    if one is not None and one.speed_loop is None:
        raise JogError(
            f"motor {motor}: a controller of {one.driver} {one.variant} has a speed loop of its own, and the gains are "
            "set in it, with its maker's tool; there is nothing to tune in the robot file"
        )
