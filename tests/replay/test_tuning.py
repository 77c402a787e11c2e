"""Gains of the host's speed loop: what is found against the truth, and the margins by other ways than the rule's."""

from cmath import exp, phase, pi
from collections.abc import Callable
from math import degrees, radians
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.setpoint import CommandKind
from gateway.config import RobotConfig, SpeedLoop, parse
from gateway.control.drive_law import COAST, JointCommand
from gateway.core.assembly import build
from gateway.core.examination import carried_inertia
from gateway.core.motors import Motors
from gateway.setup.excitation import Excitation, Told
from gateway.setup.jog import Ending
from replay.identify.fit import Array
from replay.identify.gains import GAIN_MARGIN, PHASE_MARGIN, Gains, gains, margins, stepped, total_delay
from replay.identify.response import Response, ResponseError, identify, solve
from replay.identify.tuning import Tuned, tune
from tests.jogging import Bench, ride
from tests.setup_robots import TRUE
from tests.world import robot_text

PERIOD = 0.004


class Case(NamedTuple):
    """How near a robot's motors come to the truth: shares of inertia and kp, s of the delay; deg of the margin."""

    text: Callable[[], str]
    inertia: float
    delay: float
    kp: float
    phase: float


def gm6020(mode: str) -> str:
    return robot_text("omni4_gm6020").replace('mode = "voltage"', f'mode = "{mode}"')


ROBOTS = {
    "omni4": Case(lambda: robot_text("omni4"), 0.01, 0.0003, 0.05, 1.5),
    "mecanum4": Case(lambda: robot_text("mecanum4"), 0.01, 0.0003, 0.05, 1.5),
    "odd": Case(lambda: robot_text("odd"), 0.01, 0.0003, 0.05, 1.5),
    "rectangular": Case(TRUE["rectangular"], 0.01, 0.0003, 0.05, 1.5),
    # Its speed is told by steps of a tenth of the top speed, so delay and kp are told less well.
    "gm6020 current": Case(lambda: gm6020("current"), 0.02, 0.001, 0.2, 3.0),
    "gm6020 voltage": Case(lambda: gm6020("voltage"), 0.02, 0.001, 0.2, 3.0),
}


def config_of(name: str) -> RobotConfig:
    return parse(ROBOTS[name].text(), name)


def tuned(config: RobotConfig) -> Tuned:
    motor = config.motor[0]
    bench, excitation = Bench(config), Excitation(config, motor.name)
    found = ride(bench, excitation, motor.name)
    assert found.outcome.ending is Ending.TURNED
    assert motor.speed_loop is not None
    return tune(
        excitation.told,
        before=motor.speed_loop,
        carried=carried_inertia(config),
        damping=excitation.damping,
        period=1.0 / config.loop.rate,
    )


class Wheel:
    """The first motor of a robot in the air, told what a speed loop or a torque says, in every cycle."""

    def __init__(self, config: RobotConfig, loop: Gains | None = None, delay: float = 0.0) -> None:
        motors = [
            motor if loop is None else motor.model_copy(update={"speed_loop": SpeedLoop(kp=loop.kp, ki=loop.ki)})
            for motor in config.motor
        ]
        self.config = config.model_copy(update={"motor": motors})
        self.bench = Bench(self.config)
        self.bench.bus.delay("can0", delay)
        self._motors = Motors(build(self.config))

    def cycle(self, command: JointCommand) -> float:
        """The speed that is measured."""
        self._motors.receive(self.bench.cycle())
        measured = self._motors.measure(self.bench.now_ns, PERIOD)
        self.bench.send(list(self._motors.command([command, *[COAST] * (len(self.config.motor) - 1)], measured)))
        return measured.speeds[0] or 0.0


