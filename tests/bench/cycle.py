"""Cost of one cycle of the core: 4 motors, 8 received frames, against the time one frame takes on the wire."""

import gc
import time
from math import inf

from gateway.core.engine import Engine
from gateway.types import Inputs, Twist
from tests.world import World

RATE_HZ = 500.0  # at which four C620 at 1 kHz deliver eight frames per cycle
SECONDS = 8.0
REPEATS = 10
STRETCH = 50  # cycles
WIRE_US = 130.0  # one 8-byte frame at 1 Mbit/s


def drive(world: World, seconds: float) -> list[Inputs]:
    """Inputs of a lively drive: always accelerating or turning, so that no cheap path is taken for long."""
    world.start()
    turns = [Twist(0.8, 0.0, 0.5), Twist(0.0, 0.6, -0.5), Twist(-0.5, 0.3, 0.0), Twist(0.2, -0.6, 1.0)]
    for index in range(int(seconds / 0.5)):
        world.run(0.5, turns[index % len(turns)])
    return [inputs for inputs, _ in world.records]


def measure() -> dict[str, float]:
    """The processor's time for a step, us, and as a share of one frame on the wire.

    A few cycles at a time; of each few the fastest of some runs counts: a busy machine only adds.
    """
    world = World("omni4", rate_hz=RATE_HZ)
    inputs = drive(world, SECONDS)
    stretches = [inputs[begin : begin + STRETCH] for begin in range(0, len(inputs) - STRETCH + 1, STRETCH)]
    best = [inf] * len(stretches)
    gc.freeze()
    for _ in range(REPEATS):
        engine = Engine(world.config)
        for place, stretch in enumerate(stretches):
            begin = time.process_time_ns()
            for one in stretch:
                engine.step(one)
            best[place] = min(best[place], float(time.process_time_ns() - begin))
    gc.unfreeze()
    cost = sum(best) / len(stretches) / STRETCH / 1000.0
    frames = sum(len(one.frames) for one in inputs) / len(inputs)
    return {"cycle_us": cost, "cycle_frames": frames, "cycle_per_wire_frame": cost / WIRE_US}
