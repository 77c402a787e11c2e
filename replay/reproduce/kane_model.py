"""The robot of ASME Lett. Dyn. Sys. Control 2(4):040902 by itself: its dynamics in closed form, and its wheel control.

Everything is in the paper's units: inches, slugs (of which 12 of the forces in slug in/s^2 make one lbf) and seconds.
Body velocities (V1, V2, Omega) along a1, a2 and about a3; wheels 1 and 2 at +Lm a2 and -Lm a2 roll along a1, wheels 3
and 4 at -Lm a1 and +Lm a1 along a2 (inferred, science E-004-1). Spinning parts are added mass without Coriolis forces:
    M_q V' + M (-Omega V2, Omega V1, 0) = D^T T,   M_q = diag(M, M, I_z) + D^T J_w D + J_r D_r^T D_r   (science 4)
"""

from collections.abc import Callable
from math import cos, pi, sin
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from replay.sim.plants.omni_parameters import INCH, SLUG, kane_robot

Array = npt.NDArray[np.float64]

RADIUS: Final = 3.0  # in; Table 3
LEVER: Final = 8.0  # in; "length and width of the base", taken as centre to wheel (science E-004-9)
POUND: Final = 12.0  # slug in/s^2
_SQUARE_INCH: Final = SLUG * INCH * INCH  # kg m^2 in a slug in^2
PRINTED_GAINS: Final = (1778.55, 1775.73, 1250.01, 1250.01)  # Kprop; the first two have a wrong digit (E-004-3)


class Gains(NamedTuple):
    """Of one wheel (Eq. 25), in slug in^2/s^2 per rad s, per rad, and per rad/s."""

    integral: float
    proportional: float
    derivative: float


class Response(NamedTuple):
    """What the poles are placed for. The third one is real; 1/s."""

    peak: float = 0.25  # s; printed
    settled: float = 0.5  # s, within 2 %; printed
    third: float = 100.0


class Motion(NamedTuple):
    """Wanted along n1, n2 at a time: in, in/s, in/s^2. The heading stays zero."""

    place: tuple[float, float]
    velocity: tuple[float, float]
    acceleration: tuple[float, float]


class Moment(NamedTuple):
    """Now and then: s, in and rad over the floor, errors in rad of wheels and in of places, slug in^2/s^2."""

    t: float
    x: float
    y: float
    spin: float
    wheel_errors: tuple[float, ...]
    error_x: float
    error_y: float
    torques: tuple[float, ...]
    wheels: tuple[float, ...]  # rad/s


Reference = Callable[[float], Motion]
Force = Callable[[float], tuple[float, float]]


def gains_for(derivative: float, response: Response) -> tuple[Gains, float]:
    """Gains for poles at -p and -4/ts +- j pi/tp, and the inertia, slug in^2, that they are for."""
    a, b, p = 4.0 / response.settled, pi / response.peak, response.third
    inertia = derivative / (p + 2.0 * a)
    square = a * a + b * b
    return Gains(inertia * p * square, inertia * (square + 2.0 * a * p), derivative), inertia


def poles(gains: Gains, inertia: float) -> Array:
    """Of J q''' + Kd q'' + Kp q' + Ki q = 0, 1/s; the real one first."""
    found = np.roots([inertia, gains.derivative, gains.proportional, gains.integral])
    return np.asarray(sorted(found, key=lambda pole: (abs(pole.imag), -pole.imag)))


def step_response(
    gains: Gains, inertia: float, step: float, *, seconds: float = 1.0
) -> tuple[list[float], list[float]]:
    """Times, s, and angles, rad, of a wheel that is wanted at `step` from the start on (Eq. 25: no kick)."""
    state, dt = np.zeros(4), 1e-3  # angle, speed, acceleration by the torque state, time

    def rates(_: float, state: Array) -> Array:
        angle, speed, torque = state[:3]
        faster = torque / inertia
        more = gains.integral * (step - angle) - gains.proportional * speed - gains.derivative * faster
        return np.array([speed, faster, more, 1.0])

    times, angles = [0.0], [0.0]
    for _ in range(round(seconds / dt)):
        state = _stepped(rates, 0.0, state, dt)
        times.append(float(state[3]))
        angles.append(float(state[0]))
    return times, angles


# The printed ones, Kprop of wheels 1 and 2 with the digit that their own poles need.
WHEEL_GAINS: Final = (
    Gains(14355.0, 1178.55, 75.03),
    Gains(14320.6, 1175.73, 74.85),
    Gains(15225.5, 1250.01, 79.58),
    Gains(15225.5, 1250.01, 79.58),
)


