"""Runs a scenario: a drive in virtual time, faster than real time and the same on every run.

How this works
--------------
Everything that is to happen waits in an agenda. Before a cycle, whatever is due by then happens at its own instant:
the world is run up to it. A fault that ends by itself puts its end into the agenda. A pause or a restart moves the
next cycle away, and what falls into it happens all the same.
"""

import heapq
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import NamedTuple, Protocol

from gateway import robot_files
from gateway.config import RobotConfig, load
from gateway.core.snapshot import State
from gateway.types import Event, Inputs, Mode, Outputs, Request, RequestKind, Twist, TwistCommand
from replay.drive.breaking import Breaking
from replay.drive.closed_loop import ClosedLoop
from replay.drive.commanders import Asked, Commanders
from replay.drive.expectations import verdicts, watchers
from replay.drive.faults import FaultKind
from replay.drive.moment import Moment
from replay.drive.scenario_file import At, Command, Fault, Scenario, check_names
from replay.sim.plants import plant_of

RESTART_S = 1.0  # from the death of the process to the first cycle of the next one; source: ours
_SECOND_NS = 1_000_000_000

Watch = Callable[[Moment], None]


class Recording(Protocol):
    """Takes every cycle of the drive; a restarted process begins a session of its own."""

    def put(self, inputs: Inputs, outputs: Outputs, state: Callable[[], State]) -> None: ...

    def restart(self) -> None: ...


class Given(NamedTuple):
    """Commands and requests of a recorded drive, received so many ns after its first cycle."""

    commands: tuple[TwistCommand, ...] = ()
    requests: tuple[Request, ...] = ()

    def commands_from(self, start_ns: int) -> list[TwistCommand]:
        """The same in a drive that begins then."""
        return [one._replace(received_ns=start_ns + one.received_ns) for one in self.commands]


class Result(NamedTuple):
    """What came of it. Times are s since the first cycle, `modes` the changes of mode, `broken` failed expectations."""

    robot: str
    cycles: int
    seconds: float
    modes: tuple[tuple[float, Mode], ...]
    events: tuple[tuple[float, Event], ...]
    max_true_speed: float  # m/s
    true_distance: float  # m
    broken: tuple[str, ...]

    def as_json(self, session: Path | None = None) -> dict[str, object]:
        """The documented keys of `--json`."""
        return {
            "robot": self.robot,
            "cycles": self.cycles,
            "modes": [[t, mode.value] for t, mode in self.modes],
            "events": [[t, event.level.value, event.code, event.text] for t, event in self.events],
            "max_true_speed": self.max_true_speed,
            "true_distance": self.true_distance,
            "session": None if session is None else str(session),
            "broken": list(self.broken),
        }


def run_scenario(
    scenario: Scenario,
    config: RobotConfig | None = None,
    *,
    watch: Watch | None = None,
    recording: Recording | None = None,
    given: Given | None = None,
) -> Result:
    """Drive it; `config` stands in for the robot that the scenario names. `watch` sees every cycle, in order.

    `given`: what was commanded and asked in a recorded drive, once more.

    Raises ConfigError when the scenario names what is not on this robot.
    """
    robot = load(robot_files.find_bundled(scenario.robot))[0] if config is None else config
    check_names(scenario, robot, "scenario")
    return _Drive(scenario, robot, watch, recording, given or Given()).run()