def true_response(config: RobotConfig) -> Response:
    """Of the plant; the delay is how much later a speed is told after a step of torque than (1 - e^(-b t / J)) has it.

    A motor that is told voltages has the bus and the controller of one that is told currents.
    """
    if config.motor[0].options.get("mode") == "voltage":
        config = config_of("gm6020 current")
    plant = Bench(config).plant
    inertia, friction, drag = plant._inertias[0], plant._friction, plant._drag
    wheel, torque = Wheel(config), 20.0 * drag
    for _ in range(20):
        wheel.cycle(JointCommand(CommandKind.TORQUE, 0.0))
    readings = np.asarray([wheel.cycle(JointCommand(CommandKind.TORQUE, torque)) for _ in range(8)])[3:]
    since = -inertia / friction * np.log(1.0 - friction * readings / (torque - drag))
    return Response(inertia, friction, drag, float(np.mean(PERIOD * np.arange(3, 8) - since)))


@pytest.mark.parametrize("name", ROBOTS)
def test_what_is_found_is_the_truth(name: str) -> None:
    case, config = ROBOTS[name], config_of(name)
    found, true = tuned(config), true_response(config)
    assert found.answer.response.inertia == pytest.approx(true.inertia, rel=case.inertia)
    assert found.answer.response.drag == pytest.approx(true.drag, rel=0.15)
    assert found.answer.response.friction == pytest.approx(true.friction, abs=0.003)
    assert found.answer.response.delay == pytest.approx(true.delay, abs=case.delay)
    heavy = true.inertia + carried_inertia(config)
    expected = gains(true.inertia, heavy, delay=true.delay, period=PERIOD)
    assert found.after.kp == pytest.approx(expected.kp, rel=case.kp)
    assert found.after.ki == pytest.approx(expected.ki, rel=2.0 * case.kp)
    for load in (true.inertia, heavy):
        phase_margin, gain_margin = sampled_margins(found.after, load, true.delay)
        assert phase_margin >= degrees(PHASE_MARGIN) - case.phase
        assert gain_margin >= GAIN_MARGIN


def carried_by_hand(config: RobotConfig) -> float:
    """Of four mecanum wheels in a rectangle: m r^2 / n straight on, and turning I r^2 / (n (a + b)^2)."""
    radius, lever, body = 0.0762, 0.2 + 0.18, config.robot.body
    straight, turning = body.mass * radius**2 / 4.0, body.inertia * radius**2 / (4.0 * lever**2)
    return max(straight, turning)


def test_what_a_wheel_carries() -> None:
    config = config_of("rectangular")
    assert carried_inertia(config) == pytest.approx(carried_by_hand(config))


# -- margins ----------------------------------------------------------------------------------------------------------


def sampled(loop: Gains, inertia: float, delay: float, w: float) -> complex:
    """L(z) of the loop as it runs: sums of errors, a torque held for a cycle that begins late, an integrator."""
    z = exp(1j * w * PERIOD)
    cycles, part = divmod(delay / PERIOD, 1.0)
    controller = loop.kp + loop.ki * PERIOD * z / (z - 1.0)
    plant = PERIOD / inertia * ((1.0 - part) + part / z) / (z - 1.0) / z**cycles
    return complex(controller * plant)


def sampled_margins(loop: Gains, inertia: float, delay: float) -> tuple[float, float]:
    """Phase, deg, and gain: read off a fine table of L(z)."""
    table = np.geomspace(1e-2, 0.999 * pi / PERIOD, 20_000)
    values = [sampled(loop, inertia, delay, w) for w in table]
    at = next(place for place, value in enumerate(values) if abs(value) < 1.0)
    turned = next(
        (place for place in range(at, len(values)) if values[place].imag >= 0.0 > values[place].real), len(values) - 1
    )
    return 180.0 + degrees(phase(values[at])), 1.0 / abs(values[turned])


loads = st.floats(1e-3, 1.0)
delays = st.floats(0.0, 0.02)


@settings(deadline=None)
@given(light=loads, ratio=st.floats(1.0, 50.0), between=st.floats(0.0, 1.0), delay=delays)
def test_the_margins_of_the_rule_hold_for_every_load_between(
    light: float, ratio: float, between: float, delay: float
) -> None:
    loop = gains(light, light * ratio, delay=delay, period=PERIOD)
    found = margins(loop, light * ratio**between, delay=delay, period=PERIOD)
    assert found.phase >= degrees(PHASE_MARGIN) - 0.5  # gains have three digits
    assert found.gain >= GAIN_MARGIN - 0.05


