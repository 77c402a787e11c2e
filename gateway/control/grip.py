"""What the floor gives: loads of the wheels under an acceleration, and how far they may push before one slips.

How this works
--------------
The floor pushes wheel k along its rolling direction with up to mu times its load, and sideways (rollers) with nothing.
Accelerating shifts load to the wheels behind: loads lie on a plane over the places of the wheels, which is their least
norm, and that of equal stiffness. So a load is n_k = n0_k + n'_k . a, linear in the acceleration a of the body.
What wheels with limits c_k push together is a zonotope, spanned by their rows. It holds a wrench w if along each normal
y of its facets y . w <= sum c_k |row_k . y|, and of three axes the normals are cross products of two rows (Ziegler,
Lectures on Polytopes, section 7.3). With c_k = mu n_k(a) and w = M a each of these is linear in a: what the floor gives
is a polytope of accelerations, known once. At a facet the wheels outside its plane push all they may; so the facet that
is reached says how the wheels share a wrench, where the kernel of the coupling matrix leaves a choice (Rojas 2005,
sections 4 and 7): by load, and not alike.
Where a motor may give less than the floor bears, c_k is the lesser of the two: each facet is then as many limits as
there are choices which of the two it is for each wheel, and the least of them counts.
"""

from collections.abc import Sequence
from itertools import combinations
from math import inf, sqrt
from typing import Final, NamedTuple

from gateway.arithmetic import dot
from gateway.kinematics.linear import Matrix, Vector, pseudo_inverse, transpose

GRAVITY: Final = 9.81  # m/s^2
_IN_PLANE: Final = 1e-9  # of a row's length: what stands out of a facet by less lies in it
_PAIR: Final = 2
_MOST_WEAK: Final = 4  # wheels outside a facet's plane of which each may be limited by its floor or its motor
_NONE: Final = (0.0, 0.0, 0.0)
_UNITS: Final = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
Three = tuple[float, float, float]


class GripError(ValueError):
    """Wheels that do not carry the robot."""


class Push(NamedTuple):
    """What a motor pushes with at the rim: N, less the kg of what turns with it times what its rim speeds up by."""

    force: float
    inertia: float


class Facet(NamedTuple):
    """One limit of what the wheels push together, along a normal y: y . w <= sum |row_k . y| c_k.

    `signs` and `sizes`: of row_k . y, 0 of the wheels in its plane, `within`.
    `rest`: forces of the wheels in it for a wrench in the plane, in N per N and N m: by load where they are more than
    two.
    """

    normal: Three
    signs: tuple[float, ...]
    sizes: tuple[float, ...]
    within: tuple[int, ...]
    rest: tuple[Three, ...]


class Cone(NamedTuple):
    """Accelerations a (m/s^2, m/s^2, rad/s^2) that end at one facet: where limit . a = 1 is what the floor gives.

    `forces`: rows that give each wheel's, N: at the limit those that use least of what wheels may push, below it in
    proportion.
    """

    limit: Three
    forces: tuple[Three, ...]


class Share(NamedTuple):
    """Forces of the wheels along their rolling directions, N; `use`: the largest part of what a wheel may push."""

    forces: tuple[float, ...]
    use: float


