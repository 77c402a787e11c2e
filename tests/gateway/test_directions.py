"""Which controller drives which wheel, and which way: found on robots whose files are wrong, against the truth."""

from collections.abc import Mapping

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gateway.config import RobotConfig, parse
from gateway.setup.by_hand import HandWatch, Turned
from gateway.setup.census import Census, Found
from gateway.setup.correction import Change, CorrectionError, corrected, difference
from gateway.setup.directions import Device, Directions, FindingError, Trial, says
from gateway.setup.jog import Ending, Jog
from gateway.setup.words import positive_ways, rolling
from tests.jogging import Bench, ride
from tests.setup_robots import TRUE, wronged
from tests.world import BUNDLED, robot_text

BUS = "can0"
TURNED = 0.1  # rad, that a person sees


def config_of(name: str) -> RobotConfig:
    return parse(TRUE[name](), name)


def found_on(bench: Bench, config: RobotConfig) -> list[Found]:
    """By listening for 0.6 s."""
    census = Census()
    for _ in range(150):
        census.take(bench.cycle())
    known = [(motor.driver, motor.variant, motor.id) for motor in config.motor]
    return list(census.report(0.6, known).found)


def seen(bench: Bench, before: Mapping[str, float]) -> str:
    """What a person at the robot says: with the words of the prompt."""
    truth = dict(zip(bench.bus.robot.devices, bench.bus.robot.truth.joint_angles, strict=True))
    moved = {name: angle - before[name] for name, angle in truth.items() if abs(angle - before[name]) > TURNED}
    assert len(moved) <= 1
    return next((f"{name} {'f' if way > 0.0 else 'b'}" for name, way in moved.items()), "n")


def tried(bench: Bench, trial: Trial, names: tuple[str, ...]) -> tuple[str, bool] | None:
    before = dict(zip(bench.bus.robot.devices, bench.bus.robot.truth.joint_angles, strict=True))
    jog = Jog(trial.config, trial.motor)
    ride(bench, jog, names[0], coasting=0.1)
    assert jog.outcome is not None
    assert jog.outcome.ending is Ending.TURNED, (trial.device, jog.outcome)
    return says(seen(bench, before), trial, names)


def driven(true: str, wrong: str) -> str:
    """The wrong file, corrected by turning every controller that answers."""
    config = parse(wrong, "wrong")
    bench = Bench(parse(true, "true"))
    directions = Directions(config, BUS, found_on(bench, config))
    for trial in directions.trials():
        answer = tried(bench, trial, directions.names)
        if answer is None:
            directions.nothing_turned(trial.device)
            continue
        motor, forward = answer
        sign = next(one.direction for one in trial.config.motor if one.name == trial.motor)
        directions.note(trial.device, motor, sign if forward else -sign)
    assert directions.missing == ()
    return corrected(wrong, directions.changes(), "wrong")


def turned_by_hand(bench: Bench, watch: HandWatch, motor: str, speed: float, seconds: float = 0.8) -> Turned | None:
    place = list(bench.bus.robot.devices).index(motor)
    for cycle in range(400):
        bench.plant.by_hand[place] = speed if cycle * 0.004 < seconds else 0.0
        watch.take(bench.cycle())
        found = watch.turned()
        if found is not None:
            return found
    return None


def by_hand(true: str, wrong: str) -> str:
    """The wrong file, corrected by turning every wheel by hand."""
    config = parse(wrong, "wrong")
    bench = Bench(parse(true, "true"))
    directions = Directions(config, BUS, found_on(bench, config))
    watch = HandWatch({(motor.driver, motor.variant) for motor in config.motor})
    watch.take(bench.cycle())
    for motor in config.motors_in_order():
        watch.begin(motor.gear_ratio)
        found = turned_by_hand(bench, watch, motor.name, 1.5)
        assert found is not None
        assert found.others == ()
        directions.note(Device(found.driver, found.variants, found.id), motor.name, 1 if found.way > 0.0 else -1)
    assert bench.sent == []
    return corrected(wrong, directions.changes(), "wrong")