@pytest.mark.parametrize("delay", [0.001, 0.0025, 0.006, 0.011])
@pytest.mark.parametrize("ratio", [1.0, 3.0, 20.0])
def test_they_hold_for_the_loop_as_it_is_sampled(delay: float, ratio: float) -> None:
    light = 0.01
    loop = gains(light, light * ratio, delay=delay, period=PERIOD)
    for load in (light, light * ratio**0.5, light * ratio):
        phase_margin, gain_margin = sampled_margins(loop, load, delay)
        assert phase_margin >= degrees(PHASE_MARGIN) - 1.0
        assert gain_margin >= 0.93 * GAIN_MARGIN


@pytest.mark.parametrize("change", [(2.0, 2.0), (1.0, 8.0)])
def test_other_gains_have_less_margin(change: tuple[float, float]) -> None:
    loop = gains(0.01, 0.03, delay=0.003, period=PERIOD)
    other = Gains(loop.kp * change[0], loop.ki * change[1])
    least = min(margins(other, load, delay=0.003, period=PERIOD).phase for load in (0.01, 0.03))
    assert least < degrees(PHASE_MARGIN) - 5.0


def swings(config: RobotConfig, loop: Gains, delay: float = 0.0) -> bool:
    """Whether the simulated wheel in the air goes on swinging around a speed at which nothing saturates."""
    wheel = Wheel(config, loop, delay)
    speeds = [wheel.cycle(JointCommand(CommandKind.VELOCITY, 5.0)) for _ in range(400)]
    early, late = np.std(speeds[60:160]), np.std(speeds[300:])
    return bool(late > 0.25 and late > 0.5 * early)


def most(holds: Callable[[float], bool], low: float, high: float) -> float:
    """Up to which it holds."""
    for _ in range(7):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return 0.5 * (low + high)


@pytest.mark.parametrize("name", ["omni4", "rectangular"])
def test_the_gain_margin_is_that_of_the_simulated_wheel(name: str) -> None:
    """By so much more gain it swings, in the simulation of controllers, bus and wheel."""
    config = config_of(name)
    found = tuned(config)
    _, foreseen = sampled_margins(found.after, found.answer.response.inertia, found.delay)
    factor = most(lambda factor: not swings(config, Gains(*(factor * one for one in found.after))), 1.0, 8.0)
    assert factor == pytest.approx(foreseen, rel=0.05)
    assert factor > GAIN_MARGIN


@pytest.mark.parametrize("name", ["omni4", "rectangular"])
def test_the_phase_margin_is_that_of_the_simulated_wheel(name: str) -> None:
    """By so much more delay it swings: a phase of delay times crossover. A substep of it is 7 deg there."""
    config = config_of(name)
    found = tuned(config)
    foreseen = margins(found.after, found.answer.response.inertia, delay=found.delay, period=PERIOD)
    late = 2.0 * most(lambda delay: not swings(config, found.after, delay), 0.0, 0.02)  # there and back
    assert degrees(late * foreseen.crossover) == pytest.approx(foreseen.phase, abs=8.0)


def test_a_step_is_foreseen_as_the_simulated_wheel_makes_it() -> None:
    config = config_of("omni4")
    found = tuned(config)
    wheel = Wheel(config, found.after)
    for _ in range(20):
        wheel.cycle(JointCommand(CommandKind.VELOCITY, 0.0))
    speeds = [wheel.cycle(JointCommand(CommandKind.VELOCITY, 1.0)) for _ in range(100)]
    times, foreseen = stepped(found.answer.response, found.after, period=PERIOD, seconds=0.5)
    told = np.interp(PERIOD * np.arange(100) - found.delay, times, foreseen)
    assert np.max(np.abs(told - speeds)) < 0.1
    assert np.std(told - speeds) < 0.02


# -- what is no answer ------------------------------------------------------------------------------------------------

