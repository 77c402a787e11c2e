"""The equation of motion of an ODD that leans: two bodies on slides over one axle, in the axes of its heading.

How this works
--------------
Five speeds u: vx, vy of the middle of the axle (its heading's axes), wz about the vertical of the floor, width rate,
pitch rate about the axle (forward and down). Each half is a rigid body on the axle at y = +-d/2, its centre of mass l
above it; what is loaded stands at the same height over the middle and does not go with the slides. With
X = vx + l cos(p) p', Y = vy + l sin(p) wz, m the whole mass, h that of the halves and D the left's less the right's:

    2 T = m (X^2 + Y^2 + l^2 sin(p)^2 p'^2) - D d wz X + D d' Y + h/4 (d^2 wz^2 + d'^2)
        + (I_up cos(p)^2 + I_side sin(p)^2) wz^2 + I_pitch p'^2

`matrix` and `bias` are Kane's equations of it: matrix u' + bias = force. At p = 0 without l they are the corrected
equations 9 to 11 of arXiv 2407.10127 (`odd_equations`), and J p'' = m g l p - m l vx' is their linearised last row.
"""

from collections.abc import Sequence
from math import sqrt
from typing import NamedTuple

from gateway.arithmetic import sin_cos
from gateway.chassis.odd import OddRobot

Rates = list[float]  # vx, vy, wz, width rate, pitch rate; and what changes them
WIDTH, PITCH, SIZE = 3, 4, 5


class Leaning(NamedTuple):
    """Of a robot that balances: m from the axle up to its centre of mass, and kg m^2 about the axle's direction there.

    Both of the whole robot but for the turning of its wheels: mass and height give the moment of the weight, and
    the inertia about the axle is pitch_inertia + mass height^2.
    """

    height: float
    pitch_inertia: float


class OddParameters(NamedTuple):
    """The whole robot. Inertias: kg m^2 of all bodies, each about its own centre of mass, upright."""

    radius: float  # m of a wheel
    spacing: float  # m between the wheels of a half
    narrowest: float  # m between the middles of the halves
    widest: float
    tangents: tuple[float, float, float, float]  # of the angles from forward to the rollers' axles, from left to right
    left: float  # kg of the half
    right: float
    load: float  # kg over the middle
    upright: float  # about the vertical
    side: float  # about forward
    leaning: Leaning | None  # None: on ball casters, it does not
    centre_height: float | None  # m above the floor; None: unknown, no load goes from wheel to wheel
    joint_inertia: float
    joint_friction: float
    joint_drag: float
    caster_reach: float | None = None  # m along, from the axle to the balls before and behind; None: unknown
    creep: float = 0.0  # share of its speed by which a wheel slips that pushes as hard as it is loaded
    slide_friction: float = 0.0  # N s/m
    slide_drag: float = 0.0  # N
    roller_drag: float = 0.0  # N per N of a wheel's load, across its rollers' axles

    @property
    def mass(self) -> float:
        """Of everything, kg."""
        return self.left + self.right + self.load

    def places(self, width: float) -> tuple[float, float, float, float]:
        """Of the wheels at this width, m to the left of the middle."""
        far, near = 0.5 * (width + self.spacing), 0.5 * (width - self.spacing)
        return far, near, -near, -far


def parameters(robot: OddRobot, leaning: Leaning | None = None) -> OddParameters:
    """As the robot file has it: equal halves, slides and rollers without friction.

    Raises ValueError where the inertia about the vertical is less than that of two points.
    """
    body, half = robot.body, 0.5 * robot.body.mass
    first, second, third, fourth = robot.roller_angles
    upright = body.inertia - 0.25 * body.mass * robot.width * robot.width
    if upright + 0.25 * body.mass * robot.narrowest * robot.narrowest <= 0.0:
        raise ValueError("robot.body.inertia: too small for halves that slide so far")
    height = body.centre_height
    if leaning is not None:
        height = robot.radius + leaning.height
    return OddParameters(
        radius=robot.radius,
        spacing=robot.spacing,
        narrowest=robot.narrowest,
        widest=robot.widest,
        tangents=(_tangent(first), _tangent(second), _tangent(third), _tangent(fourth)),
        left=half,
        right=half,
        load=0.0,
        upright=upright,
        side=0.0 if leaning is None else leaning.pitch_inertia,  # about as tall as it is long, and so as slow to roll
        leaning=leaning,
        centre_height=height,
        joint_inertia=body.joint_inertia,
        joint_friction=body.joint_friction,
        joint_drag=body.joint_drag,
    )


