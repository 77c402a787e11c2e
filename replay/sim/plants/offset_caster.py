"""The plant of an offset-differential robot with everything that it has of mass: chassis, wheels, platform, caster.

How this works
--------------
`OffsetEquations` says how the three free speeds change; place, swivel and angles follow from the speeds (Runge-Kutta of
fourth order, plain floats, the same bits on every run). Eight coordinates and nothing that could drift off a
constraint. What acts: torques of the joints less their dry friction, viscous friction, a push and a slope on every
body, and forces at named points of the chassis.

Where the ground is slippery (`set_friction`), a wheel has a speed of its own and the ground gives it a traction within
mu times its load: as much as it takes to end the substep without slip, or all there is against the slip. The load is
the one at rest, with the caster where it is (the robot file tells no heights, so acceleration moves none of it).
Only rolling traction can fail: an axle does not slide sideways. No energy is made but the 3e-6 of it by which a
substep may err in which slip ends or a torque jumps.
"""

from collections.abc import Sequence
from math import isinf, sqrt

from gateway.arithmetic import sin_cos
from gateway.chassis.offset_differential import OffsetDifferentialRobot
from gateway.types import Pose, Twist
from replay.sim.controllers.contract import STEP_S
from replay.sim.plants.contract import Point
from replay.sim.plants.offset_equations import Force, Motion, OffsetEquations
from replay.sim.plants.offset_parameters import JOINT, LEFT, RIGHT, SETS, OffsetParameters, trailing

GRAVITY = 9.81  # m/s^2
DRAG_SPEED = 0.05  # rad/s below which dry friction fades, so that a joint at rest stays there
_NO_SLIP = 1e-6  # rad/s
_SAME_TORQUE = 1e-9  # N m by which traction may still change when it is settled
_MAX_ROUNDS = 30
_WHEELS = (LEFT, RIGHT)
_HALF = STEP_S / 2.0
_SIXTH = STEP_S / 6.0


def plant(robot: OffsetDifferentialRobot) -> "OffsetCaster":
    """As the robot file has it; what that does not tell is as in set B, in proportion. Raises ValueError."""
    return OffsetCaster(parameters(robot), drag=robot.body.joint_drag)


def parameters(robot: OffsetDifferentialRobot) -> OffsetParameters:
    """Lengths, total mass, inertias and friction of the file; the masses share the total as those of set B do.

    Raises ValueError for a robot file without a caster, or with one on which the robot could not stand.
    """
    if robot.caster is None:
        raise ValueError("robot.caster is missing: trail, position and radius of the caster, m")
    preset, body, caster = SETS["B"], robot.body, robot.caster
    reach = robot.axle_offset + caster.position
    if caster.trail >= reach:
        raise ValueError(
            f"robot.caster.trail = {caster.trail:g}: must be below {reach:g} m, axle_offset and caster.position: "
            "a caster that trails as far as the axle carries nothing"
        )
    share = body.mass / total_mass(preset)
    size = robot.wheel_radius / preset.wheel_radius
    fork, wheel = share * preset.fork_mass, share * preset.caster_mass
    return preset._replace(
        wheel_radius=robot.wheel_radius,
        axle_offset=robot.axle_offset,
        track=robot.track,
        trail=caster.trail,
        caster_position=caster.position,
        caster_radius=caster.radius,
        chassis_mass=share * preset.chassis_mass,
        chassis_offset=preset.chassis_offset * robot.axle_offset / preset.axle_offset,
        chassis_inertia=robot.chassis_inertia,
        wheel_mass=share * preset.wheel_mass,
        wheel_axial=body.joint_inertia,
        wheel_radial=share * preset.wheel_radial * size * size,
        platform_mass=share * preset.platform_mass,
        platform_inertia=body.inertia,
        fork_mass=fork,
        fork_inertia=fork * caster.trail * caster.trail / 12.0,  # a rod
        caster_mass=wheel,
        caster_axial=wheel * caster.radius * caster.radius / 2.0,  # a disc
        caster_radial=wheel * caster.radius * caster.radius / 4.0,
        friction=(body.joint_friction,) * 3 + (0.0,) * 5,
        joint_inertia=body.joint_inertia,
    )


