"""What the pull region costs in every cycle: the drive law of moby with and without, and what limping takes.

How this works
--------------
The same setpoints and measurements of a lively pulled drive go to each of them in turn, a few cycles at a time, and of
each few the fastest of many runs counts: a busy machine makes some runs slower, and none faster.
"""

import time
from collections.abc import Callable, Sequence
from math import pi

from gateway.config import RobotConfig, parse
from gateway.control.drive_law import Measured
from gateway.control.offset_law import OffsetDifferentialLaw
from gateway.core.ability import Abilities
from gateway.core.assembly import build
from gateway.core.health import Health
from gateway.types import Trace, Twist
from tests.world import World

COMPENSATION = "[robot.compensation]\ngain = 2.0\nregion = 1.57\n\n[robot.body]"
LIMP = '[degraded]\nmotor_lost = "limp"\n\n[limits]'
TURNS = (Twist(0.0, 1.0, 0.0), Twist(0.2, 0.9, 0.3), Twist(-0.2, 0.9, -0.4), Twist(0.0, 1.2, 0.5))
STRETCH = 50  # cycles
REPEATS = 25
AGE_NS = 2_000_000

Call = Callable[[Measured, tuple[float, ...]], object]


def compensated(text: str) -> str:
    return text.replace("[robot.body]", COMPENSATION, 1)


def drive() -> tuple[RobotConfig, str, list[tuple[Measured, tuple[float, ...]]]]:
    """What the law of a pulled robot sees, always accelerating or turning."""
    world = World("moby", edit=compensated, joint_angles={"platform": pi / 2})
    world.start()
    begin = len(world.records)
    for index in range(8):
        world.run(0.5, TURNS[index % len(TURNS)])
    return world.config, world.text, [_seen(inputs.now_ns, out.trace) for inputs, out in world.records[begin:]]


def _seen(now_ns: int, trace: Trace) -> tuple[Measured, tuple[float, ...]]:
    speeds, positions, setpoint = trace.wheel_speeds, trace.wheel_positions, trace.setpoint
    nothing = (None,) * len(speeds)
    return Measured(now_ns, 0.004, speeds, positions, nothing, (AGE_NS,) * len(speeds), positions), tuple(setpoint)


def fastest(calls: Sequence[Call], seen: Sequence[tuple[Measured, tuple[float, ...]]]) -> list[float]:
    """us per cycle of each."""
    stretches = [seen[begin : begin + STRETCH] for begin in range(0, len(seen) - STRETCH + 1, STRETCH)]
    best = [[float("inf")] * len(stretches) for _ in calls]
    for _ in range(REPEATS):
        for place, stretch in enumerate(stretches):
            for call, times in zip(calls, best, strict=True):
                begin = time.process_time_ns()
                for measured, setpoint in stretch:
                    call(measured, setpoint)
                times[place] = min(times[place], float(time.process_time_ns() - begin))
    return [sum(times) / len(stretches) / STRETCH / 1000.0 for times in best]


def measure() -> dict[str, float]:
    """us per cycle: the law that corrects, the one that only looks, and the speeds alone, which every law has."""
    config, text, seen = drive()
    correcting = _law(config)
    looking = _law(parse(text.replace(COMPENSATION, "[robot.body]", 1), "moby"))
    speeds = looking._speeds
    with_it, looks, without = fastest(
        [
            lambda measured, setpoint: correcting.motion(setpoint, measured, braking=False),
            lambda measured, setpoint: looking.motion(setpoint, measured, braking=False),
            lambda measured, setpoint: speeds.motion(setpoint, measured, braking=False),
        ],
        seen,
    )
    well, limps = _abilities(parse(text.replace("[limits]", LIMP, 1), "moby"), seen)
    return {
        "speed_law_us": without,
        "pull_analysis_added_us": looks - without,
        "pull_added_us": with_it - without,
        "ability_us": well,
        "ability_limping_us": limps,
    }


def _law(config: RobotConfig) -> OffsetDifferentialLaw:
    law = build(config).law
    assert isinstance(law, OffsetDifferentialLaw)
    return law


def _abilities(config: RobotConfig, seen: Sequence[tuple[Measured, tuple[float, ...]]]) -> list[float]:
    """Of judging what is left, with every motor and without that of the platform."""
    robot = build(config)
    abilities = Abilities(config, robot)
    all_well, lost = (True,) * 3, (True, True, False)
    well, reduced = Health(all_well, all_well, all_well, ()), Health(lost, lost, all_well, ())
    moving = [
        (measured._replace(estimate=robot.kinematics.twist(measured.speeds, measured.angles)), setpoint)
        for measured, setpoint in seen
    ]
    assert abilities.of(reduced, moving[-1][0]) is not None
    return fastest(
        [lambda measured, _: abilities.of(well, measured), lambda measured, _: abilities.of(reduced, measured)], moving
    )
