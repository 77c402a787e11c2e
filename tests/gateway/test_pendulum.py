"""The conditions under which a robot balances, against the roots of its equation and a pendulum of its own."""

from math import radians

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from gateway.control.pendulum import GRAVITY, BalanceGains, Pendulum, Standing, objection, pendulum, recovery, unfit

# The example of science 3: m = 8, l = .2, and its inertia without the torques of the wheels on the body.
EXAMPLE = Pendulum(inertia=0.1 + 8.0 * 0.2 * 0.2, coupling=8.0 * 0.2, gravity=8.0 * GRAVITY * 0.2)
GAINS = BalanceGains(4.0, 0.6, 2.0, 2.0)
sizes = st.floats(0.05, 20.0)
gains = st.floats(-1.0, 20.0)


def standing(gains: BalanceGains = GAINS, *, delay: float = 0.0) -> Standing:
    return Standing(gains, EXAMPLE, radius=0.05, mass=8.0, catch=radians(5.0), lag=0.02, delay=delay)


@given(body=st.builds(Pendulum, sizes, sizes, sizes), told=st.builds(BalanceGains, gains, gains, gains, gains))
def test_gains_are_refused_exactly_where_a_root_does_not_decay(body: Pendulum, told: BalanceGains) -> None:
    a, b, c = body
    kp, kd, kv, ki = told
    polynomial = [(1.0 - kv) * a + b * kd, b * kp - ki * a, (kv - 1.0) * c, ki * c]
    assume(abs(polynomial[0]) > 1e-6)
    largest = max(root.real for root in np.roots(polynomial))
    assume(abs(largest) > 1e-6)
    refusal = objection(told, body)
    assert (refusal is None) == (largest < 0.0), refusal


@pytest.mark.parametrize(
    ("gains", "words"),
    [
        (GAINS._replace(velocity=1.0), "velocity = 1: must be above 1"),
        (GAINS._replace(velocity=0.0), "velocity = 0: must be above 1"),
        (GAINS._replace(position=0.0), "position = 0: must be above 0"),
        (GAINS._replace(pitch_rate=0.26), "pitch_rate = 0.26: must be above 0.2625"),
        (GAINS._replace(pitch=0.5), "pitch = 0.5: must be above 0.525"),
        (GAINS._replace(pitch=1.1), "pitch = 1.1: must be above 1.2 "),
    ],
)
def test_what_is_wrong_is_told_with_its_range(gains: BalanceGains, words: str) -> None:
    assert (objection(gains, EXAMPLE) or "").startswith(words)
    assert objection(GAINS, EXAMPLE) is None


@pytest.mark.parametrize("lag", [0.002, 0.005, 0.01, 0.02])
def test_the_example_recovers_from_five_degrees(lag: float) -> None:
    took = recovery(standing(), lag=lag, period=0.001, delay=0.0)
    assert took is not None
    assert took <= 1.4


def test_without_the_positive_velocity_it_falls() -> None:
    assert recovery(standing(BalanceGains(3.0, 0.5, 0.0, 0.0)), lag=0.02, period=0.001, delay=0.0) is None


def test_what_is_old_makes_it_fall() -> None:
    assert recovery(standing(), lag=0.02, period=0.004, delay=0.0) is not None
    assert recovery(standing(), lag=0.02, period=0.004, delay=0.15) is None
    assert recovery(standing(), lag=0.2, period=0.004, delay=0.0) is None
    assert recovery(standing(delay=0.05), lag=0.02, period=0.004, delay=0.0) is None


FIT = {"speed": 1.0, "acceleration": 0.5, "wheel_speed": 60.0, "push": 100.0, "period": 0.004, "delay": 0.001}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            {"wheel_speed": 26.0},
            "limits.velocity.vx = 1: must be at most 0.951 m/s",
        ),
        ({"push": 5.0}, "must be at most"),
        ({"delay": 0.2}, "these gains do not catch it from catch = 0.0872665 rad, with a loop of 250 Hz"),
    ],
)
def test_a_robot_that_cannot_catch_itself_is_told_why(change: dict[str, float], words: str) -> None:
    assert unfit(standing(), **FIT) is None
    assert words in (unfit(standing(), **(FIT | change)) or "")


def test_the_torques_of_the_wheels_turn_the_body_too() -> None:
    """By momenta alone: of the axle m v + m l w, of the body about its axle (I + m l^2) w + m l v."""
    mass, height, inertia, radius = 20.0, 0.25, 0.4, 0.08
    body = pendulum(mass=mass, height=height, pitch_inertia=inertia, radius=radius)
    moment = mass * height
    for pitch, change in ((0.1, 0.0), (0.0, 1.0), (0.03, -2.0)):
        # torque = radius * force, and it turns the body back
        left = np.array([[mass * 0.0 + moment, -1.0], [inertia + moment * height, radius]])
        right = np.array([-mass * change, moment * GRAVITY * pitch - moment * change])
        turning, force = np.linalg.solve(left, right)
        assert body.inertia * turning == pytest.approx(body.gravity * pitch - body.coupling * change), force
