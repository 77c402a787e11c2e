"""Faults put into a recorded drive: what was commanded and asked then, once more, in a simulated world that breaks.

How this works
--------------
A script is the `[[at]]` of a scenario, in time since the first recorded cycle; robot and length are those of the
session. The engine runs closed loop on the simulated robot, so the drive goes another way as soon as something breaks,
and every cycle is held against the laws of motion (`replay.inject.laws`). What sensors told over Zenoh is not given
again: it belongs to the way that was driven then.
"""

from typing import NamedTuple

from gateway.config import ConfigError, RobotConfig, parse
from gateway.types import Request, RequestKind, TwistCommand
from replay.drive.moment import Moment
from replay.drive.scenario import Given, Recording, Result, Watch, run_scenario
from replay.drive.scenario_file import MAX_SECONDS, Scenario, check_names
from replay.drive.script import Script
from replay.inject import laws
from replay.sessions.reader import Session, SessionError
from replay.sim.plants.contract import PlantName


class Recorded(NamedTuple):
    """What a session gives: its robot, what was commanded and asked, how long it was, and by what it moved."""

    name: str
    text: str  # of the robot file
    config: RobotConfig
    given: Given
    seconds: float
    plant: PlantName


class Injected(NamedTuple):
    """What came of it: the drive, and what broke each law, in words."""

    result: Result
    violations: dict[str, list[str]]

    @property
    def broken(self) -> list[str]:
        """The first violation of each law that was broken."""
        return [f"{law}: {found[0]}" for law, found in self.violations.items() if found]

    def as_json(self) -> dict[str, object]:
        """The documented keys of `--json`."""
        laws_broken = {law: len(found) for law, found in self.violations.items() if found}
        return self.result.as_json() | {"laws_broken": laws_broken, "broken": self.broken}


def recorded(session: Session) -> Recorded:
    """All that was asked of the robot. Raises SessionError, ConfigError."""
    config = parse(session.config_text, f"robot file of {session.path}")
    commands: list[TwistCommand] = []
    requests: list[Request] = []
    first_ns = last_ns = None
    for inputs, _ in session.cycles():
        first_ns = inputs.now_ns if first_ns is None else first_ns
        last_ns = inputs.now_ns
        commands += [one._replace(received_ns=max(one.received_ns - first_ns, 0)) for one in inputs.commands]
        requests += [
            one._replace(received_ns=max(one.received_ns - first_ns, 0))
            for one in inputs.requests
            if one.kind is not RequestKind.SHUTDOWN
        ]
    if first_ns is None or last_ns is None:
        raise SessionError(f"{session.path}: it has no cycles")
    plant = session.header.plant
    known = [name.value for name in PlantName]
    return Recorded(
        session.path.name,
        session.config_text,
        config,
        Given(tuple(sorted(commands, key=lambda one: one.received_ns)), tuple(requests)),
        min((last_ns - first_ns) * 1e-9 + 1.0 / config.loop.rate, MAX_SECONDS),
        PlantName(plant) if plant in known else PlantName.SIMPLE,
    )


def inject(
    drive: Recorded, script: Script, *, watch: Watch | None = None, recording: Recording | None = None
) -> Injected:
    """Drive it once more with all that. Raises ConfigError for what is not on this robot or beyond the drive's end."""
    late = [f"at t = {at.t:g}: the session is {drive.seconds:.3f} s long" for at in script.at if at.t > drive.seconds]
    if late:
        raise ConfigError("script", late)
    return run(drive, scenario_of(drive, script), watch=watch, recording=recording)


def scenario_of(drive: Recorded, script: Script) -> Scenario:
    """The same as a scenario, to which the recorded commands come."""
    return Scenario(
        robot=drive.config.robot.name, seconds=drive.seconds, seed=script.seed, plant=drive.plant, at=script.at
    )


def run(
    drive: Recorded, scenario: Scenario, *, watch: Watch | None = None, recording: Recording | None = None
) -> Injected:
    """A scenario beside the recorded commands, held against the laws. Raises ConfigError."""
    check_names(scenario, drive.config, "script")
    moments: list[Moment] = []

    def seen(moment: Moment) -> None:
        moments.append(moment)
        if watch is not None:
            watch(moment)

    result = run_scenario(scenario, drive.config, watch=seen, recording=recording, given=drive.given)
    return Injected(result, laws.violations(moments, drive.config, can_brake=False))
