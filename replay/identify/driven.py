"""A recorded drive once more in virtual time: the same commands and requests, the engine as it is here, a robot with
parameters of our choice. Closed loop: what is measured follows from what is commanded.

How this works
--------------
The loop keeps the grid of its period, from the first recorded cycle on. What sensors told over Zenoh is not given
again: it belongs to the way that was driven then. The controllers are those that were commissioned on the robot of the
recorded robot file, whatever the parameters are now.
"""

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from gateway.config import RobotConfig, parse
from gateway.types import Inputs, Outputs, Request, RequestKind, TwistCommand
from replay.compare.what_if import OURS, WhatIfError
from replay.drive.closed_loop import ClosedLoop
from replay.drive.commanders import Commanders
from replay.identify.parameters import RobotSection, values_of, with_values
from replay.sessions.reader import Session, SessionError
from replay.sim.plants import plant_of
from replay.sim.plants.contract import Plant, PlantName


class Drive(NamedTuple):
    """What a session gives: its robot, what was commanded and asked, and for how many cycles. `sensed`: over Zenoh."""

    name: str
    config: RobotConfig
    first_ns: int
    cycles: int
    commands: tuple[TwistCommand, ...]
    requests: tuple[Request, ...]
    sensed: bool
    plant: PlantName | None  # as the session tells; None: a real robot, or one that nobody knows here


class Change(NamedTuple):
    """What is to be otherwise: settings, from so many s since the first cycle on, or another robot file."""

    settings: Mapping[str, float] = {}
    begin: float = 0.0
    config: RobotConfig | None = None


def recorded(session: Session) -> Drive:
    """Raises SessionError, ConfigError."""
    commands: list[TwistCommand] = []
    requests: list[Request] = []
    first: Inputs | None = None
    cycles, sensed = 0, False
    for inputs, _ in session.cycles():
        first = first or inputs
        cycles += 1
        commands += inputs.commands
        requests += inputs.requests
        sensed = sensed or bool(inputs.samples)
    if first is None:
        raise SessionError(f"{session.path}: it has no cycles")
    if first.cycle != 0:
        raise SessionError(f"{session.path}: its beginning was not recorded, so nobody knows how it stood then")
    told = session.header.plant
    return Drive(
        session.path.name,
        parse(session.config_text, f"robot file of {session.path}"),
        first.now_ns,
        cycles,
        tuple(sorted(commands, key=lambda one: one.received_ns)),
        tuple(sorted(requests, key=lambda one: one.received_ns)),
        sensed,
        PlantName(told) if told in {one.value for one in PlantName} else None,
    )


def driven(
    drive: Drive,
    plant: Plant,
    *,
    torque_scale: float = 1.0,
    angles: Mapping[str, float] | None = None,
    change: Change | None = None,
) -> Iterator[tuple[Inputs, Outputs]]:
    """Every cycle. `torque_scale`: what acts of the torque that a motor tells; `angles`: of the joints at the start.

    Raises ConfigError, and WhatIfError for a setting that the robot refuses.
    """
    what = change or Change()
    loop = ClosedLoop(
        what.config or drive.config,
        first_ns=drive.first_ns,
        joint_angles=angles,
        plant=plant,
        commissioned=commissioned(drive),
    )
    for motor in drive.config.robot.motor_names():
        if torque_scale != 1.0:
            loop.bus.robot.drivetrain(motor).gain = torque_scale
    commanders, waiting = Commanders(drive.commands), deque(_asked(drive, what))
    end_ns = drive.first_ns + round(drive.cycles * 1e9 / drive.config.loop.rate)
    while loop.next_ns < end_ns:
        now_ns = loop.next_ns
        due = []
        while waiting and waiting[0].received_ns <= now_ns:
            due.append(waiting.popleft())
        inputs, outputs = loop.cycle(commands=commanders.drain(now_ns), requests=due)
        refused = [str(reply.reason) for reply in outputs.replies if reply.id >= OURS and not reply.ok]
        if refused:
            raise WhatIfError("; ".join(refused))
        yield inputs, outputs


def commissioned(drive: Drive) -> tuple[float, ...]:
    """kg m^2 at each joint, of the recorded robot file."""
    return plant_of(drive.config.robot, drive.plant or PlantName.SIMPLE).reflected_inertia


def plant_with(robot: RobotSection, name: PlantName, values: Mapping[str, float]) -> Plant:
    """The plant of a robot with these parameters. Raises ValueError where there is none."""
    return plant_of(with_values(robot, values), name)


def values_for(values: Mapping[str, float], drive: Drive, other: RobotConfig | None) -> dict[str, float]:
    """Parameters as identified, but where another robot file says otherwise than the recorded one: what it says."""
    if other is None:
        return dict(values)
    before, after = values_of(drive.config.robot), values_of(other.robot)
    return {name: after[name] if after.get(name) != before.get(name) else values[name] for name in after}


def _asked(drive: Drive, change: Change) -> Sequence[Request]:
    """The recorded requests and ours, in order."""
    at_ns = drive.first_ns + round(change.begin * 1e9)
    ours = [
        Request(RequestKind.SET, OURS + place, at_ns, setting=name, value=value)
        for place, (name, value) in enumerate(change.settings.items())
    ]
    return sorted([*drive.requests, *ours], key=lambda one: one.received_ns)
