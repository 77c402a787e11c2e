"""What other robot software states in its tests and formulas for the same geometry: independent numbers, our mapping.

tests/vectors/peers.json holds the numbers, which peer they stem from and in which version, and the mapping in words.
Here is the mapping in code, once per kind of geometry, and how each kind of case is asked of us.
"""

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from math import cos, pi, radians, sin
from pathlib import Path
from typing import Any

import pytest

from gateway.chassis.omni import WheelPose, omni_kinematics
from gateway.core.odometry import WheelOdometry, advance
from gateway.kinematics.contract import desaturate
from gateway.kinematics.fixed_wheels import FixedWheels
from gateway.kinematics.mecanum import MecanumWheel, mecanum_kinematics
from gateway.kinematics.offset_differential import OffsetDifferentialKinematics
from gateway.types import Displacement, Pose, Twist

Given = Mapping[str, Any]
DOCUMENT = json.loads((Path(__file__).parents[1] / "vectors" / "peers.json").read_text(encoding="utf-8"))
GEOMETRIES: Given = DOCUMENT["geometries"]
CASES: list[Given] = DOCUMENT["cases"]
STEP_NS = 1_000_000_000

# geometries, in the peer's order of wheels


def ring(geometry: Given) -> FixedWheels:
    angles = [geometry["first_angle"] + 2.0 * pi * index / geometry["wheels"] for index in range(geometry["wheels"])]
    distance = geometry["distance"]
    return omni_kinematics([WheelPose(distance * cos(a), distance * sin(a), a, geometry["radius"]) for a in angles])


def mecanum(geometry: Given) -> FixedWheels:
    (x, y), (from_x, from_y) = (geometry["x"], geometry["y"]), geometry["center"]
    places = ((x, y, -45.0), (x, -y, 45.0), (-x, y, 45.0), (-x, -y, -45.0))
    return mecanum_kinematics(
        [
            MecanumWheel(at_x - from_x, at_y - from_y, radians(roller), geometry["radius"])
            for at_x, at_y, roller in places
        ]
    )


def omni(geometry: Given) -> FixedWheels:
    return omni_kinematics([driving(*wheel) for wheel in geometry["wheels"]])


def driving(x: float, y: float, drive: float, radius: float) -> WheelPose:
    """A wheel that drives in this direction (degrees): its axle lies a quarter turn before."""
    return WheelPose(x, y, radians(drive - 90.0), radius)


OMNI: dict[str, Callable[[Given], FixedWheels]] = {"ring": ring, "mecanum": mecanum, "omni": omni}
SIGNS = {"ring": -1.0, "mecanum": 1.0, "omni": 1.0}  # of their wheel speeds against ours


def chassis(given: Given) -> FixedWheels:
    geometry = GEOMETRIES[given["geometry"]]
    return OMNI[geometry["kind"]](geometry)


def turned(given: Given, speeds: Sequence[float]) -> list[float]:
    """Theirs from ours, or ours from theirs."""
    sign = SIGNS[GEOMETRIES[given["geometry"]]["kind"]]
    return [sign * speed for speed in speeds]


def offset(given: Given) -> OffsetDifferentialKinematics:
    geometry = GEOMETRIES[given["geometry"]]
    return OffsetDifferentialKinematics(
        wheel_radius=geometry["radius"], axle_offset=geometry["axle_offset"], track=geometry["track"]
    )


# what each kind of case asks


def wheels(given: Given) -> list[float]:
    return turned(given, chassis(given).wheel_speeds(Twist(*given["twist"])))


def twist(given: Given) -> Twist:
    estimate = chassis(given).twist(turned(given, given["wheels"]))
    assert estimate is not None
    return estimate.twist


def there_and_back(given: Given) -> Twist:
    return twist({**given, "wheels": wheels(given)})


def signs(given: Given) -> list[float]:
    return [(speed > 0.0) - (speed < 0.0) for speed in wheels(given)]


