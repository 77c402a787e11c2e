"""What stands between the torques of the simulated controllers and the motion of their joints: the plant.

Joints are in the order of the robot file; angles and rates are at the output, angles from the joint's zero; torques
are what really acts there. A plant is deterministic: the same calls give the same bits.
"""

from collections.abc import Sequence
from enum import Enum
from typing import Protocol, runtime_checkable

from gateway.types import Attitude, Pose, Twist


class Plant(Protocol):
    """One robot on its ground. Time goes on by `step` only, one substep of the world (`STEP_S`) each."""

    push: float  # N at the centre of mass, along world x
    slope: float  # rad, rising along world x

    @property
    def wheels(self) -> tuple[int, ...]:
        """Joints that drive a wheel."""
        ...

    @property
    def reflected_inertia(self) -> tuple[float, ...]:
        """Inertia felt at each joint while the others are free and all wheels grip, kg m^2, without any extra load."""
        ...

    @property
    def angles(self) -> tuple[float, ...]:
        """Joint angles, rad, as many turns as were made."""
        ...

    @property
    def rates(self) -> tuple[float, ...]:
        """Joint rates, rad/s."""
        ...

    @property
    def pose(self) -> Pose:
        """Where `base_link` is in the world; at the origin at first."""
        ...

    @property
    def twist(self) -> Twist:
        """Body twist of `base_link`."""
        ...

    @property
    def chassis_angle(self) -> float:
        """World angle of the part that carries the wheels, rad."""
        ...

    @property
    def energy(self) -> float:
        """Kinetic energy, joints included, J."""
        ...

    @property
    def slipping(self) -> tuple[int, ...]:
        """Joints whose wheels slip."""
        ...

    def place(self, angles: Sequence[float]) -> None:
        """Where the joints stand before the first step; nothing moves by it."""
        ...

    def step(self, torques: Sequence[float]) -> None:
        """One substep under constant joint torques, N m."""
        ...

    def can_slip(self, joint: int) -> bool:
        """Whether the joint drives a wheel whose friction can be set."""
        ...

    def set_friction(self, joint: int, friction: float) -> None:
        """Coefficient of friction under a wheel; infinite: it does not slip, and grips at once if it does.

        Raises ValueError for a joint that cannot slip.
        """
        ...

    def set_mass(self, mass: float | None) -> None:
        """So many kg in all, the change over the centre; None: as in the robot file.

        A load put on was at rest before, a load taken off keeps its own momentum.
        """
        ...


class PlantName(Enum):
    """Which plant, as scenarios, commands and sessions have it."""

    SIMPLE = "simple"  # one rigid body on its wheels; every kind has it
    DYNAMICS = "dynamics"  # every body that the robot is made of


class Point(Enum):
    """Where a force can act on a chassis that has such a point."""

    JOINT = "joint"  # of the platform
    CASTER_JOINT = "caster_joint"


@runtime_checkable
class WithCaster(Protocol):
    """A plant with a caster and named points of its chassis; not every one has them."""

    swivel: float  # rad, of the caster's fork against the chassis

    def set_force(self, point: Point, along: float, across: float) -> None:
        """N along the chassis and to its left, turning with it, until told otherwise."""
        ...


@runtime_checkable
class WithSlides(Protocol):
    """A plant whose wheels go apart; not every one does."""

    @property
    def width(self) -> float:
        """Between the middles of the pairs of wheels, m."""
        ...

    @property
    def width_rate(self) -> float:
        """By which they go apart, m/s."""
        ...


@runtime_checkable
class WithAttitude(Protocol):
    """A plant whose body leans; not every one does."""

    @property
    def attitude(self) -> Attitude:
        """How it leans and turns, all of it known."""
        ...