def total_mass(p: OffsetParameters) -> float:
    """Of all six bodies, kg."""
    return p.chassis_mass + 2.0 * p.wheel_mass + p.platform_mass + p.fork_mass + p.caster_mass


class OffsetCaster:
    """A plant; the writer is `step`.

    `swivel`: of the caster's fork at the start, rad; None: as it trails when the robot has been driven forward.
    `drag`: N m of dry friction at every driven joint.
    """

    wheels = _WHEELS

    def __init__(self, parameters: OffsetParameters, *, swivel: float | None = None, drag: float = 0.0) -> None:
        self.push = 0.0
        self.slope = 0.0
        self.pose = Pose(0.0, 0.0, 0.0)
        self.angles: tuple[float, ...] = (0.0, 0.0, 0.0)
        self.swivel = trailing(pulled=False) if swivel is None else swivel
        self.caster_angle = 0.0
        self._drag = drag
        self._own = self._parameters = parameters
        self._forces: dict[Point, tuple[float, float]] = {}
        self._friction: dict[int, float] = {}  # mu of the wheels on slippery ground
        self._spins: dict[int, float] = {}  # rad/s of these
        self._traction: dict[int, float] = {}  # N m that the ground gave these in the last substep
        self._equations = OffsetEquations(parameters)
        self.reflected_inertia = tuple(self._reflected(joint) for joint in (LEFT, RIGHT, JOINT))
        self.set_velocity((0.0, 0.0, 0.0))

    @property
    def velocity(self) -> Motion:
        """Speed of the platform joint along the chassis, m/s; rates of chassis and platform, rad/s."""
        return self._velocity

    @property
    def coordinates(self) -> tuple[float, ...]:
        """All eight: wheels and platform joint, place of the joint, heading of the platform, swivel, caster wheel."""
        return (*self.angles, *self.pose, self.swivel, self.caster_angle)

    @property
    def twist(self) -> Twist:
        """Body twist of `base_link`: the platform, which has turned by the joint angle on the chassis."""
        along, turn, platform = self._velocity
        across = self._parameters.axle_offset * turn
        s, c = sin_cos(self.angles[JOINT])
        return Twist(along * c + across * s, across * c - along * s, platform)

    @property
    def chassis_angle(self) -> float:
        """World angle of the part that carries the wheels."""
        return self.pose.theta - self.angles[JOINT]

    @property
    def energy(self) -> float:
        """Kinetic energy of all bodies."""
        spinning = [self._parameters.wheel_axial * rate * rate / 2.0 for rate in self._spins.values()]
        energy = self._equations.energy(*sin_cos(self.swivel), self._velocity)
        for one in spinning:
            energy += one
        return energy

    @property
    def momentum(self) -> tuple[float, float]:
        """Of all bodies along world x and y, kg m/s: what the ground and pushes give."""
        along, across = self._equations.momentum(*sin_cos(self.swivel), self._velocity)
        s, c = sin_cos(self.chassis_angle)
        return c * along - s * across, s * along + c * across

    @property
    def slipping(self) -> tuple[int, ...]:
        """Joints whose wheels slip."""
        return tuple(wheel for wheel in _WHEELS if wheel in self._spins and abs(self._slip(wheel)) > _NO_SLIP)

    @property
    def loads(self) -> tuple[float, float]:
        """N under the left and the right wheel."""
        p = self._parameters
        s, c = sin_cos(self.swivel)
        small = p.fork_mass + p.caster_mass
        trailed = (p.fork_mass * p.fork_share + p.caster_mass) * p.trail
        ahead = p.chassis_mass * p.chassis_offset - 2.0 * p.wheel_mass * p.axle_offset
        ahead += small * p.caster_position + trailed * s
        left, mass = -trailed * c, self._mass
        front, side = p.caster_position + p.trail * s, -p.trail * c  # where the caster touches the ground
        on_caster = (ahead + mass * p.axle_offset) / (front + p.axle_offset)
        both, apart = mass - on_caster, (left - on_caster * side) / (p.track / 2.0)
        pull = GRAVITY * sin_cos(self.slope)[1]
        return max(0.0, (both + apart) / 2.0 * pull), max(0.0, (both - apart) / 2.0 * pull)

    def set_velocity(self, velocity: Motion) -> None:
        """Start an experiment in motion; wheels on slippery ground keep their speed."""
        self._velocity = velocity
        self._tell_rates()

    def place(self, angles: Sequence[float]) -> None:
        """Where the joints stand before the first step; the platform stays at the origin."""
        left, right, joint = angles
        self.angles = (left, right, joint)

    def can_slip(self, joint: int) -> bool:
        """Whether the joint drives a wheel that has an inertia of its own."""
        return joint in _WHEELS and self._parameters.wheel_axial > 0.0

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
            self._equations = OffsetEquations(self._parameters, self._spins)

    def set_mass(self, mass: float | None) -> None:
        """Another mass from now on: a load stands on the platform's joint, and was at rest before it was put on.

        A mass below the robot's own makes every body lighter.
        """
        before, old_mass = self._equations, self._mass
        self._parameters = _loaded(self._own, mass)
        self._equations = OffsetEquations(self._parameters, self._spins)
        if self._mass > old_mass:
            s, c = sin_cos(self.swivel)
            self.set_velocity(self._equations.yielding(s, c, before.resistance_to(s, c, self._velocity)))

    def set_force(self, point: Point, along: float, across: float) -> None:
        """N at a point of the chassis, along it and to its left, until told otherwise."""
        self._forces[point] = (along, across)

    def torques_for(self, change: Motion) -> tuple[float, float, float]:
        """N m of the joints with which the three speeds change so, m/s^2 and rad/s^2, friction made up for."""
        return self._equations.torques_for(*sin_cos(self.swivel), self._velocity, change)

    def step(self, torques: Sequence[float]) -> None:
        """One substep under constant joint torques."""
        torques = self._less_drag(torques)
        given = dict(self._traction)
        force = self._force([given.get(joint, torque) for joint, torque in enumerate(torques)])
        before, spins = self.angles, dict(self._spins)
        self._move(force)
        if spins:
            self._turn_loose_wheels(torques, given)
            self._give_traction()
            angles = list(self.angles)
            for wheel, rate in spins.items():
                angles[wheel] = before[wheel] + _HALF * (rate + self._spins[wheel])
            self.angles = tuple(angles)
        self._tell_rates()

    # the equations of motion

    @property
    def _mass(self) -> float:
        return total_mass(self._parameters)

    def _reflected(self, joint: int) -> float:
        s, c = sin_cos(self.swivel)
        torques = [0.0, 0.0, 0.0]
        torques[joint] = 1.0
        yielding = self._equations.yielding(s, c, self._equations.driven(*torques))
        return 1.0 / self._equations.joint_rates(yielding)[joint]

    def _less_drag(self, torques: Sequence[float]) -> Sequence[float]:
        """Of the joints that are held to the motion."""
        if not self._drag:
            return torques
        return [
            torque if joint in self._spins else torque - self._drag * rate / _softened(rate)
            for joint, (torque, rate) in enumerate(zip(torques, self.rates, strict=True))
        ]

    def _force(self, torques: Sequence[float]) -> Force:
        """Of motors and of forces at points, along the three speeds."""
        along, turning, platform = self._equations.driven(*torques)
        for point, (ahead, across) in self._forces.items():
            along += ahead
            turning += self._lever(point) * across
        return along, turning, platform

    def _lever(self, point: Point) -> float:
        """m ahead of the axle."""
        p = self._parameters
        return p.axle_offset + (p.caster_position if point is Point.CASTER_JOINT else 0.0)

    def _field(self) -> float:
        """m/s^2 along world x that everything is given."""
        if not self.push and not self.slope:
            return 0.0
        return self.push / self._mass - GRAVITY * sin_cos(self.slope)[0]

    def _slopes(
        self, heading: float, swivel: float, motion: Motion, force: Force, field: float
    ) -> tuple[Motion, float, float, float, float]:
        """Changes of the three speeds, rates of swivel and caster, velocity of the joint in the world."""
        equations = self._equations
        s, c = sin_cos(swivel)
        heading_s, heading_c = sin_cos(heading)
        if field:
            along, turning, platform = equations.weight(s, c, field * heading_c, -field * heading_s)
            force = (force[0] + along, force[1] + turning, force[2] + platform)
        change = equations.acceleration(s, c, motion, force)
        swivels, rolls = equations.caster_rates(s, c, motion)
        along, across = motion[0], self._parameters.axle_offset * motion[1]
        return change, swivels, rolls, heading_c * along - heading_s * across, heading_s * along + heading_c * across

    def _move(self, force: Force) -> None:
        """Advance speeds, pose, angles and caster (Runge-Kutta)."""
        slopes, field = self._slopes, self._field()
        v, w, platform = self._velocity
        heading, swivel = self.chassis_angle, self.swivel
        (v1, w1, p1), b1, r1, x1, y1 = slopes(heading, swivel, self._velocity, force, field)
        second = (v + _HALF * v1, w + _HALF * w1, platform + _HALF * p1)
        (v2, w2, p2), b2, r2, x2, y2 = slopes(heading + _HALF * w, swivel + _HALF * b1, second, force, field)
        third = (v + _HALF * v2, w + _HALF * w2, platform + _HALF * p2)
        (v3, w3, p3), b3, r3, x3, y3 = slopes(heading + _HALF * second[1], swivel + _HALF * b2, third, force, field)
        fourth = (v + STEP_S * v3, w + STEP_S * w3, platform + STEP_S * p3)
        (v4, w4, p4), b4, r4, x4, y4 = slopes(heading + STEP_S * third[1], swivel + STEP_S * b3, fourth, force, field)
        self._velocity = (
            v + _SIXTH * (v1 + 2.0 * (v2 + v3) + v4),
            w + _SIXTH * (w1 + 2.0 * (w2 + w3) + w4),
            platform + _SIXTH * (p1 + 2.0 * (p2 + p3) + p4),
        )
        # What was covered along, turned, and turned by the platform: the mean of the four speeds.
        mean = (
            STEP_S * v + STEP_S * _SIXTH * (v1 + v2 + v3),
            STEP_S * w + STEP_S * _SIXTH * (w1 + w2 + w3),
            STEP_S * platform + STEP_S * _SIXTH * (p1 + p2 + p3),
        )
        x, y, theta = self.pose
        self.pose = Pose(
            x + _SIXTH * (x1 + 2.0 * (x2 + x3) + x4), y + _SIXTH * (y1 + 2.0 * (y2 + y3) + y4), theta + mean[2]
        )
        self.angles = tuple(
            [angle + turn for angle, turn in zip(self.angles, self._equations.joint_rates(mean), strict=True)]
        )
        self.swivel = swivel + _SIXTH * (b1 + 2.0 * (b2 + b3) + b4)
        self.caster_angle += _SIXTH * (r1 + 2.0 * (r2 + r3) + r4)

    def _tell_rates(self) -> None:
        rates = self._equations.joint_rates(self._velocity)
        if self._spins:
            rates = (self._spins.get(LEFT, rates[LEFT]), self._spins.get(RIGHT, rates[RIGHT]), rates[JOINT])
        self.rates: tuple[float, ...] = rates

    # wheels on slippery ground

    def _turn_loose_wheels(self, torques: Sequence[float], given: dict[int, float]) -> None:
        """A wheel by itself: what its motor gives and the ground does not take.

        Friction is that of the mean of both speeds, so that it turns no wheel round, however light it is.
        """
        inertia = self._parameters.wheel_axial
        for wheel, rate in self._spins.items():
            slowing = self._parameters.friction[wheel] + self._drag / _softened(rate)
            spare = torques[wheel] - given[wheel]
            self._spins[wheel] = rate + STEP_S * (spare - slowing * rate) / (inertia + _HALF * slowing)

    def _give_traction(self) -> None:
        """Correct the traction, and with it the speeds, wheel by wheel until nothing changes."""
        contacts = [self._contact(wheel) for wheel in self._spins]
        inertia, spins = self._parameters.wheel_axial, self._spins
        v, w, platform = self._velocity
        for _ in range(_MAX_ROUNDS):
            largest = 0.0
            for wheel, (along, turning), (reach_v, reach_w, reach_platform), yielding, limit in contacts:
                slip = spins[wheel] - (along * v + turning * w)
                given = self._traction[wheel]
                change = max(-limit, min(limit, given + slip / (STEP_S * yielding))) - given
                self._traction[wheel] = given + change
                impulse = STEP_S * change
                spins[wheel] -= impulse / inertia
                v, w, platform = v + impulse * reach_v, w + impulse * reach_w, platform + impulse * reach_platform
                largest = max(largest, abs(change))
            if largest <= _SAME_TORQUE:
                break
        self._velocity = (v, w, platform)

    def _contact(self, wheel: int) -> tuple[int, tuple[float, float], Motion, float, float]:
        """Its row, what an impulse of 1 N m s does to the three speeds and to the slip, and the largest traction."""
        p = self._parameters
        torques = [0.0, 0.0, 0.0]
        torques[wheel] = 1.0
        along, turning, _ = pull = self._equations.driven(*torques)
        s, c = sin_cos(self.swivel)
        reach = self._equations.yielding(s, c, pull)
        yielding = 1.0 / p.wheel_axial + along * reach[0] + turning * reach[1]
        return wheel, (along, turning), reach, yielding, self._friction[wheel] * self.loads[wheel] * p.wheel_radius

    def _slip(self, wheel: int) -> float:
        return self._spins[wheel] - self._equations.joint_rates(self._velocity)[wheel]

    def _grip(self, wheel: int) -> None:
        """The wheel is held to its row again, as in a plastic impact: wheel and body keep their momentum together."""
        spin = self._parameters.wheel_axial * self._spins.pop(wheel)
        self._traction.pop(wheel)
        s, c = sin_cos(self.swivel)
        torques = [0.0, 0.0, 0.0]
        torques[wheel] = spin
        momentum = self._equations.resistance_to(s, c, self._velocity)
        pull = self._equations.driven(*torques)
        self._equations = OffsetEquations(self._parameters, self._spins)
        a, b, d = (one + two for one, two in zip(momentum, pull, strict=True))
        self.set_velocity(self._equations.yielding(s, c, (a, b, d)))


def _loaded(own: OffsetParameters, mass: float | None) -> OffsetParameters:
    """The robot of so many kg."""
    if mass is None:
        return own
    load = mass - total_mass(own)
    if load >= 0.0:
        return own._replace(platform_mass=own.platform_mass + load)
    share = mass / total_mass(own)
    return own._replace(
        chassis_mass=share * own.chassis_mass,
        wheel_mass=share * own.wheel_mass,
        platform_mass=share * own.platform_mass,
        fork_mass=share * own.fork_mass,
        caster_mass=share * own.caster_mass,
    )


def _softened(rate: float) -> float:
    """The size of a motion, but never near zero: dry friction fades towards rest. The root is exact everywhere."""
    return sqrt(DRAG_SPEED * DRAG_SPEED + rate * rate)
