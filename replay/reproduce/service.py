"""A drive through the real service path in virtual time: command, engine, CAN, simulated controller, plant; recorded.

The commands of an experiment are velocities, over the floor unless they say otherwise, streamed once a cycle as a
client would, as the first source of the robot file and zero first. Time counts from the first of them that is not the
zero which starts the robot.
"""

from collections.abc import Callable, Mapping
from math import cos, sin
from pathlib import Path
from typing import NamedTuple

from gateway.core.examination import examine
from gateway.types import Event, Mode, Outputs, Pose, Request, RequestKind, Twist, TwistCommand, TwistFrame
from replay.drive.closed_loop import ClosedLoop
from replay.drive.recording import SessionRecording
from replay.reproduce.result import ReproduceError, Stage
from replay.reproduce.robot import ORIGIN, Setup, plant_of, robot_file
from replay.sim.plants.contract import PlantName
from replay.sim.plants.offset_caster import OffsetCaster

_SENDER = "experiment"
_PATIENCE = 8.0  # s, for the robot to start
_SETTLING = 2.0  # s


class Order(NamedTuple):
    """What is sent in a cycle: m/s, rad/s of the path if it is told, settings to be changed, rad/s.

    `width_rate`: m/s by which wheels go apart, of a robot whose wheels do; `width`: m to keep instead.
    """

    vx: float
    vy: float
    path_rate: float | None = None
    settings: Mapping[str, float] = {}
    wz: float = 0.0
    frame: TwistFrame = TwistFrame.ODOM
    width_rate: float | None = None
    width: float | None = None


Wanted = Callable[[float, Pose], Order]  # at a time, s, where the odometry tells the robot to be
Disturb = Callable[[float, OffsetCaster], None]  # what else happens before a cycle at this time, s


class Sample(NamedTuple):
    """At the start of a cycle: what really is (m, rad, m/s, N m, rad/s), and what the core says of it."""

    t: float
    x: float
    y: float
    heading: float  # of the platform
    chassis: float
    vx: float  # over the floor
    vy: float
    wz: float
    rates: tuple[float, ...]  # of the joints
    torques: tuple[float, ...]
    swivel: float | None  # of the caster, where there is one
    error: float | None  # of gamma from its goal
    correction: float | None
    mode: Mode
    limits: tuple[str, ...]


class Driven(NamedTuple):
    """Every cycle from the first order, what the service told, and where the drive is recorded."""

    samples: list[Sample]
    events: tuple[Event, ...]
    session: Path


def drive(
    setup: Setup,
    wanted: Wanted,
    stage: Stage,
    *,
    seconds: float,
    heading: float,
    swivel: float,
    disturb: Disturb = lambda t, plant: None,
) -> Driven:
    """`wanted`: what is sent; `heading`, `swivel`: of chassis and caster at the start, rad.

    Raises ReproduceError where the robot does not start.
    """
    config, text = robot_file(setup)
    plant = plant_of(config, swivel=swivel)
    loop = ClosedLoop(config, joint_angles={"platform": -heading}, plant=plant)
    return drive_in(
        loop,
        text,
        PlantName.DYNAMICS,
        wanted,
        stage,
        seconds=seconds,
        disturb=lambda t: disturb(t, plant),
        swivel=lambda: plant.swivel,
    )


def drive_in(
    loop: ClosedLoop,
    text: str,
    plant: PlantName,
    wanted: Wanted,
    stage: Stage,
    *,
    seconds: float,
    disturb: Callable[[float], None] = lambda t: None,
    swivel: Callable[[], float | None] = lambda: None,
) -> Driven:
    """The same in a loop that somebody else made.

    `text`: of its robot file; `plant`: by what its robot moves; `swivel`: tells that of the caster.
    """
    examine(loop.config, ORIGIN)
    recording = SessionRecording(
        loop.config, text, ORIGIN, directory=stage.folder, started_wall_ns=stage.started_wall_ns, plant=plant
    )
    drive_ = _Drive(loop, recording, swivel)
    try:
        samples = drive_.run(wanted, seconds, disturb)
    finally:
        recording.close()
    return Driven(samples, tuple(drive_.events), recording.session)