class _Drive:
    """State of one run."""

    def __init__(
        self,
        scenario: Scenario,
        config: RobotConfig,
        watch: Watch | None,
        recording: Recording | None,
        given: Given,
    ) -> None:
        self._seed = scenario.seed
        plant = plant_of(config.robot, scenario.plant)
        self._loop = ClosedLoop(config, joint_angles=scenario.start.joint, plant=plant)
        if scenario.start.swivel is not None:
            self._loop.bus.robot.set_swivel(scenario.start.swivel)
        self._breaking = Breaking(self._loop.bus, config)
        self._start_ns = self._loop.next_ns
        self._end_ns = self._start_ns + round(scenario.seconds * _SECOND_NS)
        self._commanders = Commanders(given.commands_from(self._start_ns))
        self._asked = Asked(config.commands.source)
        self._requests: list[Request] = []
        self._agenda: list[tuple[int, int, Callable[[int], None]]] = []
        self._planned = 0
        self._asked_for = 0  # the id of the last request
        self._watch = watch
        self._recording = recording
        self._summary = _Summary(config.robot.name)
        self._expectations = watchers(scenario)
        for request in given.requests:
            self._plan(self._start_ns + request.received_ns, partial(self._ask_again, request))
        for at in scenario.at:
            self._plan(self._start_ns + round(at.t * _SECOND_NS), self._action(at))

    def run(self) -> Result:
        """From the first cycle to the last."""
        self._loop.bus.advance(self._start_ns)
        finished = False
        while not finished:
            if self._agenda and self._agenda[0][0] <= self._loop.next_ns:
                due_ns, _, action = heapq.heappop(self._agenda)
                action(due_ns)
            elif self._loop.next_ns >= self._end_ns:
                break
            else:
                finished = self._cycle()
        return self._summary.result(verdicts(self._expectations))

    def _cycle(self) -> bool:
        """One cycle; whether an orderly shutdown came to its end in it."""
        now_ns = self._loop.next_ns
        requests, self._requests = self._requests, []
        inputs, outputs = self._loop.cycle(commands=self._commanders.drain(now_ns), requests=requests)
        moment = Moment(
            t=(now_ns - self._start_ns) / _SECOND_NS,
            inputs=inputs,
            outputs=outputs,
            truth=self._loop.bus.robot.truth,
            asked=self._asked.update(inputs.commands, now_ns),
        )
        self._summary.add(moment)
        for expectation in self._expectations:
            expectation.watch(moment)
        if self._recording is not None:
            self._recording.put(inputs, outputs, self._loop.engine.snapshot)
        if self._watch is not None:
            self._watch(moment)
        return outputs.finished

    # what happens

    def _plan(self, due_ns: int, action: Callable[[int], None]) -> None:
        self._planned += 1  # what is due at one instant happens in the order in which it was planned
        heapq.heappush(self._agenda, (due_ns, self._planned, action))

    def _action(self, at: At) -> Callable[[int], None]:
        if at.command is not None:
            return partial(self._command, at.command)
        if at.silence is not None:
            return partial(self._commanders.silence, at.silence)
        if at.set is not None:
            return partial(self._set, at.set)
        if at.fault is not None:
            return partial(self._pause if at.fault.kind is FaultKind.LOOP_PAUSE else self._break, at.fault)
        if at.request == "restart":
            return self._restart
        return partial(self._request, RequestKind(at.request), at.angle)

    def _command(self, command: Command, now_ns: int) -> None:
        twist = Twist(command.vx, command.vy, command.wz)
        self._commanders.stream(
            command.source,
            twist,
            rate=command.rate,
            stamped=command.stamped,
            sender=command.sender,
            now_ns=now_ns,
            region=command.region,
            width_rate=command.width_rate,
            width=command.width,
        )

    def _request(self, kind: RequestKind, angle: float | None, now_ns: int) -> None:
        reference = kind is RequestKind.REFERENCE
        stated = (angle or 0.0) if reference else None
        self._asked_for += 1
        self._requests.append(Request(kind, self._asked_for, now_ns, angle=stated))

    def _ask_again(self, request: Request, now_ns: int) -> None:
        self._asked_for += 1
        self._requests.append(request._replace(id=self._asked_for, received_ns=now_ns))

    def _set(self, values: Mapping[str, float], now_ns: int) -> None:
        for name, value in values.items():
            self._asked_for += 1
            self._requests.append(Request(RequestKind.SET, self._asked_for, now_ns, setting=name, value=value))

    def _restart(self, now_ns: int) -> None:
        alive_ns = now_ns + round(RESTART_S * _SECOND_NS)
        self._loop.restart(alive_ns)
        self._requests.clear()
        self._plan(alive_ns, self._come_alive)
        if self._recording is not None:
            self._recording.restart()

    def _come_alive(self, now_ns: int) -> None:
        """Only now somebody listens."""
        self._commanders.forget(now_ns)
        self._requests.clear()

    def _pause(self, fault: Fault, now_ns: int) -> None:
        self._commanders.freeze(now_ns)
        self._loop.pause(now_ns + round((fault.seconds or 0.0) * _SECOND_NS))

    def _break(self, fault: Fault, now_ns: int) -> None:
        names = self._breaking.begin(fault, now_ns, seed=self._seed + self._planned)
        if fault.seconds is not None:
            self._plan(now_ns + round(fault.seconds * _SECOND_NS), partial(self._breaking.end, fault, names))


class _Summary:
    """Collects what the result tells."""

    def __init__(self, robot: str) -> None:
        self._robot = robot
        self._cycles = 0
        self._t = 0.0
        self._modes: list[tuple[float, Mode]] = []
        self._events: list[tuple[float, Event]] = []
        self._fastest = 0.0
        self._way = 0.0
        self._place: tuple[float, float] | None = None

    def add(self, moment: Moment) -> None:
        """One cycle."""
        mode, pose = moment.outputs.mode, moment.truth.pose
        self._cycles += 1
        self._t = moment.t
        if not self._modes or self._modes[-1][1] is not mode:
            self._modes.append((moment.t, mode))
        self._events += [(moment.t, event) for event in moment.outputs.events]
        self._fastest = max(self._fastest, moment.speed)
        if self._place is not None:
            self._way += ((pose.x - self._place[0]) ** 2 + (pose.y - self._place[1]) ** 2) ** 0.5
        self._place = (pose.x, pose.y)

    def result(self, broken: tuple[str, ...]) -> Result:
        """All of it."""
        return Result(
            robot=self._robot,
            cycles=self._cycles,
            seconds=self._t,
            modes=tuple(self._modes),
            events=tuple(self._events),
            max_true_speed=self._fastest,
            true_distance=self._way,
            broken=broken,
        )
