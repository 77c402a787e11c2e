"""The balance of momentum names the motor whose torque does not arrive; on a body integrated here, and by drives."""

from collections.abc import Callable
from itertools import combinations
from math import cos, sin

import pytest

from gateway.core.torque_loss import DRAG_SPEED, Mechanics, TorqueLossDetector
from gateway.types import ZERO_TWIST, Twist
from replay.drive.scenario import run_scenario
from replay.drive.scenario_file import Scenario
from tests.launches import Launch

# Four wheels of radius 0.1 m, 0.2 m from the middle, that drive along 30, 150, 210 and 330 degrees.
RADIUS, LEVER, TOP = 0.1, 0.2, 4.0  # m, m, N m
ANGLES = (2.617993877991494, 3.665191429188092, 5.759586531581287, 0.5235987755982988)
ROWS = tuple((cos(angle) / RADIUS, sin(angle) / RADIUS, LEVER / RADIUS) for angle in ANGLES)
MASS, INERTIA, ROTOR, FRICTION, DRAG = 20.0, 0.8, 0.004, 0.02, 0.1
DT = 0.004
Torques = Callable[[float], tuple[float, float, float, float]]


def detector() -> TorqueLossDetector:
    body = ((MASS, 0.0, 0.0), (0.0, MASS, 0.0), (0.0, 0.0, INERTIA))
    return TorqueLossDetector(Mechanics(ROWS, body, rotor=ROTOR, friction=FRICTION, drag=DRAG), [TOP] * 4)


def found(
    told: Torques,
    *,
    gains: tuple[float, ...] = (1.0,) * 4,
    mass: float = 1.0,
    inertia: float = 1.0,
    force: tuple[float, float, float] = (0.0, 0.0, 0.0),
    twist: Twist = ZERO_TWIST,
    seconds: float = 2.0,
) -> tuple[int, int] | None:
    """Place of the motor named, and the cycle; motors give `gains` of what they tell. Wheels do not slip."""
    looking = detector()
    masses = MASS * mass + 2.0 * ROTOR / RADIUS**2, INERTIA * inertia + 4.0 * ROTOR * (LEVER / RADIUS) ** 2
    along = sum((cos(angle)) ** 2 for angle in ANGLES) * ROTOR / RADIUS**2
    across = sum((sin(angle)) ** 2 for angle in ANGLES) * ROTOR / RADIUS**2
    vx, vy, wz = twist
    for cycle in range(round(seconds / DT)):
        torques = told(cycle * DT)
        named = looking.look(Twist(vx, vy, wz), torques if cycle else (0.0,) * 4, DT)
        if named is not None:
            return named[0], cycle
        for _ in range(20):  # small Euler steps
            fx, fy, fz = force
            for row, torque, gain in zip(ROWS, torques, gains, strict=True):
                speed = row[0] * vx + row[1] * vy + row[2] * wz
                net = gain * torque - FRICTION * speed - DRAG * max(-1.0, min(1.0, speed / 0.05))
                fx, fy, fz = fx + row[0] * net, fy + row[1] * net, fz + row[2] * net
            ax = (fx + MASS * mass * wz * vy) / (MASS * mass + along)
            ay = (fy - MASS * mass * wz * vx) / (MASS * mass + across)
            vx, vy, wz = vx + ax * DT / 20, vy + ay * DT / 20, wz + fz / masses[1] * DT / 20
    return None


def swinging(t: float) -> tuple[float, float, float, float]:
    """All four of them at different strengths and signs."""
    return 1.5 * cos(3.0 * t), 1.2 * sin(4.0 * t), -1.4 * cos(5.0 * t), 1.3 * sin(2.0 * t + 1.0)


def forward(_: float) -> tuple[float, float, float, float]:
    return -1.0, -1.0, 1.0, 1.0


@pytest.mark.parametrize("told", [swinging, forward])
def test_nothing_is_missing_of_a_sound_robot(told: Torques) -> None:
    assert found(told) is None


@pytest.mark.parametrize("motor", range(4))
@pytest.mark.parametrize("told", [swinging, forward])
def test_the_motor_is_named(told: Torques, motor: int) -> None:
    named = found(told, gains=tuple(float(place != motor) for place in range(4)))
    assert named is not None
    assert named[0] == motor
    assert named[1] * DT <= 0.4


@pytest.mark.parametrize("motor", range(4))
@pytest.mark.parametrize("gone", [1, 2])
def test_the_next_one_is_named_where_others_were_lost_before(motor: int, gone: int) -> None:
    """Of those nothing is told any more, because they are released; any two or three, in any order."""
    for others in combinations([place for place in range(4) if place != motor], gone):
        gains = tuple(float(place != motor and place not in others) for place in range(4))

        def told(t: float, others: tuple[int, ...] = others) -> tuple[float, float, float, float]:
            w, x, y, z = (0.0 if place in others else torque for place, torque in enumerate(swinging(t)))
            return w, x, y, z

        named = found(told, gains=gains)
        assert named is not None
        assert named[0] == motor
        assert named[1] * DT <= 1.0  # the weakest starts from nothing


@pytest.mark.parametrize("motor", range(4))
def test_half_a_torque_is_not_taken_for_none(motor: int) -> None:
    """What is missing is half of what would be with this motor dead: a quarter of it in watts is left."""
    assert found(swinging, gains=tuple(1.0 if place != motor else 0.5 for place in range(4))) is None


