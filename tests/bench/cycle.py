"""Cost of one cycle of the core: 4 motors, 8 received frames, against the time one frame takes on the wire."""

import statistics
import time

from gateway.core.engine import Engine
from gateway.types import Inputs, Twist
from tests.world import World

RATE_HZ = 500.0  # at which four C620 at 1 kHz deliver eight frames per cycle
SECONDS = 8.0
REPEATS = 7
WIRE_US = 130.0  # one 8-byte frame at 1 Mbit/s


def drive(world: World, seconds: float) -> list[Inputs]:
    """Inputs of a lively drive: always accelerating or turning, so that no cheap path is taken for long."""
    world.start()
    turns = [Twist(0.8, 0.0, 0.5), Twist(0.0, 0.6, -0.5), Twist(-0.5, 0.3, 0.0), Twist(0.2, -0.6, 1.0)]
    for index in range(int(seconds / 0.5)):
        world.run(0.5, turns[index % len(turns)])
    return [inputs for inputs, _ in world.records]


def measure() -> dict[str, float]:
    """Median over repeats of the mean time of a step, in microseconds, and as a share of one frame on the wire."""
    world = World("omni4", rate_hz=RATE_HZ)
    inputs = drive(world, SECONDS)
    times = []
    for _ in range(REPEATS):
        engine = Engine(world.config)
        begin = time.perf_counter_ns()
        for one in inputs:
            engine.step(one)
        times.append((time.perf_counter_ns() - begin) / len(inputs) / 1000.0)
    cost = statistics.median(times)
    frames = sum(len(one.frames) for one in inputs) / len(inputs)
    return {"cycle_us": cost, "cycle_frames": frames, "cycle_per_wire_frame": cost / WIRE_US}
