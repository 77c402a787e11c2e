"""Drives to identify parameters from, and to ask what if: random twists, on our plants with noise and on MuJoCo's."""

from collections.abc import Callable, Sequence
from math import cos, sin
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

from gateway.chassis.omni import OmniRobot
from gateway.config import RobotConfig, parse
from gateway.types import ZERO_TWIST, Inputs, Outputs, Request, RequestKind, Twist, TwistCommand, TwistFrame
from replay.drive.closed_loop import ClosedLoop
from replay.drive.recording import SessionRecording
from replay.identify.parameters import with_values
from replay.sim.plants import plant_of
from replay.sim.plants.contract import Plant, PlantName
from tests.replay.mujoco_plant import MujocoPlant, omni
from tests.world import robot_text

WALL_NS = 1_790_000_000_000_000_000
READY_S = 1.0
CHANGE_S = 1.0  # between two twists
TURN_S = 2.0
STOP_S = 1.5  # at the end, in which it comes to rest
UNCOMPENSATED = "# [robot.compensation]\n# gain = 2.0\n# region = 1.57"
COMPENSATED = "[robot.compensation]\ngain = 2.0\nregion = 1.57"
# Harder, and the wheels of a robot this high leave the floor while its chassis turns.
HARD = "acceleration = { vx = 0.8, vy = 0.8, wz = 1.0 }\njerk = { vx = 4.0, vy = 4.0, wz = 5.0 }"
GENTLE = "acceleration = { vx = 0.4, vy = 0.4, wz = 0.5 }\njerk = { vx = 2.0, vy = 2.0, wz = 2.5 }"
MASS = 40.0  # kg of an omni robot whose file says 25
STIFF = "speed_loop = { kp = 3.5, ki = 14.0 }"
SLACK = "speed_loop = { kp = 0.7, ki = 2.0 }"  # with which mass shows

Twists = Callable[[float], Twist]
Cycle = tuple[Inputs, Outputs]


class Noisy:
    """A plant whose encoders tell so much noise more, new in every substep. `rate`, `angle`: standard deviations."""

    def __init__(self, plant: Plant, seed: int, *, rate: float, angle: float = 1e-4) -> None:
        self.__dict__.update(plant=plant, chance=Random(seed), rate=rate, angle=angle, noise=None)

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401  # whatever the plant has
        return getattr(self.plant, name)

    def __setattr__(self, name: str, value: object) -> None:
        setattr(self.plant, name, value)

    def step(self, torques: Sequence[float]) -> None:
        self.plant.step(torques)
        self.__dict__["noise"] = None

    @property
    def angles(self) -> tuple[float, ...]:
        return tuple(angle + off for angle, (off, _) in zip(self.plant.angles, self._noise(), strict=True))

    @property
    def rates(self) -> tuple[float, ...]:
        return tuple(rate + off for rate, (_, off) in zip(self.plant.rates, self._noise(), strict=True))

    def _noise(self) -> list[tuple[float, float]]:
        if self.noise is None:
            gauss = self.chance.gauss
            self.__dict__["noise"] = [(gauss(0.0, self.angle), gauss(0.0, self.rate)) for _ in self.plant.rates]
        noise: list[tuple[float, float]] = self.noise
        return noise


class Driven(NamedTuple):
    """A drive that was: robot file, its config, and every cycle; `path`: its session."""

    text: str
    config: RobotConfig
    cycles: list[Cycle]
    path: Path


def text_of(name: str, *, gentle: bool = True) -> str:
    """The bundled robot file; `gentle`: of moby with a chassis that is compensated, and with half the acceleration."""
    text = robot_text(name)
    if name != "moby" or not gentle:
        return text
    assert UNCOMPENSATED in text
    assert HARD in text
    return text.replace(UNCOMPENSATED, COMPENSATED).replace(HARD, GENTLE)


def heavy_omni(robot: OmniRobot) -> MujocoPlant:
    """MuJoCo's omni robot, heavier than its file says."""
    return omni(with_values(robot, {"mass": MASS}))


def random_twists(seed: int, *, share: float = 1.0) -> Twists:
    """Another one every second, within so much of 1 m/s and 1 rad/s."""
    chance, found = Random(1000 + seed), list[Twist]()

    def twist(t: float) -> Twist:
        while len(found) <= int(t / CHANGE_S):
            found.append(Twist(*(share * chance.uniform(-1.0, 1.0) for _ in range(3))))
        return found[int(t / CHANGE_S)]

    return twist


def pulled_twists(seed: int) -> Twists:
    """Backwards, so that moby's chassis is pulled, in a direction that turns by 11 to 20 degrees every two seconds."""
    chance, found = Random(2000 + seed), list[Twist]()
    course = 0.0

    def twist(t: float) -> Twist:
        nonlocal course
        while len(found) <= int(t / TURN_S):
            course += chance.choice((-1.0, 1.0)) * chance.uniform(0.2, 0.35)
            speed = chance.uniform(0.3, 0.5)
            found.append(Twist(-speed * cos(course), -speed * sin(course), chance.uniform(-0.2, 0.2)))
        return found[int(t / TURN_S)]

    return twist


def drive(  # all that a drive may be
    folder: Path,
    text: str,
    twists: Twists,
    *,
    seconds: float,
    plant: Callable[[Any], Plant] | PlantName,
    noise: float = 0.0,
    seed: int = 0,
    settings: dict[str, float] | None = None,
    torque_scale: float = 1.0,
) -> Driven:
    """Ready, driven for so long, stopped. `settings` are asked for at the beginning.

    The controllers are tuned to the robot of the text, whatever the plant is. `torque_scale`: what acts of a torque.
    """
    config = parse(text, "robot file")
    named = plant if isinstance(plant, PlantName) else None
    real = plant_of(config.robot, plant) if isinstance(plant, PlantName) else plant(config.robot)
    noisy: Any = Noisy(real, seed, rate=noise) if noise else real
    tuned = plant_of(config.robot, named or PlantName.SIMPLE).reflected_inertia
    loop = ClosedLoop(config, plant=noisy, commissioned=tuned)
    for motor in config.robot.motor_names():
        loop.bus.robot.drivetrain(motor).gain = torque_scale
    folder.mkdir(parents=True, exist_ok=True)
    recording = SessionRecording(config, text, "robot file", directory=folder, started_wall_ns=WALL_NS, plant=named)
    cycles, period = list[Cycle](), loop.period_ns * 1e-9
    every = max(1, round(0.02 / period))
    for index in range(round((READY_S + seconds + STOP_S) / period)):
        t = index * period - READY_S
        twist = twists(t) if 0.0 <= t < seconds else ZERO_TWIST
        commands = [TwistCommand("teleop", twist, TwistFrame.BODY, None, loop.next_ns)] if index % every == 0 else []
        asked = settings or {} if index == 0 else {}
        requests = [
            Request(RequestKind.SET, 1 + place, loop.next_ns, setting=name, value=value)
            for place, (name, value) in enumerate(asked.items())
        ]
        cycles.append(loop.cycle(commands=commands, requests=requests))
        assert all(reply.ok for reply in cycles[-1][1].replies)
        recording.put(*cycles[-1], loop.engine.snapshot)
    recording.close()
    return Driven(text, config, cycles, recording.session)