class KaneRobot:
    """Its matrices. `lever`: in, from the centre to a wheel."""

    def __init__(self, lever: float = LEVER) -> None:
        robot = kane_robot(lever * INCH)
        self.mass = robot.mass / SLUG
        self.wheels: Array = (
            np.array([[1.0, 0.0, -lever], [1.0, 0.0, lever], [0.0, 1.0, -lever], [0.0, 1.0, lever]]) / RADIUS
        )
        rolled = np.array([[0.0, -1.0, 0.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
        rollers = rolled / (robot.wheels[0].roller_radius / INCH)
        inertia = np.array([robot.inertia, *(wheel.spin_inertia for wheel in robot.wheels)]) / _SQUARE_INCH
        spins = self.wheels.T @ np.diag(inertia[1:]) @ self.wheels
        spins = spins + robot.wheels[0].roller_inertia / _SQUARE_INCH * rollers.T @ rollers
        self.inertia: Array = np.asarray(np.diag([self.mass, self.mass, inertia[0]]) + spins)
        self._inverse: Array = np.linalg.inv(self.inertia).astype(np.float64)

    def acceleration(self, velocity: Array, torques: Array, force: Array | None = None) -> Array:
        """(V1', V2', Omega') under torques, slug in^2/s^2, and a force on the body in its frame, slug in/s^2."""
        v1, v2, omega = velocity
        push = self.wheels.T @ torques - self.mass * np.array([-omega * v2, omega * v1, 0.0])
        return np.asarray(self._inverse @ (push if force is None else push + force))

    def energy(self, velocity: Array) -> float:
        """lbf in."""
        return float(0.5 * velocity @ self.inertia @ velocity / POUND)


def free(robot: KaneRobot, velocity: Array, torques: Array, *, seconds: float, step: float = 1e-3) -> list[Array]:
    """(x, y, heading, V1, V2, Omega) after each step under constant torques (Runge-Kutta), the start first."""

    def rates(state: Array) -> Array:
        return np.concatenate([over_the_floor(state[2], state[3:6]), robot.acceleration(state[3:6], torques)])

    states = [np.concatenate([np.zeros(3), velocity])]
    for _ in range(round(seconds / step)):
        states.append(_stepped(lambda _, state: rates(state), 0.0, states[-1], step))
    return states


def track(
    reference: Reference,
    *,
    seconds: float,
    force: Force = lambda t: (0.0, 0.0),
    state_form: bool = True,
    step: float = 1e-3,
    every: int = 10,
) -> list[Moment]:
    """The robot under its four wheel controllers, from the place and with the velocity that are wanted at first.

    `state_form`: the torque is a state, T' = Ki e + Kp e' + Kd e'' (Eq. 25), where e'' has no pulse at a corner; else
    the same PID directly. `force`: on the body, slug in/s^2 along n1 and n2.
    """
    robot, gains = KaneRobot(), np.array(WHEEL_GAINS).T
    start = reference(0.0)

    def wanted(t: float) -> tuple[Array, Array, Array]:
        motion = reference(t)
        way = (motion.place[0] - start.place[0], motion.place[1] - start.place[1])
        turned = [robot.wheels @ np.array([*part, 0.0]) for part in (way, motion.velocity, motion.acceleration)]
        return turned[0], turned[1], turned[2]

    def torques(t: float, state: Array) -> Array:
        if state_form:
            return state[10:14]
        angles, speeds, _ = wanted(t)
        integral, proportional, derivative = gains
        error, rate = angles - state[6:10], speeds - robot.wheels @ state[3:6]
        return np.asarray(integral * state[10:14] + proportional * error + derivative * rate)

    def rates(t: float, state: Array) -> Array:
        angles, speeds, accelerations = wanted(t)
        integral, proportional, derivative = gains
        turning = robot.wheels @ state[3:6]
        acceleration = robot.acceleration(state[3:6], torques(t, state), _in_the_body(state[2], force(t)))
        error = angles - state[6:10]
        more = error
        if state_form:
            faster = accelerations - robot.wheels @ acceleration
            more = integral * error + proportional * (speeds - turning) + derivative * faster
        return np.concatenate([over_the_floor(state[2], state[3:6]), acceleration, turning, more])

    state = np.concatenate([start.place, [0.0], start.velocity, np.zeros(9)])
    found = []
    for number in range(round(seconds / step) + 1):
        t = number * step
        if number % every == 0:
            place = reference(t + _INSIDE).place
            found.append(
                Moment(
                    t,
                    float(state[0]),
                    float(state[1]),
                    float(state[2]),
                    tuple(map(float, wanted(t + _INSIDE)[0] - state[6:10])),
                    float(place[0] - state[0]),
                    float(place[1] - state[1]),
                    tuple(map(float, torques(t + _INSIDE, state))),
                    tuple(map(float, robot.wheels @ state[3:6])),
                )
            )
        state = _stepped(rates, t, state, step)
    return found


_INSIDE: Final = 1e-9  # s: a step begins behind a corner of the path and ends before the next


def _stepped(rates: Callable[[float, Array], Array], t: float, state: Array, step: float) -> Array:
    """Runge-Kutta of fourth order."""
    half = 0.5 * step
    first = rates(t + _INSIDE, state)
    second = rates(t + half, state + half * first)
    third = rates(t + half, state + half * second)
    fourth = rates(t + step - _INSIDE, state + step * third)
    return np.asarray(state + step / 6.0 * (first + 2.0 * second + 2.0 * third + fourth))


def over_the_floor(heading: float, velocity: Array) -> Array:
    """A body velocity along n1 and n2, and its spin."""
    c, s = cos(heading), sin(heading)
    return np.array([c * velocity[0] - s * velocity[1], s * velocity[0] + c * velocity[1], velocity[2]])


def _in_the_body(heading: float, force: tuple[float, float]) -> Array:
    c, s = cos(heading), sin(heading)
    return np.array([c * force[0] + s * force[1], -s * force[0] + c * force[1], 0.0])