class OddBodies:
    """The bodies alone, without their wheels' inertia."""

    def __init__(self, parameters: OddParameters) -> None:
        p = parameters
        self.mass = p.mass
        self._halves, self._uneven = p.left + p.right, p.left - p.right
        self._upright, self._side = p.upright, p.side
        self.height, self._pitching = (0.0, 0.0) if p.leaning is None else p.leaning

    def matrix(self, width: float, pitch: float) -> list[Rates]:
        """Symmetric, kg, kg m and kg m^2."""
        s, c = sin_cos(pitch)
        m, uneven, high = self.mass, self._uneven, self.height
        turning = (
            0.25 * self._halves * width * width + m * high * high * s * s + self._upright * c * c + self._side * s * s
        )
        a, b, e = -0.5 * uneven * width, m * high * c, m * high * s
        f, g, i = 0.5 * uneven, 0.5 * uneven * high * s, -0.5 * uneven * width * high * c
        return [
            [m, 0.0, a, 0.0, b],
            [0.0, m, e, f, 0.0],
            [a, e, turning, g, i],
            [0.0, f, g, 0.25 * self._halves, 0.0],
            [b, 0.0, i, 0.0, m * high * high + self._pitching],
        ]

    def bias(self, width: float, pitch: float, u: Sequence[float]) -> Rates:
        """What Coriolis and centrifugal accelerations take, N and N m."""
        vx, vy, w, rate, nod = u
        s, c = sin_cos(pitch)
        m, uneven, high, half = self.mass, self._uneven, self.height, 0.5 * width
        back = -w * vy - high * s * (nod * nod + w * w)  # of the centre of mass, along
        left = w * vx + 2.0 * high * c * w * nod
        slower = 2.0 * s * c * (self._side - self._upright)  # of the turning, over pitch
        along = m * back - uneven * w * rate
        across = m * left - uneven * half * w * w
        return [
            along,
            across,
            self._halves * half * w * rate - uneven * half * back + high * s * across + slower * nod * w,
            0.5 * (uneven * left - self._halves * half * w * w),
            high * c * along + m * high * high * s * c * nod * nod - 0.5 * slower * w * w,
        ]

    def driven(self, width: float, pitch: float, force: tuple[float, float, float]) -> Rates:
        """By a force at the centre of mass in the axes of the heading, N."""
        x, y, z = force
        s, c = sin_cos(pitch)
        high, off = self.height, 0.5 * self._uneven / self.mass
        return [x, y, high * s * y - off * width * x, off * y, high * (c * x - s * z)]


def softened(speed: float, slow: float) -> float:
    """Size of a speed, but never near zero: dry friction fades below `slow`. The root is exact everywhere."""
    return sqrt(slow * slow + speed * speed)


def _tangent(angle: float) -> float:
    s, c = sin_cos(angle)
    return s / c


def inverse(matrix: Sequence[Sequence[float]], held: Sequence[int]) -> list[Rates]:
    """Of a positive definite matrix while these of its rows are held: theirs are zeros."""
    left = [list(row) for row in matrix]
    free = [place for place in range(len(left)) if place not in held]
    for place in held:
        left[place] = [0.0] * len(left)
        for row in left:
            row[place] = 0.0
    for place in free:  # the sweep: pivots of such a matrix are above zero
        row = left[place]
        scale = 1.0 / row[place]
        row = left[place] = [scale * one for one in row]
        for other in free:
            if other != place:
                much = left[other][place]
                left[other] = [one - much * two for one, two in zip(left[other], row, strict=True)]
                left[other][place] = -much * scale
        row[place] = scale
    return left
