"""The plant of a robot on omni wheels with everything that it has of inertia: body, wheels, the rollers on the floor.

How this works
--------------
`OmniEquations` says how the three speeds of the body change; wheels on good ground are held to them. Where the ground
is slippery (`set_friction`), a wheel has a speed of its own and the ground gives it a traction within mu times its
load: as much as it takes to end the substep without slip, or all there is against the slip. That is Coulomb's law
exactly; with `stribeck` the coefficient falls while the wheel slips. Only rolling traction can fail: the rollers let
a wheel move along its axle, and what little they resist is always held.

Loads are those of a rigid body at rest in its own accelerated frame (`Standing`): what the ground gives acts below the
centre of mass and shifts load to the wheels behind, by `centre_height`; where that is unknown, none. Only what the
ground gives does: a push acts at the centre. The reaction to the spinning up of wheels is left out, as most of that
inertia is the rotor's, of whose momentum the body feels one part in the gear ratio. In each substep the loads go half
of the way to where they belong, as on a tyre: else a high robot's wheels could chatter.

No energy is made but the 1e-5 of it by which a substep may err in which slip ends or a torque jumps.
"""

from collections.abc import Sequence
from math import isinf, sqrt
from typing import NamedTuple

from gateway.arithmetic import exponential, sin_cos
from gateway.chassis.omni import OmniRobot
from gateway.types import Pose, Twist
from replay.sim.controllers.contract import STEP_S
from replay.sim.plants.omni_equations import Force, Motion, OmniEquations
from replay.sim.plants.omni_loads import Standing
from replay.sim.plants.omni_parameters import OmniParameters, parameters

GRAVITY = 9.81  # m/s^2
DRAG_SPEED = 0.05  # rad/s below which dry friction fades, so that a joint at rest stays there
_NO_SLIP = 1e-6  # rad/s
_SAME_TORQUE = 1e-9  # N m by which traction may still change when it is settled
_MAX_ROUNDS = 100
_FAST_SLIP = 6.0  # in Stribeck speeds: nothing is left of what friction has more at rest (e^-36)
_HALF = STEP_S / 2.0


class Stribeck(NamedTuple):
    """How friction falls with slip: mu (kinetic + (1 - kinetic) e^-(v/speed)^2)."""

    kinetic: float  # share that is left at speed
    speed: float  # m/s of slip


class _Contact(NamedTuple):
    """A wheel on slippery ground, and what 1 N m of traction changes."""

    joint: int
    row: Motion
    reach: Motion  # of the speeds' changes
    yielding: float  # of the slip's rate, rad/s^2
    lightness: float  # 1/(kg m^2) of the wheel
    radius: float


def plant(robot: OmniRobot) -> "OmniDynamics":
    """As the robot file has it. Raises ValueError for wheels in one line."""
    return OmniDynamics(parameters(robot))


