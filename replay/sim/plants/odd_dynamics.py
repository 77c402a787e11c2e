"""The plant of an ODD with everything that it has: halves on slides, wheels that slip, and a body that leans.

How this works
--------------
`OddBodies` says how five speeds change; wheels on good ground are held to them, with their joints' inertia. A joint's
angle is that of the wheel against the body, as its encoder tells it: the wheel's own turn less the pitch. So a body
that nods forward over wheels at rest turns its joints backward, a motor's torque acts on the body with the opposite
sign, and every row of the joints has -1 for the pitch rate. (The joint's inertia is that of its rotor for the most
part, which turns against the body; so all of it counts for the joint's rate.)

On ball casters the pitch is held at zero. Without them the body falls as it likes until it is `FALLEN` from upright:
there it comes to rest at once, and lies until it is made to `lean` again. While nothing drives a robot that leans by
less than `REACHED`, somebody holds it as it is, unless it is not `attended`. A body that lies takes half of the weight
and drags over the floor; its wheels turn as before, and take its reaction to the floor.

Wheels on slippery ground (`set_friction`) have a speed of their own: the ground pushes them along their rollers' axles
by what ends the substep without slip (or with their creep: as elastic wheels do, they slip in proportion to speed and
push), or by mu times their load. Loads are those of a rigid robot whose wheels are in
one line: weight and what the floor gives sideways at the height of the centre of mass, half of the way per substep. The
balls of the casters, where their reach is known, take what tips the robot forward or back and so much of the weight.
Rollers resist what their pair moves sideways.

The width stops dead at the ends of the slides, and is held there while it is pressed outwards. Explicit midpoint rule.
"""

from collections.abc import Sequence
from math import isinf, radians, sqrt
from typing import NamedTuple

from gateway.arithmetic import angle_of, arcsine, dot, sin_cos
from gateway.chassis.odd import OddRobot
from gateway.types import Attitude, Pose, Twist
from replay.sim.controllers.contract import STEP_S
from replay.sim.plants.odd_bodies import (
    PITCH,
    SIZE,
    WIDTH,
    Leaning,
    OddBodies,
    OddParameters,
    Rates,
    inverse,
    parameters,
    softened,
)

GRAVITY = 9.81  # m/s^2
FALLEN = radians(60.0)
REACHED = 0.2  # rad
_NO_TORQUE = 1e-6  # N m
_LYING_DRAG = 0.4  # N per N of the weight that lies
_LYING_SHARE = 0.5
_SLOW_JOINT = 0.05  # rad/s below which dry friction fades
_SLOW = 0.01  # m/s, of slides, rollers and a body that drags
_NO_SLIP = 1e-6  # rad/s
_SAME_TORQUE = 1e-9  # N m
_MAX_ROUNDS = 100
_HALF = 0.5 * STEP_S
_SIDES = (0.5, 0.5, -0.5, -0.5)  # of the width's rate that a wheel moves to the left with


def plant(robot: OddRobot, leaning: Leaning | None = None) -> "OddDynamics":
    """As the robot file has it; `leaning`: instead of what it says of a robot that balances."""
    made = OddDynamics(parameters(robot, leaning or leaning_of(robot)), width=robot.width)
    made.attended = robot.balance is not None
    return made


def leaning_of(robot: OddRobot) -> Leaning | None:
    """As the robot file has it; None: on ball casters."""
    balance = robot.balance
    return None if balance is None else Leaning(balance.height, balance.pitch_inertia)


class _Middle(NamedTuple):
    """The middle of a substep: where the robot is, and what follows from that."""

    width: float
    pitch: float
    rows: list[Rates]  # of the joints: rad/s per unit of each speed
    bodies: list[Rates]  # their matrix
    yielding: list[Rates]  # inverse of everything that is held together
    outer: Rates  # push and weight, and what lies on the floor resists


class _Contact(NamedTuple):
    """A wheel on slippery ground at the end of a substep."""

    joint: int
    row: Rates
    reach: Rates  # what 1 N m of traction changes of the speeds, per s
    limit: float  # N m that the ground gives at most
    creep: float  # rad/s of slip per N m


class _Next(NamedTuple):
    """What a substep ends with. `mean`: speeds in it; `creeps`: slip that is creep."""

    width: float
    u: Rates
    mean: Rates
    spins: dict[int, float]
    traction: dict[int, float]
    creeps: dict[int, float]