@pytest.mark.parametrize("mass", [0.7, 1.3, 6.0])
@pytest.mark.parametrize("inertia", [0.6, 1.0, 1.7])
@pytest.mark.parametrize("told", [swinging, forward])
def test_another_mass_is_no_lost_torque(told: Torques, mass: float, inertia: float) -> None:
    assert found(told, mass=mass, inertia=inertia) is None


@pytest.mark.parametrize("force", [(17.0, 0.0, 0.0), (0.0, -17.0, 0.0), (100.0, 100.0, 0.0), (-80.0, 0.0, 0.0)])
@pytest.mark.parametrize("told", [swinging, forward])
def test_a_slope_or_a_push_is_no_lost_torque(told: Torques, force: tuple[float, float, float]) -> None:
    """5 degrees are 17 N."""
    assert found(told, force=force) is None


def test_a_coasting_robot_in_a_curve_misses_nothing() -> None:
    """The momentum turns in the frame of the body, and the rotors' does not."""
    assert found(lambda _: (0.0,) * 4, twist=Twist(1.0, -0.5, 3.0)) is None


def test_little_torque_is_no_evidence() -> None:
    """0.1 of 4 N m; enough to tell takes 0.1 of the limit for 0.1 s within the memory of 0.2 s."""
    gains, coasting = (0.0, 1.0, 1.0, 1.0), Twist(1.0, 0.0, 0.0)
    assert found(lambda _: (0.1, 0.0, 0.0, 0.0), gains=gains, twist=coasting) is None
    assert found(lambda _: (1.0, 0.0, 0.0, 0.0), gains=gains, twist=coasting) is not None


ROLLING = Twist(0.5, 0.0, 0.0)


def steadily(twist: Twist) -> tuple[float, ...]:
    """N m that go into friction at this motion."""
    speeds = [row[0] * twist.vx + row[1] * twist.vy + row[2] * twist.wz for row in ROWS]
    return tuple(FRICTION * speed + DRAG * max(-1.0, min(1.0, speed / DRAG_SPEED)) for speed in speeds)


@pytest.mark.parametrize("gap", ["motion", "torque"])
def test_what_is_not_known_begins_anew(gap: str) -> None:
    """Every 60 ms a cycle in which the motion, or a torque, is not told: no evidence lasts so long."""
    looking = detector()
    first, *others = steadily(ROLLING)
    for cycle in range(1000):
        hole = cycle % 15 == 0
        twist = None if hole and gap == "motion" else ROLLING
        assert looking.look(twist, (None if hole and gap == "torque" else first + 0.6, *others), DT) is None
    assert any(looking.look(ROLLING, (first + 0.6, *others), DT) for _ in range(100))


def test_what_a_speed_loop_still_pushes_at_rest_is_held_by_dry_friction() -> None:
    for share in (0.9, 1.1):
        looking, creeping = detector(), Twist(share * DRAG_SPEED * RADIUS / cos(ANGLES[3]), 0.0, 0.0)
        first, *others = steadily(creeping)
        named = [looking.look(creeping, (first - 0.9, *others), DT) for _ in range(1000)]
        assert any(named) is (share > 1.0)


TROUBLE: dict[str, list[tuple[str, float, str | None]]] = {
    "light": [("mass", 17.5, None)],
    "heavy": [("mass", 32.5, None)],
    "loaded": [("mass", 150.0, None)],
    "uphill": [("slope", 0.087, None)],
    "downhill, heavy": [("slope", -0.087, None), ("mass", 32.5, None)],
    "one wheel on ice": [("friction", 0.05, "front_left")],
    "slippery": [("friction", 0.3, None)],
}


@pytest.mark.parametrize("trouble", TROUBLE)
def test_no_trouble_of_a_sound_robot_is_taken_for_a_lost_torque(trouble: str) -> None:
    """Hard changes of command by the closed loop; 100 random drives of 20 s with loads, slopes and pushes told none."""
    rest = {"source": "teleop", "vx": 0.0, "vy": 0.0, "wz": 0.0}
    twists = [(2.0, 0.0, 0.0), (0.0, 1.5, 0.0), (-1.0, 0.5, 2.0), (1.0, -1.0, -4.0), (-2.0, 0.0, 0.0), (0.0, 0.0, 4.0)]
    at: list[dict[str, object]] = [{"t": 0.2, "command": rest}]
    for place, (vx, vy, wz) in enumerate(twists):
        at.append({"t": 0.6 + 0.7 * place, "command": rest | {"vx": vx, "vy": vy, "wz": wz}})
    for kind, value, motor in TROUBLE[trouble]:
        at.append({"t": 0.0, "fault": {"kind": kind, "value": value} | ({} if motor is None else {"motor": motor})})
    result = run_scenario(Scenario.model_validate({"robot": "omni4", "seconds": 5.0, "at": at}))
    assert "fault_torque_lost" not in {event.code for _, event in result.events}


def test_a_robot_that_stopped_on_wheels_that_slipped_is_sound() -> None:
    """Its speed loops go on pushing a little, each its own way, and nothing moves."""
    launch = Launch("omni4_gm6020", 3, 0.8, told=None, seconds=0.4, stop=False)
    launch._drive(ZERO_TWIST, 2.0)
    assert {"slip", "slip_over"} <= set(launch.codes)
    assert "fault_torque_lost" not in launch.codes