class OmniDynamics:
    """A plant; the writer is `step`. Raises ValueError for wheels in one line."""

    def __init__(self, parameters: OmniParameters) -> None:
        self.push = 0.0
        self.slope = 0.0
        self.stribeck: Stribeck | None = None
        self.pose = Pose(0.0, 0.0, 0.0)
        self.wheels = tuple(range(len(parameters.wheels)))
        self.angles: tuple[float, ...] = (0.0,) * len(self.wheels)
        self._own = self._parameters = parameters
        self._standing = Standing([(wheel.x, wheel.y) for wheel in parameters.wheels])
        self._friction: dict[int, float] = {}  # mu of the wheels on slippery ground
        self._spins: dict[int, float] = {}  # rad/s of these
        self._traction: dict[int, float] = {}  # N m that the ground gave these in the last substep
        self._build()
        self.reflected_inertia = tuple([self._reflected(joint) for joint in self.wheels])
        self.set_velocity((0.0, 0.0, 0.0))
        self.loads = self._loads_at_rest()

    @property
    def velocity(self) -> Motion:
        """Of the centre, m/s in body axes, and of turning, rad/s."""
        return self._velocity

    @property
    def twist(self) -> Twist:
        """Body twist of `base_link`."""
        return Twist(*self._velocity)

    @property
    def chassis_angle(self) -> float:
        """World angle of the body."""
        return self.pose.theta

    @property
    def energy(self) -> float:
        """Kinetic energy of body, wheels and rollers."""
        energy = self._equations.energy(self._velocity)
        for joint, rate in self._spins.items():
            energy += self._parameters.wheels[joint].spin_inertia * rate * rate / 2.0
        return energy

    @property
    def slipping(self) -> tuple[int, ...]:
        """Joints whose wheels slip."""
        held = self._equations.joint_rates(self._velocity)
        return tuple(
            [joint for joint in self.wheels if abs(self._spins.get(joint, held[joint]) - held[joint]) > _NO_SLIP]
        )

    def set_velocity(self, velocity: Motion) -> None:
        """Start an experiment in motion; wheels on slippery ground keep their speed."""
        self._velocity = velocity
        self._tell_rates()

    def place(self, angles: Sequence[float]) -> None:
        """Where the joints stand before the first step."""
        self.angles = tuple(angles)

    def can_slip(self, joint: int) -> bool:
        """Whether the wheel has an inertia of its own."""
        return joint in self.wheels and self._parameters.wheels[joint].spin_inertia > 0.0

    def set_friction(self, joint: int, friction: float) -> None:
        """Coefficient of friction under a wheel; infinite: it never slips, and grips at once if it does."""
        if not self.can_slip(joint):
            raise ValueError(f"joint {joint}: only a wheel with inertia can slip")
        if isinf(friction):
            self._friction.pop(joint, None)
            if joint in self._spins:
                self._grip(joint)
            return
        self._friction[joint] = friction
        if joint not in self._spins:
            self._traction[joint] = 0.0
            self._spins[joint] = self.rates[joint]
            self._build()

    def set_mass(self, mass: float | None) -> None:
        """Another mass from now on: a load put on was at rest before, a load taken off keeps its own momentum."""
        before, old_mass = self._equations, self._parameters.mass
        self._parameters = self._own if mass is None else self._own._replace(mass=mass)
        self._build()
        if self._parameters.mass > old_mass:
            self.set_velocity(self._equations.yielding(before.resistance_to(self._velocity)))
        self.loads = self._loads_at_rest()

    def step(self, torques: Sequence[float]) -> None:
        """One substep under constant joint torques."""
        before, outer = self._velocity, self._outer_force()
        torques = self._less_drag(torques)
        x, y, turning = self._equations.driven(
            [self._traction.get(joint, torque) for joint, torque in enumerate(torques)]
        )
        after = self._equations.after(before, (x + outer[0], y + outer[1], turning), STEP_S)
        rates = self.rates
        if self._spins:
            self._turn_loose_wheels(torques)
            after = self._with_traction(after)
        self._velocity = after
        self._tell_rates()
        self._move(before, rates)
        self._shift_loads(before, outer)

    # the equation of motion

    def _build(self) -> None:
        """The equations of the wheels that are held now, and the contacts of the others."""
        self._equations = OmniEquations(self._parameters, self._spins)
        self._contacts = tuple([self._contact(joint) for joint in self._spins])

    def _contact(self, joint: int) -> _Contact:
        wheel, row = self._parameters.wheels[joint], self._equations.rows[joint]
        reach = self._equations.yielding(row)
        lightness = 1.0 / wheel.spin_inertia
        yielding = lightness + row[0] * reach[0] + row[1] * reach[1] + row[2] * reach[2]
        return _Contact(joint, row, reach, yielding, lightness, wheel.radius)

    def _reflected(self, joint: int) -> float:
        a, b, c = row = self._equations.rows[joint]
        x, y, turning = self._equations.yielding(row)
        return 1.0 / (a * x + b * y + c * turning)

    def _outer_force(self) -> tuple[float, float]:
        """N of push and weight along world x, seen from the body in the middle of the substep."""
        if not self.push and not self.slope:
            return 0.0, 0.0
        force = self.push - self._parameters.mass * GRAVITY * sin_cos(self.slope)[0]
        s, c = sin_cos(self.pose.theta + _HALF * self._velocity[2])
        return force * c, -force * s

    def _less_drag(self, torques: Sequence[float]) -> Sequence[float]:
        """Of the wheels that are held to the motion."""
        drag = self._parameters.drag
        if not drag:
            return torques
        return [
            torque if joint in self._spins else torque - drag * rate / _softened(rate)
            for joint, (torque, rate) in enumerate(zip(torques, self.rates, strict=True))
        ]

    def _tell_rates(self) -> None:
        rates = self._equations.joint_rates(self._velocity)
        if self._spins:
            rates = tuple([self._spins.get(joint, rate) for joint, rate in enumerate(rates)])
        self.rates: tuple[float, ...] = rates

    def _move(self, before: Motion, rates: Sequence[float]) -> None:
        """Advance angles and pose with the mean of the speeds before and now, in the heading of mid-step."""
        vx, vy, w = [_HALF * (old + new) for old, new in zip(before, self._velocity, strict=True)]
        x, y, theta = self.pose
        s, c = sin_cos(theta + w / 2.0)
        self.pose = Pose(x + c * vx - s * vy, y + s * vx + c * vy, theta + w)
        self.angles = tuple(
            [angle + _HALF * (old + new) for angle, old, new in zip(self.angles, rates, self.rates, strict=True)]
        )

    # the floor

    def _turn_loose_wheels(self, torques: Sequence[float]) -> None:
        """A wheel by itself: what its motor gives and the ground does not take.

        Friction is that of the mean of both speeds, so that it turns no wheel round, however light it is.
        """
        friction, drag = self._parameters.friction, self._parameters.drag
        for joint, rate in self._spins.items():
            slowing = friction + drag / _softened(rate)
            spare = torques[joint] - self._traction[joint]
            inertia = self._parameters.wheels[joint].spin_inertia
            self._spins[joint] = rate + STEP_S * (spare - slowing * rate) / (inertia + _HALF * slowing)

    def _with_traction(self, velocity: Motion) -> Motion:
        """Correct the traction, and with it the speeds, wheel by wheel until nothing changes.

        It starts from that of the substep before, and a wheel is light against what it drives: a few rounds are enough.
        """
        limits = [self._largest_traction(contact) for contact in self._contacts]
        spins, traction = self._spins, self._traction
        vx, vy, w = velocity
        for _ in range(_MAX_ROUNDS):
            largest = 0.0
            for (joint, (a, b, c), (x, y, turning), yielding, lightness, _), limit in zip(
                self._contacts, limits, strict=True
            ):
                given = traction[joint]
                slip = spins[joint] - (a * vx + b * vy + c * w)
                change = max(-limit, min(limit, given + slip / (STEP_S * yielding))) - given
                traction[joint] = given + change
                impulse = STEP_S * change
                spins[joint] -= impulse * lightness
                vx, vy, w = vx + impulse * x, vy + impulse * y, w + impulse * turning
                largest = max(largest, abs(change))
            if largest <= _SAME_TORQUE:
                break
        return vx, vy, w

    def _largest_traction(self, contact: _Contact) -> float:
        """N m that the ground can give this wheel, at the slip of the substep before."""
        friction, stribeck = self._friction[contact.joint], self.stribeck
        if stribeck is not None:
            a, b, c = contact.row
            vx, vy, w = self._velocity
            slip = contact.radius * (self.rates[contact.joint] - (a * vx + b * vy + c * w))
            friction *= _stribeck(stribeck, slip)
        return friction * self.loads[contact.joint] * contact.radius

    def _loads_at_rest(self) -> tuple[float, ...]:
        return self._standing.loads(self._weight)

    @property
    def _weight(self) -> float:
        """N on the floor."""
        return self._parameters.mass * GRAVITY * sin_cos(self.slope)[1]

    def _shift_loads(self, before: Motion, outer: tuple[float, float]) -> None:
        """Half of the way to where they belong under what the ground gives."""
        mass, height = self._parameters.mass, self._parameters.centre_height or 0.0
        (old_x, old_y, old_w), (vx, vy, w) = before, self._velocity
        turn = (old_w + w) / 2.0
        along = mass * ((vx - old_x) / STEP_S - turn * (old_y + vy) / 2.0) - outer[0]
        across = mass * ((vy - old_y) / STEP_S + turn * (old_x + vx) / 2.0) - outer[1]
        due = self._standing.loads(self._weight, -height * along, -height * across)
        self.loads = tuple([(old + new) / 2.0 for old, new in zip(self.loads, due, strict=True)])

    def _grip(self, joint: int) -> None:
        """The wheel is held to its row again, as in a plastic impact: wheel and body keep their momentum together."""
        momentum: Force = self._equations.resistance_to(self._velocity)
        spin = self._parameters.wheels[joint].spin_inertia * self._spins.pop(joint)
        self._traction.pop(joint)
        a, b, c = self._equations.rows[joint]
        self._build()
        x, y, turning = momentum
        self.set_velocity(self._equations.yielding((x + spin * a, y + spin * b, turning + spin * c)))


def _stribeck(law: Stribeck, slip: float) -> float:
    """Share of the friction at rest."""
    relative = abs(slip) / law.speed
    if relative > _FAST_SLIP:
        return law.kinetic
    return law.kinetic + (1.0 - law.kinetic) * exponential(-relative * relative)


def _softened(rate: float) -> float:
    """The size of a motion, but never near zero: dry friction fades towards rest. The root is exact everywhere."""
    return sqrt(DRAG_SPEED * DRAG_SPEED + rate * rate)