class Grip:
    """Of n fixed wheels that roll in one direction each. Raises GripError where they do not carry the robot.

    `rows`: of the rim matrix, `places`: x and y of the contacts, m; `mass` kg, `inertia` kg m^2 about the origin, where
    the centre of mass is, `height` m above the floor (0: no load is shifted); `pushes`: what each motor gives at
    most (none told: whatever the floor bears). Nobody changes it.
    """

    def __init__(
        self,
        rows: Sequence[Vector],
        places: Sequence[tuple[float, float]],
        *,
        mass: float,
        inertia: float,
        height: float,
        pushes: Sequence[Push] = (),
    ) -> None:
        self.rows = tuple([(row[0], row[1], row[2]) for row in rows])
        self._places = tuple(places)
        self.masses = (mass, mass, inertia)
        self._shifted = mass * height  # kg m
        self._weight = mass * GRAVITY
        self._pushes = tuple(pushes) or (Push(inf, 0.0),) * len(self.rows)
        self.resting = self._at_rest()
        self.shifts = self._shifts()
        self.facets = tuple(self._facets())

    def loads(self, ax: float, ay: float) -> tuple[float, ...]:
        """N on each wheel while the body accelerates, m/s^2: never negative, a wheel that lifts carries nothing.

        Beyond the acceleration at which the robot tips over: the whole weight, on what is still down.
        """
        loads = self._all_down(ax, ay)
        return loads if min(loads) >= 0.0 else self._some_up(ax, ay, loads)

    def cones(self, friction: float) -> tuple[Cone, ...]:
        """Every limit of what the wheels push together, with how they share a push whose limit it is."""
        weak = self._weak(friction)
        return tuple(
            [
                self._cone(facet, sign, friction, motors)
                for facet in self.facets
                for motors in _choices([index for index in weak if facet.sizes[index] > 0.0])
                for sign in (1.0, -1.0)
            ]
        )

    def lifting(self) -> tuple[Three, ...]:
        """Limits beyond which a wheel leaves the floor, as those of cones."""
        found = [(-x / load, -y / load, 0.0) for load, (x, y) in zip(self.resting, self.shifts, strict=True) if x or y]
        return tuple(found)

    def shared(self, acceleration: Sequence[float], friction: float) -> Share:
        """Forces for an acceleration of the body, so that the largest part of mu times load is as small as may be."""
        ax, ay, _ = acceleration
        wrench = [part * of for part, of in zip(acceleration, self.masses, strict=True)]
        may = [friction * load for load in self.loads(ax, ay)]
        use, along, facet = 0.0, 0.0, self.facets[0]
        for one in self.facets:
            pushed, given = dot(one.normal, wrench), 0.0
            for row, most in zip(self.rows, may, strict=True):
                given += most * abs(dot(row, one.normal))
            part = abs(pushed) / given if given > 0.0 else inf if pushed != 0.0 else 0.0
            if part > use:
                use, along, facet = part, pushed, one
        if use in (0.0, inf):
            return Share((0.0,) * len(may), use)
        side = use if along > 0.0 else -use
        forces = [side * sign * most for sign, most in zip(facet.signs, may, strict=True)]
        left = list(wrench)
        for row, force in zip(self.rows, forces, strict=True):
            left = [part - force * of for part, of in zip(left, row, strict=True)]
        for index, force in zip(facet.within, self._in_plane(facet, left, may), strict=True):
            forces[index] = force
        return Share(tuple(forces), use)

    def _in_plane(self, facet: Facet, left: Sequence[float], may: Sequence[float]) -> list[float]:
        """Forces of the wheels in a facet's plane for what the others leave of a wrench."""
        if len(facet.within) == _PAIR:
            return [dot(row, left) for row in facet.rest]
        rows = [self.rows[index] for index in facet.within]
        most = [may[index] for index in facet.within]
        use, along, chosen, across = 0.0, 0.0, rows[0], facet.normal
        for row in rows:
            normal = _cross(facet.normal, row)
            pushed, given = dot(normal, left), 0.0
            for other, limit in zip(rows, most, strict=True):
                given += limit * abs(_outside(other, normal))
            part = abs(pushed) / given if given > 0.0 else 0.0
            if part >= use:
                use, along, chosen, across = part, pushed, row, normal
        side = use if along > 0.0 else -use
        signs = [_sign(_outside(row, across)) for row in rows]
        forces = [side * sign * limit for sign, limit in zip(signs, most, strict=True)]
        wrench = list(left)
        for row, force in zip(rows, forces, strict=True):
            wrench = [part - force * of for part, of in zip(wrench, row, strict=True)]
        return _in_line(rows, signs, forces, most, dot(wrench, chosen) / dot(chosen, chosen))

    def _weak(self, friction: float) -> list[int]:
        """Wheels of which the motor may give less than the floor bears."""
        most = friction * GRAVITY  # m/s^2
        return [
            index
            for index, (push, load, (x, y)) in enumerate(zip(self._pushes, self.resting, self.shifts, strict=True))
            if push.force - push.inertia * most < friction * (load + most * (abs(x) + abs(y)))
        ]

    def _cone(self, facet: Facet, sign: float, friction: float, motors: Sequence[int]) -> Cone:
        """`motors`: of the wheels outside the plane, those whose motor is what limits them."""
        sides = [sign * side for side in facet.signs]
        most = [self._most(index, side, friction, index in motors) for index, side in enumerate(sides)]
        given, shifted = 0.0, _NONE
        for size, (push, shift) in zip(facet.sizes, most, strict=True):
            if size > 0.0:
                given, shifted = given + size * push, _plus(shifted, _times(size, shift))
        x, y, z = [sign * part * of for part, of in zip(facet.normal, self.masses, strict=True)]
        limit = _times(1.0 / given, (x - shifted[0], y - shifted[1], z - shifted[2]))
        forces = [
            _times(side, _plus(_times(push, limit), shift)) if side else _NONE
            for side, (push, shift) in zip(sides, most, strict=True)
        ]
        left = [_times(mass, axis) for mass, axis in zip(self.masses, _UNITS, strict=True)]  # wrench per acceleration
        for row, force in zip(self.rows, forces, strict=True):
            left = [_plus(part, _times(-of, force)) for part, of in zip(left, row, strict=True)]
        for index, shares in zip(facet.within, facet.rest, strict=True):
            total = _NONE
            for share, part in zip(shares, left, strict=True):
                total = _plus(total, _times(share, part))
            forces[index] = total
        return Cone(limit, tuple(forces))

    def _most(self, index: int, side: float, friction: float, motor: bool) -> tuple[float, Three]:
        """What a wheel pushes at most to this side: N, and N per acceleration of the body."""
        if motor:
            push = self._pushes[index]
            return push.force, _times(-side * push.inertia, self.rows[index])
        x, y = self.shifts[index]
        return friction * self.resting[index], (friction * x, friction * y, 0.0)

    # loads

    def _plane(self, indices: Sequence[int]) -> Matrix:
        """Loads of these wheels per N of weight and per N m about y and x: of least norm, so on a plane."""
        places = [self._places[index] for index in indices]
        return pseudo_inverse(
            (tuple([1.0] * len(places)), tuple([x for x, _ in places]), tuple([y for _, y in places]))
        )

    def _at_rest(self) -> tuple[float, ...]:
        loads = tuple([row[0] * self._weight for row in self._plane(range(len(self.rows)))])
        for index, load in enumerate(loads):
            if not load > 0.0:
                raise GripError(
                    f"wheel {index + 1} carries {load:.1f} N at rest: the centre must lie within the wheels"
                )
        return loads

    def _shifts(self) -> tuple[tuple[float, float], ...]:
        """Of each load, N per m/s^2 forward and to the left."""
        plane = self._plane(range(len(self.rows)))
        return tuple([(-row[1] * self._shifted, -row[2] * self._shifted) for row in plane])

    def _all_down(self, ax: float, ay: float) -> tuple[float, ...]:
        return tuple([load + x * ax + y * ay for load, (x, y) in zip(self.resting, self.shifts)])

    def _some_up(self, ax: float, ay: float, loads: Sequence[float]) -> tuple[float, ...]:
        """Those that would have to pull are up, and the others carry what there is."""
        known = list(loads)
        down = list(range(len(known)))
        while len(down) > 2 and min(known) < 0.0:
            down = [index for index in down if known[index] > 0.0]
            wanted = (self._weight, -self._shifted * ax, -self._shifted * ay)
            known = [0.0] * len(known)
            for index, row in zip(down, self._plane(down), strict=True):
                known[index] = dot(row, wanted)
        known = [max(load, 0.0) for load in known]
        return tuple([load * (self._weight / dot(known, [1.0] * len(known))) for load in known])

    # facets

    def _facets(self) -> list[Facet]:
        found: list[Facet] = []
        lever = max(abs(row[2]) for row in self.rows) or 1.0
        for one, two in combinations(self.rows, 2):
            normal = _cross((one[0], one[1], one[2] / lever), (two[0], two[1], two[2] / lever))
            length = sqrt(dot(normal, normal))
            if length <= _IN_PLANE:
                continue
            facet = self._facet((normal[0] / length, normal[1] / length, normal[2] / length / lever))
            if all(facet.within != other.within for other in found):
                found.append(facet)
        return found

    def _facet(self, normal: Three) -> Facet:
        outside = [_outside(row, normal) for row in self.rows]
        within = tuple([index for index, part in enumerate(outside) if part == 0.0])
        rows = [self.rows[index] for index in within]
        weights = [sqrt(self.resting[index]) for index in within]  # of least norm, the loaded ones push more
        scaled = tuple([_times(weight, row) for weight, row in zip(weights, rows, strict=True)])
        rest = tuple(
            [_times(weight, (a, b, c)) for weight, (a, b, c) in zip(weights, pseudo_inverse(transpose(scaled)))]
        )
        return Facet(normal, tuple(map(_sign, outside)), tuple([abs(part) for part in outside]), within, rest)