TRUTH = Response(0.02, 0.03, 0.04, 0.003)
TIMES: Array = np.linspace(0.0, 699 * PERIOD, 700)


def steps(size: float, *, every: float = 0.25) -> Array:
    return np.asarray(TRUTH.drag + size * np.where((TIMES / every).astype(int) % 2 == 0, 1.0, -0.2))


def test_synthetic_data_are_found_exactly() -> None:
    torque = steps(0.1)
    speed, way = solve(TRUTH, TIMES, torque)
    found = identify(TIMES, way, speed, torque)
    assert found.response[:] == pytest.approx(TRUTH[:], rel=0.02)
    assert found.explained > 0.9999


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_interval_is_that_of_noise(seed: int) -> None:
    """Of 95 %, so that five times it is never left."""
    torque = steps(0.1)
    noise = np.random.default_rng(seed)
    speed, way = solve(TRUTH, TIMES, torque)
    found = identify(
        TIMES, way + noise.normal(0.0, 0.001, len(TIMES)), speed + noise.normal(0.0, 0.05, len(TIMES)), torque
    )
    assert abs(found.response.inertia - TRUTH.inertia) < 5.0 * found.halves.inertia
    assert abs(found.response.delay - TRUTH.delay) < 5.0 * found.halves.delay + 1e-4


def refusal(speed: Array, torque: Array) -> str:
    with pytest.raises(ResponseError) as refused:
        identify(TIMES, np.cumsum(speed) * PERIOD, speed, torque)
    return str(refused.value)


def test_what_does_not_turn_tells_nothing() -> None:
    assert "never changed" in refusal(np.zeros(700), steps(0.1))
    assert "no torque was told" in refusal(steps(0.1), np.zeros(700))


def test_one_level_of_torque_tells_shares_of_it_alone() -> None:
    """All of inertia, friction, and torque less drag may be any number of times as much."""
    torque: Array = np.full(700, 0.1)
    assert "one level" in refusal(solve(TRUTH, TIMES, torque)[0], torque)


def test_a_torque_that_changes_slowly_tells_too_little() -> None:
    noise = np.random.default_rng(1)
    torque: Array = 0.05 + 0.02 * TIMES
    speed = solve(TRUTH, TIMES, torque)[0] + noise.normal(0.0, 0.05, len(TIMES))
    assert "raise speed_loop.kp" in refusal(speed, torque)


def test_a_motion_that_the_torque_does_not_explain_is_no_answer() -> None:
    torque = steps(0.1)
    speed = solve(TRUTH, TIMES, torque)[0] + 2.0 * np.sin(9.0 * TIMES)
    assert "explain" in refusal(speed, torque)
    assert "busy" not in refusal(speed, torque)
    late = TIMES + np.where(TIMES > 1.0, 0.05, 0.0)
    with pytest.raises(ResponseError, match=r"busy\? One cycle took 54 ms"):
        identify(late, np.cumsum(speed) * PERIOD, speed, torque)


def test_too_short_a_motion_is_no_answer() -> None:
    with pytest.raises(ResponseError, match="less than 1 s"):
        identify(TIMES[:100], TIMES[:100], TIMES[:100], TIMES[:100])
    with pytest.raises(ResponseError, match="less than 1 s"):
        identify([], [], [], [])


def test_a_speed_that_is_not_known_all_the_time_is_no_answer() -> None:
    told = [Told(4_000_000 * cycle, 0.1, None if cycle == 9 else 0.1, 0.1) for cycle in range(700)]
    loop = SpeedLoop(kp=1.0, ki=1.0)
    with pytest.raises(ResponseError, match="not known"):
        tune(told, before=loop, carried=0.1, damping=0.0, period=PERIOD)


def test_the_delay_counts_at_its_longest_and_half_a_period_with_it() -> None:
    found = tuned(config_of("omni4"))
    assert found.delay == found.answer.response.delay + found.answer.halves.delay
    assert total_delay(found.delay, PERIOD) == found.delay + 0.002
    assert radians(60.0) == PHASE_MARGIN
