"""Random commands to a healthy robot on good ground, and whether anything is taken for slip."""

from random import Random
from typing import NamedTuple

from gateway.types import Outputs, Twist
from tests.world import World

SHORTEST, LONGEST = -1.3, 0.4  # powers of ten of seconds between commands: 50 ms to 2.5 s


class Clean(NamedTuple):
    """Cycles driven, slips that were told, and cycles in which slip was suspected."""

    cycles: int
    told: int
    suspected: int


def clean_drive(name: str, *, seed: int, seconds: float) -> Clean:
    """Of one robot, beyond its limits at times, and often one axis alone."""
    chance, world = Random(seed), World(name)
    world.start()
    top = world.config.limits.velocity.as_twist()
    cycles = suspected = 0

    def watch(outputs: Outputs) -> bool:
        nonlocal cycles, suspected
        cycles += 1
        slip = world.engine._slip
        suspected += slip is not None and slip.suspects
        return False

    t = 0.0
    while t < seconds:
        twist = Twist(*[chance.uniform(-1.3, 1.3) * limit * (chance.random() < 0.7) for limit in top])
        step = 10 ** chance.uniform(SHORTEST, LONGEST)
        world.run(step, twist, until=watch)
        world.records.clear()
        t += step
    return Clean(cycles, world.codes().count("slip"), suspected)
