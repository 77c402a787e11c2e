"""Short recorded drives to be driven once more, and robot files with two buses."""

from collections.abc import Callable
from pathlib import Path

from gateway.types import ZERO_TWIST, Mode, RequestKind, Twist
from replay.sessions.reader import Session, open_session
from tests.recordings import write_drive
from tests.world import World

SECOND_BUS = '[[bus]]\nname = "rear"\ninterface = "socketcan"\nchannel = "can1"\nbitrate = 1_000_000\n\n'


def on_two_buses(text: str) -> str:
    """The same robot with the second half of its motors, and its sensors, on a bus of their own: front and rear."""
    text = text.replace('name = "can0"', 'name = "front"').replace('bus = "can0"', 'bus = "front"')
    head, *motors = text.split("[[motor]]")
    half = len(motors) // 2
    rear = [motor.replace('bus = "front"', 'bus = "rear"') for motor in motors[half:]]
    return "[[motor]]".join([head + SECOND_BUS, *motors[:half], *rear])


def short_drive(
    name: str, directory: Path, *, edit: Callable[[str], str] = str, rate_hz: float = 250.0, pace: float = 1.0
) -> Session:
    """Out, a stop by emergency and its release, on, and to rest; some six seconds. `pace`: of its speeds."""
    world = World(name, rate_hz=rate_hz, edit=edit)
    top = world.config.limits.velocity.as_twist()
    move = Twist(0.4 * pace * top.vx, 0.2 * pace * top.vy, 0.3 * pace * top.wz)
    balances = getattr(world.config.robot, "balance", None) is not None
    world.start()
    world.run(1.2, move)
    if not balances:  # it would fall
        world.request(RequestKind.ESTOP)
        world.run(2.0)
        reply = world.request(RequestKind.RESET)
        assert reply is not None
        assert reply.ok, reply.reason
        world.run(0.4)
        world.run(0.4, ZERO_TWIST)
        world.run(0.8, move)
    world.run(1.0, ZERO_TWIST)
    world.run(1.5, until=lambda outputs: outputs.mode is Mode.IDLE)
    return open_session(write_drive(directory, world))
