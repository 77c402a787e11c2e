"""One motor turns a little, and never further: every controller, and whatever goes wrong."""

from collections.abc import Callable

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gateway.config import RobotConfig, parse
from gateway.setup.excitation import Excitation
from gateway.setup.jog import LISTEN_NS, Ending, Jog, JogError, Phase
from tests.jogging import ENDS_NS, MS, QUARTER_TURN, Bench, Ride, ride
from tests.setup_robots import TRUE
from tests.world import BUNDLED, robot_text

ROBOTS = (*BUNDLED, *TRUE)
OTHERS = ("moby", "omni4", "omni4_gm6020", "omni4_vesc", "kiwi")  # every controller, in every mode


def config_of(name: str) -> RobotConfig:
    text = TRUE[name]() if name in TRUE else robot_text(name)
    return parse(text, name)


def reverse(bench: Bench, motor: str) -> None:
    bench.bus.robot.drivetrain(motor).gain = -1.0


def freeze(bench: Bench, motor: str) -> None:
    bench.bus.robot.devices[motor].freeze_encoder(True)


def add_twin(bench: Bench, motor: str) -> None:
    bench.bus.add_twin(motor, 1.0)


def spin(speed: float | None) -> Callable[[Bench, str], None]:
    """Somebody or something turns it."""

    def turn(bench: Bench, motor: str) -> None:
        bench.plant.by_hand[list(bench.bus.robot.devices).index(motor)] = speed

    return turn


FAULTS: dict[str, Callable[[Bench, str], None]] = {
    "phases swapped": reverse,
    "no power": lambda bench, motor: bench.bus.robot.devices[motor].power_off(),
    "cable cut": lambda bench, motor: bench.bus.robot.devices[motor].unplug(),
    "bus down": lambda bench, _motor: bench.bus.fail("can0"),
    "a twin": add_twin,
    "turned by force": spin(3.0),
    "turned back by force": spin(-3.0),
}


# What nothing here can end, or what is no fault of that motor: a C620 or GM6020 whose cable is cut holds its last
# command, and the windings of a motor that is told voltages brake it whichever way round they are.
HOLDING = ("omni4", "omni4_gm6020")
BEYOND = {(name, fault) for name in HOLDING for fault in ("cable cut", "bus down")} | {
    ("omni4_gm6020", "phases swapped")
}
CASES = [(name, fault) for name in OTHERS for fault in FAULTS if (name, fault) not in BEYOND]


@pytest.mark.parametrize("name", ROBOTS)
def test_each_motor_turns_as_far_as_asked_and_no_other_moves(name: str) -> None:
    config = config_of(name)
    motors = config.motors_in_order()
    for place, motor in enumerate(motors):
        bench = Bench(config)
        found = ride(bench, Jog(config, motor.name, speed=0.5 if place % 2 else -0.5), motor.name)
        assert found.outcome.ending is Ending.TURNED, found.outcome
        assert found.outcome.released
        assert found.outcome.moved == pytest.approx(found.ways[-1][1], abs=0.03)
        assert 0.2 < found.ways[-1][1] < 0.42
        assert bench.bus.robot.truth.joint_rates == (0.0,) * len(motors)
        assert [angle for at, angle in enumerate(bench.plant.angles) if at != place] == [0.0] * (len(motors) - 1)


@pytest.mark.parametrize("name", ROBOTS)
def test_nothing_is_sent_before_it_has_listened(name: str) -> None:
    config = config_of(name)
    bench, jog = Bench(config), Jog(config, config.motor[0].name)
    begun_ns = bench.now_ns
    ride(bench, jog, config.motor[0].name)
    assert bench.sent[0][0] >= begun_ns + LISTEN_NS


def broken(name: str, fault: str, at_ms: int, speed: float | None = 0.5) -> tuple[Ride, int | None]:
    """The jog (no speed: the steps of speed), and when it was broken, of a fault so many ms after it was armed."""
    config = config_of(name)
    motor = config.motor[0].name
    bench, jog = Bench(config), Excitation(config, motor) if speed is None else Jog(config, motor, speed=speed)
    armed_ns: list[int] = []
    done: list[int] = []

    def disturb(bench: Bench, phase: Phase, _gone_ns: int) -> None:
        if phase in (Phase.ARM, Phase.TURN) and not armed_ns:
            armed_ns.append(bench.now_ns)
        if armed_ns and not done and bench.now_ns >= armed_ns[0] + at_ms * MS:
            done.append(bench.now_ns)
            FAULTS[fault](bench, motor)
        if phase in (Phase.RELEASE, Phase.DONE) and fault.startswith("turned"):
            spin(None)(bench, motor)  # whoever turned it lets go

    return ride(bench, jog, motor, disturb), done[0] if done else None


@pytest.mark.parametrize(("name", "fault"), CASES)
@pytest.mark.parametrize("at_ms", [0, 400])
def test_whatever_breaks_it_ends_within_a_fifth_of_a_second_and_a_quarter_turn(
    name: str, fault: str, at_ms: int
) -> None:
    found, broken_ns = broken(name, fault, at_ms)
    assert broken_ns is not None
    assert found.outcome.ending in (Ending.RUNAWAY, Ending.LOST, Ending.STUCK), found.outcome
    assert found.furthest() < QUARTER_TURN
    released_ns = found.began(Phase.RELEASE)
    assert released_ns is not None
    since_ns = seen_ns(found, broken_ns)
    assert released_ns - since_ns <= ENDS_NS, found.outcome