def signs_and_pairs(given: Given) -> list[float]:
    """The signs, and the sums of the front and of the rear pair."""
    front_right, front_left, back_left, back_right = wheels(given)
    return [*signs(given), front_right + front_left, back_left + back_right]


def magnitudes(given: Given) -> list[float]:
    return [abs(speed) for speed in wheels(given)]


def matrix(given: Given) -> list[float]:
    return [float(entry) for row in chassis(given).matrix() for entry in row]


def odometry(given: Given) -> Pose:
    """One update from rest by these ways of the wheels, with the headings before and after where a gyro is there."""
    before, after = given.get("headings", (None, None))
    ways = turned(given, given["ways"])
    angles = [0.0] * len(ways)
    one = WheelOdometry(chassis(given), top_speeds=[1e3] * len(ways))
    for step, (positions, heading) in enumerate(((angles, before), (ways, after)), start=1):
        deltas, jumped = one.deltas(positions, [0] * len(positions), step * STEP_NS)
        assert not jumped
        one.update(deltas, positions, residual=None, dt=1.0, heading=heading)
    return one.pose


def arc(given: Given) -> Pose:
    vx, vy, wz = (rate * given["seconds"] for rate in given["twist"])
    return advance(Pose(0.0, 0.0, 0.0), Displacement(vx, vy, wz))


def arc_of_ways(given: Given) -> Pose:
    """The way as the wheels have it, with another turn."""
    dx, dy, _ = twist({**given, "wheels": given["ways"]})
    return advance(Pose(0.0, 0.0, 0.0), Displacement(dx, dy, given["turn"]))


def desaturated(given: Given) -> list[float]:
    speeds: list[float] = given["wheels"]
    factor = desaturate(speeds, [given["limit"]] * len(speeds))
    return [factor * speed for speed in speeds]


def joints(given: Given) -> list[float]:
    speeds = offset(given).wheel_speeds(Twist(*given["twist"]), [None, None, -given["heading"]])
    assert speeds is not None
    return speeds


def twist_of_joints(given: Given) -> Twist:
    estimate = offset(given).twist(given["joints"], [None, None, -given["heading"]])
    assert estimate is not None
    return estimate.twist


CHECKS: dict[str, Callable[[Given], Sequence[float]]] = {
    "wheels": wheels,
    "twist": twist,
    "there_and_back": there_and_back,
    "signs": signs,
    "signs_and_pairs": signs_and_pairs,
    "magnitudes": magnitudes,
    "matrix": matrix,
    "odometry": odometry,
    "arc": arc,
    "arc_of_ways": arc_of_ways,
    "desaturate": desaturated,
    "joints": joints,
    "twist_of_joints": twist_of_joints,
}


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["id"])
def test_we_agree_with_the_peer(case: Given) -> None:
    got = CHECKS[case["check"]](case["given"])
    assert list(got) == pytest.approx(case["expected"], abs=case["tolerance"], rel=0.0), case["source"]


def test_every_peer_and_every_kind_of_case_is_there() -> None:
    """Nothing falls out unnoticed: the numbers of cases are written out."""
    assert Counter(case["id"].split("#")[0] for case in CASES) == {
        "ros2_controllers": 29,
        "wpimath": 25,
        "thunderbots": 11,
        "hamr_control": 12,
        "offset_diff_drive": 5,
    }
    assert {case["id"].split("#")[0] for case in CASES} == set(DOCUMENT["peers"])
    assert {case["check"] for case in CASES} == set(CHECKS)
    assert {case["given"]["geometry"] for case in CASES if "geometry" in case["given"]} == set(GEOMETRIES)


def test_a_quarter_turn_by_the_wheels_alone_is_another_one() -> None:
    """The one case that needs the gyro: its wheels turn 63.6 degrees only (1.1107 rad), 2.3 m beside."""
    (case,) = (case for case in CASES if case["source"].endswith(": 90DegreeTurn"))
    given = {name: value for name, value in case["given"].items() if name != "headings"}
    assert odometry(given) == pytest.approx((10.7524, 6.6716, 1.1107), abs=1e-4)
