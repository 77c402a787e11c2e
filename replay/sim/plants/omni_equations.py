"""The equations of motion of a robot on omni wheels, in the three speeds of its body.

How this works
--------------
u = (vx, vy, w): velocity of the centre in body axes (m/s) and rate of turn (rad/s). A wheel at p with its axle along a
rolls along d, a quarter turn from a: it spins at d . (v + w x p) / R, its roller on the floor at a . (v + w x p) / r.
Both resist through their rows, so that (Amarasiri et al. 2022, Eqs. 20 to 23, for any wheels at any pose; science 4)
    (diag(M, M, I) + D' J D + Dr' Jr Dr) u' + M (-w vy, w vx, 0) = D' torque - D' b D u + force
Spin and rollers are added mass that differs with the direction and has no Coriolis term: the body's axes carry them.
Plain floats throughout, and no function that another processor computes otherwise.
"""

from collections.abc import Container, Iterable, Sequence

from gateway.arithmetic import sin_cos
from replay.sim.plants.omni_parameters import OmniParameters, WheelParameters

Motion = tuple[float, float, float]
Force = tuple[float, float, float]  # along each of the three speeds: N, N, N m
Symmetric = tuple[float, float, float, float, float, float]  # 11, 12, 13, 22, 23, 33


class OmniEquations:
    """Of one set of parameters. `loose`: wheels that turn at a speed of their own, not held to theirs."""

    def __init__(self, parameters: OmniParameters, loose: Container[int] = ()) -> None:
        self.parameters = parameters
        wheels = parameters.wheels
        self.rows = tuple([_rolling(wheel) for wheel in wheels])
        self.roller_rows = tuple([_across(wheel) for wheel in wheels])
        held = [place for place in range(len(wheels)) if place not in loose]
        mass, inertia = parameters.mass, parameters.inertia
        matrix = (mass, 0.0, 0.0, mass, 0.0, inertia)
        matrix = _resisting(matrix, [(self.rows[place], wheels[place].spin_inertia) for place in held])
        rollers = [wheel.roller_inertia for wheel in wheels]
        self._matrix = _resisting(matrix, zip(self.roller_rows, rollers, strict=True))
        self._inverse = _inverse(self._matrix)
        none = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        self._slowing = _resisting(none, [(self.rows[place], parameters.friction) for place in held])

    def joint_rates(self, motion: Motion) -> tuple[float, ...]:
        """Of the wheels, rad/s."""
        vx, vy, w = motion
        return tuple([a * vx + b * vy + c * w for a, b, c in self.rows])

    def roller_rates(self, motion: Motion) -> tuple[float, ...]:
        """Of the rollers on the floor, rad/s, about their axles a quarter turn ahead of the wheel's own."""
        vx, vy, w = motion
        return tuple([a * vx + b * vy + c * w for a, b, c in self.roller_rows])

    def driven(self, torques: Sequence[float]) -> Force:
        """What these torques of the wheels, N m, do along the three speeds."""
        x = y = turning = 0.0
        for (a, b, c), torque in zip(self.rows, torques, strict=True):
            x, y, turning = x + a * torque, y + b * torque, turning + c * torque
        return x, y, turning

    def acceleration(self, motion: Motion, force: Force) -> Motion:
        """How the three speeds change under this force, friction of the held wheels included."""
        vx, vy, w = motion
        x, y, turning = force
        bent = self.parameters.mass * w
        x, y = x + bent * vy, y - bent * vx
        if self.parameters.friction:
            slow_x, slow_y, slow_turning = _times(self._slowing, motion)
            x, y, turning = x - slow_x, y - slow_y, turning - slow_turning
        return _times(self._inverse, (x, y, turning))

    def after(self, motion: Motion, force: Force, seconds: float) -> Motion:
        """The three speeds after so long under this force in body axes (Runge-Kutta of fourth order)."""
        half, slope = seconds / 2.0, self.acceleration
        one = slope(motion, force)
        two = slope(_ahead(motion, one, half), force)
        three = slope(_ahead(motion, two, half), force)
        four = slope(_ahead(motion, three, seconds), force)
        (vx, vy, w), (x1, y1, w1), (x2, y2, w2), (x3, y3, w3), (x4, y4, w4) = motion, one, two, three, four
        sixth = seconds / 6.0
        return (
            vx + sixth * (x1 + 2.0 * (x2 + x3) + x4),
            vy + sixth * (y1 + 2.0 * (y2 + y3) + y4),
            w + sixth * (w1 + 2.0 * (w2 + w3) + w4),
        )

    def resistance_to(self, change: Motion) -> Force:
        """Mass matrix times a change of the three speeds: also the momentum that belongs to a motion."""
        return _times(self._matrix, change)

    def yielding(self, force: Force) -> Motion:
        """Inverse of the mass matrix times a force (or an impulse)."""
        return _times(self._inverse, force)

    def energy(self, motion: Motion) -> float:
        """Of the motion, J, without the spin of wheels that are loose."""
        x, y, turning = _times(self._matrix, motion)
        return (x * motion[0] + y * motion[1] + turning * motion[2]) / 2.0


def _rolling(wheel: WheelParameters) -> Motion:
    """What each of the three speeds gives the wheel, rad/s."""
    s, c = sin_cos(wheel.axis_angle)
    return -s / wheel.radius, c / wheel.radius, (c * wheel.x + s * wheel.y) / wheel.radius


def _across(wheel: WheelParameters) -> Motion:
    """What each of the three speeds gives the roller on the floor, rad/s."""
    s, c = sin_cos(wheel.axis_angle)
    return c / wheel.roller_radius, s / wheel.roller_radius, (s * wheel.x - c * wheel.y) / wheel.roller_radius


def _resisting(matrix: Symmetric, parts: Iterable[tuple[Motion, float]]) -> Symmetric:
    """With what resists the rates of these rows, each so much."""
    m11, m12, m13, m22, m23, m33 = matrix
    for (a, b, c), much in parts:
        m11, m12, m13 = m11 + much * a * a, m12 + much * a * b, m13 + much * a * c
        m22, m23, m33 = m22 + much * b * b, m23 + much * b * c, m33 + much * c * c
    return m11, m12, m13, m22, m23, m33


def _inverse(matrix: Symmetric) -> Symmetric:
    """By cofactors: a mass matrix is far from singular."""
    a, b, c, d, e, f = matrix
    c11, c12, c13 = d * f - e * e, c * e - b * f, b * e - c * d
    scale = 1.0 / (a * c11 + b * c12 + c * c13)
    return (
        *(scale * c11, scale * c12, scale * c13),
        *(scale * (a * f - c * c), scale * (b * c - a * e), scale * (a * d - b * b)),
    )


def _times(matrix: Symmetric, vector: Motion) -> Motion:
    a, b, c, d, e, f = matrix
    x, y, z = vector
    return a * x + b * y + c * z, b * x + d * y + e * z, c * x + e * y + f * z


def _ahead(motion: Motion, change: Motion, seconds: float) -> Motion:
    return motion[0] + seconds * change[0], motion[1] + seconds * change[1], motion[2] + seconds * change[2]