WRONG: dict[str, dict[str, tuple[dict[str, int], dict[str, int]]]] = {
    # One swapped pair, ids that nobody has, directions the other way round, a gear that turns them round.
    "kiwi": {
        "swapped": ({"front": 2, "rear_left": 5}, {}),
        "all": ({"front": 2, "rear_left": 5, "rear_right": 3}, {"front": 1, "rear_left": 1, "rear_right": 1}),
    },
    "mobyish": {
        "swapped": ({"left": 3, "right": 1}, {}),
        "all": ({"left": 3, "right": 7, "platform": 1}, {"left": 1, "right": -1}),
    },
    "rectangular": {
        "swapped": ({"front_left": 2, "front_right": 1}, {}),
        "all": (
            {"front_left": 4, "rear_left": 1, "front_right": 3, "rear_right": 2},
            {"rear_right": 1, "front_left": -1},
        ),
    },
}
CASES = [(name, case) for name, cases in WRONG.items() for case in cases]


@pytest.mark.parametrize(("name", "case"), CASES)
def test_the_file_becomes_the_true_one_by_turning(name: str, case: str) -> None:
    true = TRUE[name]()
    wrong = wronged(true, *WRONG[name][case])
    assert wrong != true
    assert driven(true, wrong) == true


@pytest.mark.parametrize(("name", "case"), CASES)
def test_the_file_becomes_the_true_one_by_hand(name: str, case: str) -> None:
    true = TRUE[name]()
    assert by_hand(true, wronged(true, *WRONG[name][case])) == true


@st.composite
def mistakes(draw: st.DrawFn) -> tuple[str, str]:
    """A true file, and one with any ids that are unique and any directions."""
    name = draw(st.sampled_from(sorted(TRUE)))
    motors = config_of(name).motor
    ids = draw(st.lists(st.integers(1, 8), min_size=len(motors), max_size=len(motors), unique=True))
    signs = draw(st.lists(st.sampled_from([1, -1]), min_size=len(motors), max_size=len(motors)))
    names = [motor.name for motor in motors]
    true = TRUE[name]()
    return true, wronged(true, dict(zip(names, ids, strict=True)), dict(zip(names, signs, strict=True)))


SLOW = settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.too_slow])


@SLOW
@given(mistakes())
def test_whatever_is_wrong_turning_finds_it(files: tuple[str, str]) -> None:
    assert driven(*files) == files[0]


@SLOW
@given(mistakes())
def test_whatever_is_wrong_hands_find_it(files: tuple[str, str]) -> None:
    assert by_hand(*files) == files[0]


@pytest.mark.parametrize("name", ["omni4_vesc", "omni4_gm6020"])
def test_other_controllers_too(name: str) -> None:
    true = robot_text(name)
    wrong = wronged(true, {"front_left": 2, "rear_left": 1}, {"front_left": -1, "rear_right": -1})
    for found in (driven(true, wrong), by_hand(true, wrong)):
        assert parse(found, name) == parse(true, name)


def test_a_gm6020_is_another_than_a_c620_of_the_same_id() -> None:
    """A C620 of id 7 speaks as a GM6020 of id 3 would."""
    true = TRUE["rectangular"]().replace("id = 4 ", "id = 3 ")
    wrong = wronged(true, {"rear_right": 4}, {})
    assert driven(true, wrong) == true == by_hand(true, wrong)


@pytest.mark.parametrize("way", [1.5, -1.5])
def test_a_wheel_turned_backwards_is_seen_to_be(way: float) -> None:
    config = config_of("rectangular")
    bench, watch = Bench(config), HandWatch({("dji", "c620")})
    watch.take(bench.cycle())
    watch.begin(config.motor[0].gear_ratio)
    found = turned_by_hand(bench, watch, "front_left", way)
    assert found is not None
    assert (found.driver, found.id, found.way > 0.0) == ("dji", 1, way > 0.0)
    assert abs(found.way) == pytest.approx(1.2 * config.motor[0].gear_ratio, rel=0.05)


def test_too_little_is_no_turn_and_two_at_once_are_not_sure() -> None:
    config = config_of("rectangular")
    bench, watch = Bench(config), HandWatch({("dji", "c620")})
    watch.take(bench.cycle())
    watch.begin(config.motor[0].gear_ratio)
    assert turned_by_hand(bench, watch, "front_left", 1.5, seconds=0.2) is None
    watch.begin(config.motor[0].gear_ratio)
    for _ in range(200):
        bench.plant.by_hand[:2] = [1.5, 1.0]
        watch.take(bench.cycle())
    bench.plant.by_hand[:2] = [0.0, 0.0]
    found = turned_by_hand(bench, watch, "rear_right", 0.0)
    assert found is not None
    assert found.others == ("dji id 2",)


