"""One drive of each bundled robot that passes through all of the core's arithmetic, as a session and pickled."""

from pathlib import Path

from gateway.types import RequestKind, Twist, TwistFrame
from replay.drive.faults import FaultKind, begin
from tests.equality import judge
from tests.recordings import write_drive
from tests.world import World


def record(name: str, directory: Path) -> Path:
    """The session of a drive of this robot; beside it, in `directory`, what `judge` takes."""
    world = World(name)
    lively_drive(world)
    (directory / f"{name}{judge.ROBOT}").write_text(world.text, encoding="utf-8")
    (directory / f"{name}{judge.DRIVE}").write_bytes(judge.packed(world.records))
    return write_drive(directory / "sessions", world)


def lively_drive(world: World) -> None:
    """Turning all the while; in both frames; at the limits; with a wheel unheard, a broken motor and a quick stop."""
    top = world.config.limits.velocity.as_twist()
    first = world.config.robot.motor_names()[0]
    world.start()
    world.run(1.5, Twist(0.5 * top.vx, -0.3 * top.vy, 0.7 * top.wz), frame=TwistFrame.ODOM)
    world.run(1.5, Twist(-top.vx, top.vy, top.wz))
    begin(FaultKind.FRAMES_LOST, world.bus, ["can0"], 0.3, seed=1, lasting=False)
    world.run(0.6, Twist(0.3 * top.vx, 0.6 * top.vy, -0.5 * top.wz), frame=TwistFrame.ODOM, stamped=True)
    begin(FaultKind.CLEAR, world.bus, [first], None, seed=1, lasting=False)
    world.run(0.4, Twist(0.4 * top.vx, 0.0, -0.9 * top.wz))
    world.request(RequestKind.ESTOP)
    world.run(1.5)
    world.request(RequestKind.RESET)
    world.run(1.0, Twist(0.0, 0.0, 0.0))
    begin(FaultKind.CABLE_OUT, world.bus, [first], None, seed=1, lasting=False)
    world.run(1.0, Twist(0.2 * top.vx, 0.2 * top.vy, 0.3 * top.wz))
    world.run(1.0)