def seen_ns(found: Ride, broken_ns: int) -> int:
    """When it was first not where it should be; a fault that shows in no motion is there when it comes."""
    if found.outcome.ending is Ending.RUNAWAY:
        return next(at for at, way, asked in found.ways if way > asked + 0.3 or way < -0.15 or at >= released(found))
    return broken_ns if found.outcome.ending is Ending.LOST else released(found)


def released(found: Ride) -> int:
    at = found.began(Phase.RELEASE)
    assert at is not None
    return at


HOSTED = [(name, fault) for name, fault in CASES if name in HOLDING]


@pytest.mark.parametrize(("name", "fault"), HOSTED)
@pytest.mark.parametrize("at_ms", [0, 900])
def test_whatever_breaks_the_steps_of_speed_they_end_as_soon(name: str, fault: str, at_ms: int) -> None:
    found, broken_ns = broken(name, fault, at_ms, None)
    assert broken_ns is not None
    assert found.outcome.ending in (Ending.RUNAWAY, Ending.LOST, Ending.STUCK), found.outcome
    assert found.furthest() < QUARTER_TURN
    assert released(found) - seen_ns(found, broken_ns) <= ENDS_NS, found.outcome


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(case=st.sampled_from(HOSTED), at_ms=st.integers(0, 3400))
def test_no_fault_lets_the_steps_of_speed_run_beyond_their_bound(case: tuple[str, str], at_ms: int) -> None:
    found, _ = broken(*case, at_ms, None)
    assert found.furthest() < QUARTER_TURN, found.outcome


@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    case=st.sampled_from(CASES),
    at_ms=st.integers(0, 1100),
    speed=st.sampled_from([-1.0, -0.5, -0.2, 0.2, 0.5, 1.0]),
)
def test_no_fault_at_any_moment_lets_it_run_beyond_its_bound(case: tuple[str, str], at_ms: int, speed: float) -> None:
    found, _ = broken(*case, at_ms, speed)
    assert found.furthest() < QUARTER_TURN, found.outcome


@pytest.mark.parametrize("name", OTHERS)
def test_asked_to_stop_it_stops(name: str) -> None:
    config = config_of(name)
    motor = config.motor[0].name
    bench, jog = Bench(config), Jog(config, motor, speed=1.0, seconds=3.0)
    asked: list[int] = []

    def stop(bench: Bench, phase: Phase, _gone_ns: int) -> None:
        if phase is Phase.TURN and bench.bus.robot.truth.joint_rates[0] > 0.5 and not asked:
            asked.append(bench.now_ns)
            jog.stop("Ctrl-C")

    found = ride(bench, jog, motor, stop)
    assert (found.outcome.ending, found.outcome.reason) == (Ending.ASKED, "Ctrl-C")
    assert found.outcome.released
    assert released(found) - asked[0] <= ENDS_NS
    assert bench.bus.robot.truth.joint_rates == (0.0,) * len(config.motor)


@pytest.mark.parametrize("name", OTHERS)
def test_an_encoder_that_tells_nothing_ends_it_soon(name: str) -> None:
    config = config_of(name)
    motor = config.motor[0].name
    bench = Bench(config)
    freeze(bench, motor)
    found = ride(bench, Jog(config, motor), motor)
    assert found.outcome.ending in (Ending.STUCK, Ending.LOST)
    turned_ns = found.began(Phase.TURN)
    assert turned_ns is not None
    assert released(found) - turned_ns <= 600 * MS


@pytest.mark.parametrize("name", OTHERS)
def test_one_that_turns_already_or_is_not_heard_is_not_armed(name: str) -> None:
    config = config_of(name)
    motor = config.motor[0].name
    bench = Bench(config)
    spin(1.0)(bench, motor)
    turning = ride(bench, Jog(config, motor), motor)
    assert (turning.outcome.ending, turning.began(Phase.ARM)) == (Ending.NEVER, None)
    bench = Bench(config)
    bench.bus.robot.devices[motor].power_off()
    silent = ride(bench, Jog(config, motor), motor)
    assert (silent.outcome.ending, silent.began(Phase.ARM)) == (Ending.NEVER, None)
    assert "not heard" in silent.outcome.reason


@pytest.mark.parametrize(
    ("motor", "speed", "seconds", "words"),
    [
        ("wing", 0.5, 1.0, "no such"),
        ("left", 0.0, 1.0, "must be 0.05 to 1"),
        ("left", 2.5, 1.0, "must be 0.05 to 1"),
        ("left", float("nan"), 1.0, "must be 0.05 to 1"),
        ("left", 0.5, 9.0, "must be 0.2 to 5"),
        ("left", 0.5, float("nan"), "must be 0.2 to 5"),
        ("left", 1.0, 4.0, "half a turn"),
    ],
)
def test_bounds(motor: str, speed: float, seconds: float, words: str) -> None:
    with pytest.raises(JogError, match=words):
        Jog(config_of("moby"), motor, speed=speed, seconds=seconds)


def test_a_speed_that_its_controller_would_brake_is_refused() -> None:
    config = parse(robot_text("omni4_vesc").replace("min_erpm = ", "min_erpm = 9"), "omni4_vesc")
    with pytest.raises(JogError, match="rad/s at least for its controller"):
        Jog(config, "front_left")


def test_reports_that_come_too_seldom_are_refused() -> None:
    config = parse(robot_text("moby").replace("feedback_rate = 250.0", "feedback_rate = 20.0"), "moby")
    with pytest.raises(JogError, match="so that a runaway is seen"):
        Jog(config, "left")
