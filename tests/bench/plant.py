"""One substep of every plant of the registry, on the bundled robot of its kind: on good ground and on slippery one."""

import time

from gateway.config import load
from replay.sim.controllers.contract import STEP_S
from replay.sim.plants import PLANTS, plant_of
from replay.sim.plants.contract import Plant
from tests.world import NAMES, ROBOTS

STEPS = 2000
REPEATS = 9
SLIPPERY = 0.3


def measure() -> dict[str, float]:
    """Least mean time of a substep over repeats, us (a busy machine only adds), and how much faster than real time."""
    figures = {}
    for robot in (load(ROBOTS / f"{name}.toml")[0].robot for name in (*NAMES, "odd")):
        for plant in PLANTS[robot.kind]:
            name = f"{robot.name}_{plant.value}"
            figures[f"plant_step_us_{name}"] = cost = _microseconds(plant_of(robot, plant))
            slippery = plant_of(robot, plant)
            for wheel in slippery.wheels:
                slippery.set_friction(wheel, SLIPPERY)
            figures[f"plant_slippery_step_us_{name}"] = _microseconds(slippery)
            figures[f"plant_realtime_ratio_{name}"] = STEP_S * 1e6 / cost
    return figures


def _microseconds(plant: Plant) -> float:
    torques = [3.0, 5.0, -2.0, 1.0][: len(plant.angles)]
    least = float("inf")
    for _ in range(REPEATS):
        begin = time.process_time_ns()
        for _ in range(STEPS):
            plant.step(torques)
        least = min(least, (time.process_time_ns() - begin) / STEPS / 1000.0)
    return least
