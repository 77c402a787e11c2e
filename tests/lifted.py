"""A robot whose wheels are off the ground: every joint turns by itself. A plant for tests of commissioning."""

from collections.abc import Sequence

from gateway.config import RobotConfig
from gateway.types import Pose, Twist
from replay.sim.controllers.contract import STEP_S
from replay.sim.plants import plant_of

LIGHTER = 0.25  # of the inertia that a joint feels on the ground
LOOSER = 0.5  # of its drag


class LiftedPlant:
    """The controllers stay tuned to the robot on its wheels."""

    def __init__(self, config: RobotConfig) -> None:
        self.push = self.slope = 0.0
        self._on_wheels = plant_of(config.robot)
        size = len(config.motor)
        body = config.robot.body
        self._inertias = [LIGHTER * inertia for inertia in self._on_wheels.reflected_inertia]
        self._drag, self._friction = LOOSER * body.joint_drag, body.joint_friction
        # Rad/s at which somebody turns or holds a joint; None: nobody does.
        self.by_hand: list[float | None] = [None] * size
        self._turns: dict[int, tuple[float, int]] = {}
        self._angles = [0.0] * size
        self._rates = [0.0] * size

    wheels = ()
    slipping = ()
    pose = Pose(0.0, 0.0, 0.0)
    twist = Twist(0.0, 0.0, 0.0)
    chassis_angle = 0.0
    energy = 0.0

    @property
    def reflected_inertia(self) -> tuple[float, ...]:
        return self._on_wheels.reflected_inertia

    @property
    def angles(self) -> tuple[float, ...]:
        return tuple(self._angles)

    @property
    def rates(self) -> tuple[float, ...]:
        return tuple(self._rates)

    def place(self, angles: Sequence[float]) -> None:
        self._angles = list(angles)

    def step(self, torques: Sequence[float]) -> None:
        for joint, (speed, steps) in list(self._turns.items()):
            self.by_hand[joint] = speed if steps > 0 else 0.0
            self._turns[joint] = (speed, steps - 1)
        for joint, torque in enumerate(torques):
            self._rates[joint] = self._turned(joint, torque)
            self._angles[joint] += self._rates[joint] * STEP_S

    def turn_by_hand(self, joint: int, speed: float, seconds: float) -> None:
        """So fast for so long, then held; from the next step on, whichever thread says so."""
        self._turns[joint] = (speed, round(seconds / STEP_S))

    def _turned(self, joint: int, torque: float) -> float:
        """Dry friction holds what is slow, and never turns it round."""
        held = self.by_hand[joint]
        if held is not None:
            return held
        rate, inertia = self._rates[joint], self._inertias[joint]
        driven = rate + (torque - self._friction * rate) / inertia * STEP_S
        most = self._drag / inertia * STEP_S
        return driven - max(-most, min(most, driven))

    def can_slip(self, joint: int) -> bool:
        return False

    def set_friction(self, joint: int, friction: float) -> None:
        raise ValueError("in the air")

    def set_mass(self, mass: float | None) -> None:
        pass
