"""From an empty file to a driven square: the interview, the controllers found and put right, the drive."""

from itertools import pairwise
from math import hypot

import pytest

from gateway.setup.fields import Value
from gateway.setup.interview import robot_file
from gateway.types import Request, RequestKind, Twist, TwistFrame
from tests.gateway.test_directions import by_hand, driven
from tests.gateway.test_setup_new import asking
from tests.setup_robots import wronged
from tests.world import World

SIDE = 0.5  # m/s for a second, and what it takes to stop
ODRIVE: dict[str, Value] = {
    "motor.controller": "odrive-0.6",
    "motor.watchdog": "yes",
    "motor.options.firmware": "0.6.10",
    "motor.options.watchdog_enable_endpoint": 188,
    "motor.options.watchdog_timeout_endpoint": 189,
    "motor.feedback_rate": 250.0,
    "motor.max_current": 30.0,
    "bus.bitrate": 1_000_000,
}
# What a person answers; how the robot really is: ids, and directions with the signs of gears.
ROBOTS: dict[str, tuple[dict[str, Value], dict[str, int], dict[str, int]]] = {
    "kiwi": (
        {
            **ODRIVE,
            **{"robot.kind": "omni", "robot.wheels": 3, "robot.reach": 0.15, "robot.radius": 0.05},
            **{"robot.body.mass": 9.0, "motor.gear_ratio": 5.0, "motor.max_torque": 12.0, "motor.max_speed": 30.0},
        },
        {"wheel_1": 5, "wheel_2": 1, "wheel_3": 9},
        {"wheel_1": -1, "wheel_2": -1, "wheel_3": -1},
    ),
    "mobyish": (
        {
            **ODRIVE,
            **{"robot.kind": "offset_differential", "robot.wheel_radius": 0.08, "robot.axle_offset": 0.2},
            **{"robot.track": 0.35, "robot.body.mass": 40.0, "robot.chassis_inertia": 0.9},
            **{"motor.gear_ratio": 12.0, "motor.max_torque": 25.0, "motor.max_speed": 30.0},
        },
        {"left": 2, "right": 1, "platform": 3},
        {"left": -1, "right": 1, "platform": -1},
    ),
    "rectangular": (
        {
            **{"robot.kind": "mecanum", "robot.wheelbase": 0.4, "robot.track": 0.36, "robot.radius": 0.0762},
            **{"robot.body.mass": 20.0, "motor.controller": "c620"},
        },
        {"front_left": 1, "rear_left": 3, "rear_right": 2, "front_right": 7},
        {"front_left": 1, "rear_left": 1, "rear_right": -1, "front_right": -1},
    ),
}


@pytest.mark.parametrize("name", ROBOTS)
def test_from_an_empty_file_to_a_driven_square(name: str) -> None:
    answers, ids, directions = ROBOTS[name]
    begun = robot_file(asking({**answers, "robot.name": name}))
    true = wronged(begun, ids, directions)
    assert begun != true
    found = driven(true, begun)
    assert found == true == by_hand(true, begun)
    world = World("moby", edit=lambda _: found)
    if "platform" in ids:
        world.run(0.3)
        world.cycle(requests=[Request(RequestKind.REFERENCE, 7, world.now_ns + world.period_ns, "platform", 0.0)])
    world.start()
    corners = []
    for vx, vy in ((SIDE, 0.0), (0.0, SIDE), (-SIDE, 0.0), (0.0, -SIDE)):
        world.run(1.5, Twist(vx, vy, 0.0), frame=TwistFrame.ODOM)
        world.run(1.5, Twist(0.0, 0.0, 0.0))
        corners.append(world.bus.robot.truth.pose)
    sides = [hypot(one.x - other.x, one.y - other.y) for one, other in pairwise(corners)]
    assert min(sides) > 0.5
    assert max(sides) - min(sides) < 0.05
    assert (corners[0].x > 0.5, corners[1].y > 0.5) == (True, True)
    assert hypot(corners[3].x, corners[3].y) < 0.05
    assert world.true_speed() < 0.01