class OddDynamics:
    """A plant; the writer is `step`. `loads`: N on each wheel. `fallen`: it lies. `attended`: somebody is there."""

    def __init__(self, parameters: OddParameters, *, width: float) -> None:
        self.push = 0.0
        self.slope = 0.0
        self.pose = Pose(0.0, 0.0, 0.0)
        self.width = width
        self.pitch = 0.0  # rad from the normal of the floor, forward and down
        self.fallen = False
        self.attended = False
        self._propped = False
        self.angles: tuple[float, ...] = (0.0,) * 4
        self._own = self._parameters = parameters
        self._bodies = OddBodies(parameters)
        self._u: Rates = [0.0] * SIZE
        self._friction: dict[int, float] = {}
        self._spins: dict[int, float] = {}
        self._traction: dict[int, float] = {}
        self._creeps: dict[int, float] = {}
        self._cosines = tuple([1.0 / sqrt(1.0 + tangent * tangent) for tangent in parameters.tangents])
        self._grips = [
            parameters.radius * cosine for cosine in self._cosines
        ]  # levers of the push along the rollers' axles
        self.loads = self._due_loads(self._weight(), 0.0)
        yielding = inverse(self._matrix_now(), self._held())
        self.reflected_inertia = tuple([1.0 / dot(row, _times(yielding, row)) for row in self._rows(width)])

    @property
    def wheels(self) -> tuple[int, ...]:
        """All of them."""
        return (0, 1, 2, 3)

    @property
    def twist(self) -> Twist:
        """Of the middle of the axle, m/s along and across the heading, and rad/s."""
        return Twist(self._u[0], self._u[1], self._u[2])

    @property
    def width_rate(self) -> float:
        """By which the pairs go apart, m/s."""
        return self._u[WIDTH]

    @property
    def pitch_rate(self) -> float:
        """Forward and down, rad/s."""
        return self._u[PITCH]

    @property
    def attitude(self) -> Attitude:
        """Against the plumb line, so a slope counts; rates are those of a gyroscope in the body."""
        x, y, z = self._up(self.pose.theta)
        s, c = sin_cos(self.pitch)
        _, _, wz, _, nod = self._u
        return Attitude(angle_of(y, s * x + c * z), -arcsine(c * x - s * z), -s * wz, nod, c * wz)

    @property
    def rates(self) -> tuple[float, ...]:
        """Of the wheels against the body, rad/s."""
        rows = self._rows(self.width)
        return tuple([self._spins.get(joint, dot(row, self._u)) for joint, row in enumerate(rows)])

    @property
    def chassis_angle(self) -> float:
        """The body carries its wheels."""
        return self.pose.theta

    @property
    def energy(self) -> float:
        """Kinetic energy, joints included, J."""
        energy = dot(_times(self._matrix_now(), self._u), self._u)
        for rate in self._spins.values():
            energy += self._parameters.joint_inertia * rate * rate
        return 0.5 * energy

    @property
    def slipping(self) -> tuple[int, ...]:
        """Joints whose wheels slip, and do not only creep."""
        rows, found = self._rows(self.width), []
        for joint in sorted(self._spins):
            slip = self._spins[joint] - dot(rows[joint], self._u) - self._creeps.get(joint, 0.0)
            if abs(slip) > _NO_SLIP:
                found.append(joint)
        return tuple(found)

    def place(self, angles: Sequence[float]) -> None:
        """Where the joints stand before the first step."""
        self.angles = tuple(angles)

    def lean(self, pitch: float, rate: float = 0.0) -> None:
        """Somebody holds the body so and lets go: rad from the floor's normal; its wheels stay as they turn.

        Raises ValueError on ball casters, and where it would lie.
        """
        if self._parameters.leaning is None:
            raise ValueError("a robot on ball casters does not lean")
        if not abs(pitch) < FALLEN:
            raise ValueError(f"pitch = {pitch:g} rad: must be less than {FALLEN:.3g}, where it lies")
        nod = pitch - self.pitch
        self.angles = tuple([angle - nod for angle in self.angles])
        self._spins = {joint: spin - (rate - self._u[PITCH]) for joint, spin in self._spins.items()}
        self.pitch, self._u[PITCH], self.fallen = pitch, rate, False

    def can_slip(self, joint: int) -> bool:
        """A wheel with an inertia of its own can."""
        return joint in self.wheels and self._parameters.joint_inertia > 0.0

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
        self._traction.setdefault(joint, 0.0)
        self._spins.setdefault(joint, self.rates[joint])

    def set_mass(self, mass: float | None) -> None:
        """Another mass, the change at the height of the centre and not on the slides.

        A load put on was at rest before, one taken off keeps its own momentum.
        """
        before, old = self._matrix_now(), self._parameters.mass
        load = self._own.load if mass is None else mass - self._own.left - self._own.right
        self._parameters = self._own._replace(load=load)
        self._bodies = OddBodies(self._parameters)
        if self._parameters.mass > old:
            self._u = _times(inverse(self._matrix_now(), self._held()), _times(before, self._u))
        self.loads = self._due_loads(self._weight(), 0.0)

    def step(self, torques: Sequence[float]) -> None:
        """One substep under constant joint torques, N m."""
        self._propped = self.attended and abs(self.pitch) < REACHED and all(abs(one) < _NO_TORQUE for one in torques)
        if self._propped:
            self._u[PITCH] = 0.0
        held, outward = self._held(), self._outward()
        middle = self._middle(held)
        after = self._after(middle, torques)
        if outward and after.u[WIDTH] * outward > 0.0:  # pressed against its stop
            middle = self._middle((*held, WIDTH))
            after = self._after(middle, torques)
        if self._friction or self._parameters.roller_drag:
            self._shift_loads(middle, after.u)
        self._move(middle, after)
        self._u, self._spins, self._traction, self._creeps = after.u, after.spins, after.traction, after.creeps
        self._end(middle)

    # the equation of motion

    def _held(self) -> tuple[int, ...]:
        return (PITCH,) if self._parameters.leaning is None or self.fallen or self._propped else ()

    def _rows(self, width: float) -> list[Rates]:
        p = self._parameters
        scale = 1.0 / p.radius
        return [
            [scale, scale * tangent, -scale * place, scale * side * tangent, -1.0]
            for tangent, place, side in zip(p.tangents, p.places(width), _SIDES, strict=True)
        ]

    def _together(self, bodies: Sequence[Sequence[float]], rows: Sequence[Rates]) -> list[Rates]:
        """With the inertia of the joints that are held to the motion."""
        gripping = [row for joint, row in enumerate(rows) if joint not in self._spins]
        inertia, together = self._parameters.joint_inertia, [list(row) for row in bodies]
        for row in gripping:
            for line, one in zip(together, row, strict=True):
                much = inertia * one
                for place, two in enumerate(row):
                    line[place] += much * two
        return together

    def _matrix_now(self) -> list[Rates]:
        return self._together(self._bodies.matrix(self.width, self.pitch), self._rows(self.width))

    def _middle(self, held: tuple[int, ...]) -> _Middle:
        u = self._u
        width, pitch = self.width + _HALF * u[WIDTH], self.pitch + _HALF * u[PITCH]
        rows, bodies = self._rows(width), self._bodies.matrix(width, pitch)
        yielding = inverse(self._together(bodies, rows), held)
        force = self._outer_force(self.pose.theta + _HALF * u[2])
        return _Middle(width, pitch, rows, bodies, yielding, self._bodies.driven(width, pitch, force))

    def _up(self, heading: float) -> tuple[float, float, float]:
        """The plumb line in the axes of the heading on this slope."""
        if not self.slope:
            return 0.0, 0.0, 1.0
        (sloping, level), (s, c) = sin_cos(self.slope), sin_cos(heading)
        return sloping * c, -sloping * s, level

    def _outer_force(self, heading: float) -> tuple[float, float, float]:
        """At the centre of mass: push, weight, and the floor under a body that lies."""
        x, y, z = self._up(heading)
        s, c = sin_cos(heading)
        weight = self._bodies.mass * GRAVITY
        along, across = self.push * c - weight * x, -self.push * s - weight * y
        if self.fallen:
            vx, vy = self._u[0], self._u[1]
            drag = _LYING_DRAG * _LYING_SHARE * weight * z / softened(vx, softened(vy, _SLOW))
            along, across = along - drag * vx, across - drag * vy
        return along, across, -weight * z

    def _after(self, middle: _Middle, torques: Sequence[float]) -> _Next:
        before = self._u
        change = self._acceleration(before, middle, torques)
        between = [old + _HALF * rate for old, rate in zip(before, change, strict=True)]
        change = self._acceleration(between, middle, torques)
        after = [old + STEP_S * rate for old, rate in zip(before, change, strict=True)]
        p = self._parameters
        width = min(max(self.width + STEP_S * between[WIDTH], p.narrowest), p.widest)
        if not self._spins:
            return _Next(width, after, between, {}, {}, {})
        spins, traction, rows = self._spun(torques), dict(self._traction), self._rows(width)
        contacts = [self._contact(joint, rows[joint], middle) for joint in spins]
        after = self._give_traction(after, contacts, spins, traction)
        mean = [0.5 * (old + new) for old, new in zip(before, after, strict=True)]
        creeps = {contact.joint: contact.creep * traction[contact.joint] for contact in contacts}
        return _Next(width, after, mean, spins, traction, creeps)

    def _acceleration(self, u: Sequence[float], middle: _Middle, torques: Sequence[float]) -> Rates:
        p, rows = self._parameters, middle.rows
        bias = self._bodies.bias(middle.width, middle.pitch, u)
        force = [one - two for one, two in zip(middle.outer, bias, strict=True)]
        bending = p.joint_inertia * u[WIDTH] * u[2] / p.radius  # as the rows change with the width
        for joint, row in enumerate(rows):
            if joint in self._spins:
                given = self._traction[joint]
            else:
                spin = dot(row, u)
                given = torques[joint] - p.joint_friction * spin + bending * _SIDES[joint]
                if p.joint_drag:
                    given -= p.joint_drag * spin / softened(spin, _SLOW_JOINT)
            force = [one + given * two for one, two in zip(force, row, strict=True)]
        if p.slide_friction or p.slide_drag:
            force[WIDTH] -= (p.slide_friction + p.slide_drag / softened(u[WIDTH], _SLOW)) * u[WIDTH]
        if p.roller_drag:
            self._drag_rollers(force, u)
        return _times(middle.yielding, force)

    def _drag_rollers(self, force: Rates, u: Sequence[float]) -> None:
        """Across its axle a roller goes by the sideways motion of its pair over the cosine of its angle."""
        for side, pair in ((0.5, (0, 1)), (-0.5, (2, 3))):
            sideways, resisting = u[1] + side * u[WIDTH], 0.0
            for joint in pair:
                resisting += self.loads[joint] / self._cosines[joint]
            drag = self._parameters.roller_drag * resisting * sideways / softened(sideways, _SLOW)
            force[1] -= drag
            force[WIDTH] -= side * drag

    def _move(self, middle: _Middle, after: _Next) -> None:
        vx, vy, wz, _, nod = after.mean
        x, y, theta = self.pose
        s, c = sin_cos(theta + _HALF * wz)
        turned = [dot(row, after.mean) for row in middle.rows]
        for joint, spin in self._spins.items():
            turned[joint] = 0.5 * (spin + after.spins[joint])
        self.angles = tuple([angle + STEP_S * rate for angle, rate in zip(self.angles, turned, strict=True)])
        self.pose = Pose(x + STEP_S * (vx * c - vy * s), y + STEP_S * (vx * s + vy * c), theta + STEP_S * wz)
        self.width = after.width
        self.pitch += STEP_S * nod

    # ends of ways

    def _outward(self) -> float:
        """+1 or -1 at an end of the slides, 0 between them."""
        p = self._parameters
        return float(self.width >= p.widest) - float(self.width <= p.narrowest)

    def _end(self, middle: _Middle) -> None:
        """Impacts that take what goes on beyond the end of the slides, and the fall of the body."""
        if self._outward() * self._u[WIDTH] > 0.0:
            self._stop(WIDTH, middle)
        if abs(self.pitch) >= FALLEN and not self.fallen:
            self.pitch = FALLEN if self.pitch > 0.0 else -FALLEN
            self._stop(PITCH, middle)
            self.fallen = True

    def _stop(self, place: int, middle: _Middle) -> None:
        reach = middle.yielding[place]
        if reach[place] > 0.0:  # what is held by its end moves by rounding only
            much = self._u[place] / reach[place]
            self._u = [one - much * two for one, two in zip(self._u, reach, strict=True)]
        self._u[place] = 0.0

    # wheels on slippery ground

    def _spun(self, torques: Sequence[float]) -> dict[int, float]:
        """A wheel by itself: what its motor gives and the ground does not take. Friction is that of the mean speed."""
        p, spins = self._parameters, {}
        for joint, rate in self._spins.items():
            slowing = p.joint_friction + p.joint_drag / softened(rate, _SLOW_JOINT)
            spare = torques[joint] - self._traction[joint]
            spins[joint] = rate + STEP_S * (spare - slowing * rate) / (p.joint_inertia + _HALF * slowing)
        return spins

    def _contact(self, joint: int, row: Rates, middle: _Middle) -> _Contact:
        p, load, lever = self._parameters, self.loads[joint], self._grips[joint]
        creep = 0.0
        if p.creep and load > 0.0:
            along = self._u[0] - self._u[2] * p.places(middle.width)[joint]
            across = self._u[1] + _SIDES[joint] * self._u[WIDTH]
            creep = p.creep * sqrt(along * along + across * across) / (load * lever * lever)
        return _Contact(joint, row, _times(middle.yielding, row), self._friction[joint] * load * lever, creep)

    def _give_traction(
        self, u: Rates, contacts: Sequence[_Contact], spins: dict[int, float], traction: dict[int, float]
    ) -> Rates:
        """Correct the traction wheel by wheel until nothing changes."""
        lightness = 1.0 / self._parameters.joint_inertia
        for _ in range(_MAX_ROUNDS):
            largest = 0.0
            for joint, row, reach, limit, creep in contacts:
                given = traction[joint]
                slip = spins[joint] - dot(row, u) - creep * given
                wanted = given + slip / (STEP_S * (lightness + dot(row, reach)) + creep)
                change = max(-limit, min(limit, wanted)) - given
                traction[joint] = given + change
                impulse = STEP_S * change
                spins[joint] -= impulse * lightness
                u = [one + impulse * two for one, two in zip(u, reach, strict=True)]
                largest = max(largest, abs(change))
            if largest <= _SAME_TORQUE:
                break
        return u

    def _grip(self, joint: int) -> None:
        """The wheel is held to its row again: wheel and body keep their momentum together."""
        momentum, row = _times(self._matrix_now(), self._u), self._rows(self.width)[joint]
        spin = self._parameters.joint_inertia * self._spins.pop(joint)
        del self._traction[joint]
        self._creeps.pop(joint, None)
        together = [one + spin * two for one, two in zip(momentum, row, strict=True)]
        self._u = _times(inverse(self._matrix_now(), self._held()), together)

    # loads

    def _weight(self) -> float:
        """N on the wheels of a body at rest."""
        weight = self._bodies.mass * GRAVITY * sin_cos(self.slope)[1]
        return weight * (1.0 - _LYING_SHARE) if self.fallen else weight

    def _shift_loads(self, middle: _Middle, u: Rates) -> None:
        """Half of the way to where they belong under what the floor gives upwards and sideways."""
        change = [(new - old) / STEP_S for old, new in zip(self._u, u, strict=True)]
        bias = self._bodies.bias(middle.width, middle.pitch, self._u)
        along, across, *_ = [
            dot(row, change) + one - two for row, one, two in zip(middle.bodies, bias, middle.outer, strict=True)
        ]  # N from the floor
        s, c = sin_cos(middle.pitch)
        height, nod = self._bodies.height, self._u[PITCH]
        rising = -height * (s * change[PITCH] + c * nod * nod)
        weight = self._weight() + self._bodies.mass * rising
        high = self._parameters.centre_height or 0.0
        if self._parameters.caster_reach is not None:
            weight -= high * abs(along) / self._parameters.caster_reach
        if self._parameters.leaning is not None:
            high -= height * (1.0 - c)
        due = self._due_loads(max(0.0, weight), -high * across)
        self.loads = tuple([0.5 * (old + new) for old, new in zip(self.loads, due, strict=True)])

    def _due_loads(self, weight: float, moment: float) -> tuple[float, ...]:
        """Equally stiff wheels in line under a rigid robot. `moment`: N m, beside what a lopsided robot has of it."""
        p = self._parameters
        moment += weight * 0.5 * self.width * (p.left - p.right) / p.mass
        places = p.places(self.width)
        spread = dot(places, places)
        loads = [max(0.0, 0.25 * weight + moment * place / spread) for place in places]
        scale = weight / total if (total := dot(loads, (1.0,) * 4)) else 0.0
        return tuple([scale * load for load in loads])


def _times(matrix: Sequence[Sequence[float]], vector: Sequence[float]) -> Rates:
    return [dot(row, vector) for row in matrix]