def test_a_controller_that_no_motor_can_have_is_not_turned() -> None:
    config = config_of("kiwi")
    bench = Bench(config_of("rectangular"))
    directions = Directions(config, BUS, found_on(bench, config))
    assert directions.devices == ()
    assert list(directions.trials()) == []
    assert directions.missing == ("front", "rear_left", "rear_right")


def test_what_is_not_needed_is_not_turned() -> None:
    config = config_of("kiwi")
    named = Found("odrive", ("0.6",), 9, (), None, (), commanded=False)
    directions = Directions(config, BUS, [named._replace(id=at) for at in (1, 2, 3, 5, 9)])
    trials = iter(directions.trials())
    for motor in ("rear_left", "front", "rear_right"):
        trial = next(trials)
        assert (trial.motor, trial.guess) == (motor, True)
        directions.note(trial.device, motor, 1)
    assert list(trials) == []


def test_what_was_not_found_keeps_its_id_unless_that_is_another_s() -> None:
    config = config_of("mobyish")
    bench = Bench(config)
    found = found_on(bench, config)
    directions = Directions(config, BUS, found)
    directions.note(Device("odrive", ("0.6",), 1), "left", 1)
    assert directions.changes() == [Change("left", "direction", -1, 1)]
    directions.note(Device("odrive", ("0.6",), 3), "platform", 1)
    with pytest.raises(FindingError, match="motor right was not found, and its id 3 is that of platform"):
        directions.changes()


def test_what_cannot_be_is_refused() -> None:
    directions = Directions(config_of("mobyish"), BUS, ())
    directions.note(Device("odrive", ("0.6",), 1), "left", 1)
    with pytest.raises(FindingError, match="turned it already"):
        directions.note(Device("odrive", ("0.6",), 2), "left", 1)
    with pytest.raises(FindingError, match="no such motor on this bus"):
        directions.note(Device("odrive", ("0.6",), 2), "wing", 1)
    with pytest.raises(FindingError, match="which vesc id 2 is not"):
        directions.note(Device("vesc", ("vesc",), 2), "right", 1)


TRIAL = Trial(Device("odrive", ("0.6",), 1), config_of("mobyish"), "left", guess=True)
NAMES = ("left", "right", "platform")


@pytest.mark.parametrize(
    ("answer", "meant"),
    [("f", ("left", True)), (" B\n", ("left", False)), ("right f", ("right", True)), ("n", None)],
)
def test_answers(answer: str, meant: tuple[str, bool] | None) -> None:
    assert says(answer, TRIAL, NAMES) == meant


@given(st.text(max_size=12))
def test_other_answers_are_refused_in_words(answer: str) -> None:
    if answer.lower().split() not in (["f"], ["b"], ["n"], *([name, way] for name in NAMES for way in "fb")):
        with pytest.raises(FindingError, match="must be f, b or n"):
            says(answer, TRIAL, NAMES)


def test_what_is_positive_is_said_in_words() -> None:
    assert positive_ways(config_of("kiwi").robot) == {
        "front": "the wheel rolls to the left",
        "rear_left": "the wheel rolls 150 degrees to the right of forward",
        "rear_right": "the wheel rolls 30 degrees to the right of forward",
    }
    assert positive_ways(config_of("mobyish").robot)["platform"].startswith("the body turns counter-clockwise")
    assert {rolling(angle) for angle in (3.1415926, -3.1415926)} == {"backward"}


@pytest.mark.parametrize("name", [*BUNDLED, *TRUE])
def test_every_joint_has_words(name: str) -> None:
    config = config_of(name) if name in TRUE else parse(robot_text(name), name)
    ways = positive_ways(config.robot)
    assert tuple(ways) == config.robot.motor_names()
    assert not any("joint turns" in words for words in ways.values())


def test_a_correction_keeps_comments_and_shows_itself() -> None:
    text = TRUE["kiwi"]()
    new = corrected(text, [Change("front", "id", 5, 6)], "kiwi.toml")
    assert difference(text, new, "kiwi.toml").splitlines()[3:] == [
        ' bus = "can0"',
        "-id = 5   # as its switch says",
        "+id = 6   # as its switch says",
        " direction = -1",
    ]
    with pytest.raises(CorrectionError, match="cannot be changed"):
        corrected(text, [Change("front", "id", 5, 2), Change("front", "direction", 1, 3)], "kiwi.toml")
