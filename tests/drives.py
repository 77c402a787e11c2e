"""A synthetic drive: what a service would record, without a service. For tests of recording and for pictures."""

from collections.abc import Iterator
from math import cos, pi, sin

from drivers.contract import CanFrame
from gateway.recording.packets import Record
from gateway.types import (
    CycleTiming,
    Event,
    Inputs,
    Level,
    Mode,
    Odometry,
    Outputs,
    Pose,
    Trace,
    Twist,
    TwistCommand,
    TwistFrame,
)

START_NS = 5_000_000_000
WALL_NS = 1_790_000_000_000_000_000


def drive(cycles: int, *, rate: float = 250.0, received: int = 6, sent: int = 3, first: int = 0) -> Iterator[Record]:
    """An offset robot (MOBY) on a figure of eight: it looks ahead while its chassis turns beneath it."""
    world = _World(1.0 / rate)
    for cycle in range(first + cycles):
        world.advance()
        if cycle >= first:
            yield _record(cycle, world, period_ns=round(1e9 / rate), received=received, sent=sent)


class _World:
    """Ideal motion of the offset robot: wheel radius 0.1 m, offset 0.25 m, track 0.4 m."""

    def __init__(self, dt: float) -> None:
        self.time = 0.0
        self.pose = Pose(0.0, 0.0, 0.0)
        self.twist = Twist(0.0, 0.0, 0.0)
        self.positions = (0.0, 0.0, 0.0)
        self.speeds = (0.0, 0.0, 0.0)
        self._dt = dt

    def advance(self) -> None:
        self.time += self._dt
        ramp = min(max(self.time - 1.0, 0.0), 1.0)
        self.twist = Twist(0.6 * ramp * cos(0.8 * self.time), 0.5 * ramp * sin(0.4 * self.time), 0.15 * ramp)
        heading = -self.positions[2]  # of the chassis in the platform's frame
        along = self.twist.vx * cos(heading) + self.twist.vy * sin(heading)
        turning = (self.twist.vy * cos(heading) - self.twist.vx * sin(heading)) / 0.25
        self.speeds = (
            (along - 0.2 * turning) / 0.1,
            (along + 0.2 * turning) / 0.1,
            self.twist.wz - turning,
        )
        left, right, joint = (p + s * self._dt for p, s in zip(self.positions, self.speeds, strict=True))
        self.positions = (left, right, joint)
        x, y, theta = self.pose
        self.pose = Pose(
            x + self._dt * (self.twist.vx * cos(theta) - self.twist.vy * sin(theta)),
            y + self._dt * (self.twist.vx * sin(theta) + self.twist.vy * cos(theta)),
            (theta + self._dt * self.twist.wz + pi) % (2 * pi) - pi,
        )


def _record(cycle: int, world: _World, *, period_ns: int, received: int, sent: int) -> Record:
    now_ns = START_NS + cycle * period_ns
    inputs = Inputs(
        cycle=cycle,
        now_ns=now_ns,
        frames=tuple(
            CanFrame("can0", 0x20 + place, _bytes(cycle, place), received_ns=now_ns - 1000 * (received - place))
            for place in range(received)
        ),
        commands=(TwistCommand("teleop", world.twist, TwistFrame.BODY, cycle, now_ns - 5000),) * (cycle % 5 == 0),
    )
    mode = _mode(world.time)
    changed = mode is not _mode(world.time - period_ns * 1e-9)
    outputs = Outputs(
        frames=tuple(CanFrame("can0", 0x2D + 0x20 * place, _bytes(cycle, place + 9)) for place in range(sent)),
        mode=mode,
        events=(Event(Level.INFO, "mode", f"the mode is {mode.value}"),) * changed,
        replies=(),
        odometry=Odometry(world.pose, world.twist, (1e-4 * world.time,) * 9, 0.002) if cycle % 5 == 0 else None,
        status=None,
        trace=_trace(world),
        finished=False,
    )
    late_ns = 60_000 + (cycle * 7919) % 90_000
    return Record(inputs, outputs, CycleTiming(late_ns, 900_000 + (cycle * 104_729) % 300_000, WALL_NS + now_ns))


def _mode(time: float) -> Mode:
    if time < 0.5:
        return Mode.IDLE
    return Mode.STARTING if time < 1.0 else Mode.DRIVE


def _trace(world: _World) -> Trace:
    lag = 0.04 * sin(40.0 * world.time)
    return Trace(
        target=world.twist,
        setpoint=world.twist,
        measured=Twist(world.twist.vx * (1 + lag), world.twist.vy * (1 - lag), world.twist.wz),
        pose=world.pose,
        wheel_setpoints=world.speeds,
        wheel_speeds=(world.speeds[0] * (1 + lag), world.speeds[1] * (1 - lag), world.speeds[2]),
        wheel_positions=world.positions,
        winner_age_s=0.02 + 0.01 * sin(world.time),
        residual=abs(lag) * 0.05,
        residuals=None,
    )


def _bytes(cycle: int, place: int) -> bytes:
    """Eight bytes of which some change fast and some hardly, as on a real bus."""
    return (cycle * 2654435761 + place * 40503).to_bytes(8, "little")