def _choices(indices: Sequence[int]) -> list[tuple[int, ...]]:
    """Every choice of some of these; of too many, none: then their motors are taken to suffice."""
    if len(indices) > _MOST_WEAK:
        return [()]
    return [chosen for size in range(len(indices) + 1) for chosen in combinations(indices, size)]


def part_of(limits: Sequence[Three], acceleration: Sequence[float]) -> float:
    """Which part an acceleration is of the furthest in its direction within these limits; 1 at the limit."""
    ax, ay, az = acceleration
    most = 0.0
    for x, y, z in limits:
        part = x * ax + y * ay + z * az
        most = max(most, part)
    return most


def room(limits: Sequence[Three], present: Sequence[float], further: Sequence[float]) -> float:
    """How many times `further` is within these limits on top of an acceleration that is there already; inf: ever."""
    px, py, pz = present
    fx, fy, fz = further
    least = inf
    for x, y, z in limits:
        rate = x * fx + y * fy + z * fz
        if rate > 0.0:
            least = min(least, (1.0 - (x * px + y * py + z * pz)) / rate)
    return max(least, 0.0)


def _in_line(
    rows: Sequence[Vector], signs: Sequence[float], forces: list[float], most: Sequence[float], left: float
) -> list[float]:
    """The forces with what is left shared by the wheels in one line, each by what it may push; along the first."""
    line = [index for index, sign in enumerate(signs) if sign == 0.0]
    first = rows[line[0]]
    lengths = [dot(rows[index], first) / dot(first, first) for index in line]
    given = 0.0
    for index, length in zip(line, lengths, strict=True):
        given += most[index] * abs(length)
    for index, length in zip(line, lengths, strict=True):
        forces[index] = left * most[index] * _sign(length) / given if given > 0.0 else 0.0
    return forces


def _outside(row: Vector, normal: Vector) -> float:
    """What of a row stands out of a plane; exactly 0 where that is rounding."""
    part = dot(row, normal)
    return 0.0 if abs(part) <= _IN_PLANE * sqrt(dot(row, row) * dot(normal, normal)) else part


def _sign(number: float) -> float:
    return 1.0 if number > 0.0 else -1.0 if number < 0.0 else 0.0


def _times(factor: float, vector: Three) -> Three:
    return (factor * vector[0], factor * vector[1], factor * vector[2])


def _plus(one: Three, two: Three) -> Three:
    return (one[0] + two[0], one[1] + two[1], one[2] + two[2])


def _cross(a: Vector, b: Vector) -> Three:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