class _Drive:
    def __init__(self, loop: ClosedLoop, recording: SessionRecording, swivel: Callable[[], float | None]) -> None:
        self.events: list[Event] = []
        self._loop = loop
        self._recording = recording
        self._swivel = swivel
        self._source = loop.config.commands.source[0].name
        self._asked = 0  # the id of the last request
        self._pose = Pose(0.0, 0.0, 0.0)

    def run(self, wanted: Wanted, seconds: float, disturb: Callable[[float], None]) -> list[Sample]:
        """Started, driven, and brought to rest."""
        self._start()
        samples, period = list[Sample](), self._loop.period_ns / 1e9
        for cycle in range(round(seconds / period) + 1):
            t = cycle * period
            disturb(t)
            samples.append(self._sample(t, self._cycle(wanted(t, self._pose))))
        for _ in range(round(0.5 / period)):
            self._cycle(Order(0.0, 0.0))
        return samples

    def _start(self) -> None:
        balances = getattr(self._loop.config.robot, "balance", None) is not None
        for _ in range(round(_PATIENCE * 1e9 / self._loop.period_ns)):
            if self._cycle(Order(0.0, 0.0), stand_up=balances).mode is Mode.DRIVE:
                return self._settle() if balances else None
        raise ReproduceError(f"the robot does not start: {self._loop.engine.mode.value}")

    def _settle(self) -> None:
        """A robot that has just stood up comes to stand still."""
        for _ in range(round(_SETTLING * 1e9 / self._loop.period_ns)):
            self._cycle(Order(0.0, 0.0))

    def _cycle(self, order: Order, *, stand_up: bool = False) -> Outputs:
        now_ns = self._loop.next_ns
        twist = Twist(order.vx, order.vy, order.wz)
        command = TwistCommand(
            self._source,
            twist,
            order.frame,
            None,
            now_ns,
            _SENDER,
            width_rate=order.width_rate,
            width=order.width,
            path_rate=order.path_rate,
        )
        requests = self._requests(order.settings, now_ns)
        if stand_up:
            self._asked += 1
            requests.append(Request(RequestKind.STAND_UP, self._asked, now_ns))
        inputs, outputs = self._loop.cycle(commands=[command], requests=requests)
        self._recording.put(inputs, outputs, self._loop.engine.snapshot)
        self.events += outputs.events
        if outputs.odometry is not None:
            self._pose = outputs.odometry.pose
        return outputs

    def _requests(self, settings: Mapping[str, float], now_ns: int) -> list[Request]:
        found = []
        for name, value in settings.items():
            self._asked += 1
            found.append(Request(RequestKind.SET, self._asked, now_ns, setting=name, value=value))
        return found

    def _sample(self, t: float, outputs: Outputs) -> Sample:
        truth, told = self._loop.bus.robot.truth, outputs.trace.chassis
        vx, vy = _over_the_floor(truth.twist, truth.pose.theta)
        swivel = self._swivel()
        pulled = told if swivel is not None else None  # what the chassis tells of itself is of gamma there alone
        return Sample(
            t=t,
            x=truth.pose.x,
            y=truth.pose.y,
            heading=truth.pose.theta,
            chassis=truth.chassis_angle,
            vx=vx,
            vy=vy,
            wz=truth.twist.wz,
            rates=truth.joint_rates,
            torques=truth.joint_torques,
            swivel=swivel,
            error=pulled[2] if pulled else None,
            correction=pulled[3] if pulled else None,
            mode=outputs.mode,
            limits=() if outputs.status is None else tuple(outputs.status.limits_active),
        )


def _over_the_floor(twist: Twist, heading: float) -> tuple[float, float]:
    c, s = cos(heading), sin(heading)
    return c * twist.vx - s * twist.vy, s * twist.vx + c * twist.vy
