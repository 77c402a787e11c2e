"""Cost of one cycle of the core: 4 motors, 8 received frames, against the time one frame takes on the wire."""

import statistics
import time

from gateway.config import RobotConfig
from gateway.engine import Engine
from gateway.types import Inputs, Twist
from tests.world import World, robot_file

RATE_HZ = 500.0  # at which four C620 at 1 kHz deliver eight frames per cycle
SECONDS = 8.0
REPEATS = 7
WIRE_US = 130.0  # one 8-byte frame at 1 Mbit/s


def at_rate(config: RobotConfig, rate_hz: float) -> RobotConfig:
    return config.model_copy(update={"loop": config.loop.model_copy(update={"rate": rate_hz})})


def drive(config: RobotConfig, seconds: float) -> list[Inputs]:
    """Inputs of a lively drive: always accelerating or turning, so that no cheap path is taken for long."""
    world = World(config.robot.name, config)
    world.start()
    turns = [Twist(0.8, 0.0, 0.5), Twist(0.0, 0.6, -0.5), Twist(-0.5, 0.3, 0.0), Twist(0.2, -0.6, 1.0)]
    for index in range(int(seconds / 0.5)):
        world.run(0.5, turns[index % len(turns)])
    return [inputs for inputs, _ in world.records]


def measure() -> dict[str, float]:
    """Median over repeats of the mean time of a step, in microseconds, and as a share of one frame on the wire."""
    config = at_rate(robot_file("omni4"), RATE_HZ)
    inputs = drive(config, SECONDS)
    times = []
    for _ in range(REPEATS):
        engine = Engine(config)
        begin = time.perf_counter_ns()
        for one in inputs:
            engine.step(one)
        times.append((time.perf_counter_ns() - begin) / len(inputs) / 1000.0)
    cost = statistics.median(times)
    frames = sum(len(one.frames) for one in inputs) / len(inputs)
    return {"cycle_us": cost, "cycle_frames": frames, "cycle_per_wire_frame": cost / WIRE_US}
