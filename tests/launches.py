"""Launches through the whole service: command, engine, CAN frames, simulated controllers, wheels on a floor that slips.

`best` is what a floor gives at most, found without the core: the linear program over the forces of the wheels, solved
by going through its corners.
"""

import re
from collections.abc import Callable, Mapping
from itertools import combinations
from math import cos, hypot, inf, pi, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.chassis.omni import OmniRobot
from gateway.config import RobotConfig, parse
from gateway.control.drive_law import Measured
from gateway.control.launch import LaunchLaw
from gateway.types import ZERO_TWIST, Mode, Outputs, Twist, TwistCommand, TwistFrame
from replay.drive.closed_loop import ClosedLoop
from replay.sim.plants import plant_of
from replay.sim.plants.contract import Plant, PlantName
from replay.sim.plants.omni_dynamics import OmniDynamics, Stribeck
from tests.world import robot_text

Array = NDArray[np.float64]
GRAVITY = 9.81  # m/s^2
TOP = 1.0  # m/s
CREEP = 0.1  # m/s, below which a speed is too little to hold a slip against
FRICTIONS = (0.8, 0.3)
FALLING = Stribeck(0.6, 0.1)  # of the friction at rest, left at much more than 0.1 m/s of slip
BODY = "acceleration = {{ vx = {0}, vy = {0}, wz = {1} }}\njerk = {{ vx = {2}, vy = {2}, wz = {3} }}"
EAGER = BODY.format(9.0, 30.0, 75.0, 240.0)  # beyond what any floor here gives
HEIGHT = 0.06  # m, where the robot file has none
ROBOTS = {
    "omni4": "torque, speed loop on the host",
    "omni4_odrive": "speed, and torque besides",
    "omni4_gm6020": "voltage, speed loop on the host",
}


def direction(eighth: int) -> tuple[float, float]:
    return cos(eighth * pi / 4), sin(eighth * pi / 4)


def with_odrives(text: str) -> str:
    """Controllers that take a speed and a torque besides in place of those that take a torque."""
    for pattern, new in (
        ('driver = "dji"\nvariant = "c620"', 'driver = "odrive"\nvariant = "0.6"'),
        ("feedback_rate = 1000.0", "feedback_rate = 250.0"),
        (r"watchdog_waiver = .*", "watchdog = { timeout = 0.1 }"),
        (
            r"speed_loop = .*",
            'options = { firmware = "0.6.10", watchdog_enable_endpoint = 188, watchdog_timeout_endpoint = 189 }',
        ),
    ):
        text = re.sub(pattern, new, text)
    return text


def robot(name: str, friction: float | None, *, saturation: str = "both") -> RobotConfig:
    """A robot with limits that no floor gives; `friction` as its file tells it, None: it does not."""
    text = with_odrives(robot_text("omni4")) if name == "omni4_odrive" else robot_text(name)
    lines = text.replace('kind = "omni"', f'kind = "omni"\nsaturation = "{saturation}"').splitlines()
    keys = ("acceleration = ", "jerk = ")
    at = next(index for index, line in enumerate(lines) if line.startswith(keys[0]))
    assert lines[at + 1].startswith(keys[1])
    lines[at : at + 2] = EAGER.splitlines()
    text = "\n".join(lines)
    if "centre_height" not in text:
        text = text.replace("[robot.body]", f"[robot.body]\ncentre_height = {HEIGHT}")
    if friction is not None:
        text = text.replace("[loop]", f"[robot.grip]\nfriction = {friction}\n\n[loop]", 1)
    return parse(text, name)


def dynamics(robot: OmniRobot, friction: float) -> Plant:
    """Ours, with loads that shift."""
    plant = plant_of(robot, PlantName.DYNAMICS)
    for wheel in plant.wheels:
        plant.set_friction(wheel, friction)
    return plant


def mujoco(robot: OmniRobot, friction: float) -> Plant:
    """MuJoCo's."""
    from tests.replay.mujoco_pads import PadsPlant  # noqa: PLC0415  not where it is not asked for

    return PadsPlant(robot, friction)


PLANTS: Mapping[str, Callable[[OmniRobot, float], Plant]] = {"dynamics": dynamics, "mujoco": mujoco}


class Launch:
    """From rest to TOP and to rest again in one direction; what really happened.

    `friction`: of the floor; `told`: by the robot file, None: nothing. `turn`: rad/s besides. `stribeck`: the friction
    falls with slip.
    """

    def __init__(
        self,
        name: str,
        eighth: int,
        friction: float,
        *,
        told: float | None,
        plant: str = "dynamics",
        seconds: float = 0.8,
        stop: bool = True,
        turn: float = 0.0,
        saturation: str = "both",
        stribeck: Stribeck | None = None,
    ) -> None:
        self.config = robot(name, told, saturation=saturation)
        chassis = self.config.robot
        assert isinstance(chassis, OmniRobot)
        self.plant = PLANTS[plant](chassis, friction)
        if stribeck is not None:
            assert isinstance(self.plant, OmniDynamics)
            self.plant.stribeck = stribeck
        self.loop = ClosedLoop(self.config, plant=self.plant)
        self.speeds: list[float] = []
        self.slips: list[float] = []
        self.codes: list[str] = []
        self.limits: set[str] = set()
        self.measured: list[Measured] = []
        self.outputs: list[Outputs] = []  # since it was in drive
        self._radii = [wheel.radius for wheel in chassis.wheel]
        self._kinematics = chassis.kinematics()
        self._start()
        x, y = self.direction = direction(eighth)
        self.target = Twist(TOP * x, TOP * y, turn)
        self._drive(self.target, seconds)
        self.launched = len(self.speeds)
        if stop:
            self._drive(ZERO_TWIST, seconds)

    @property
    def acceleration(self) -> float:
        """m/s^2, from three tenths to seven tenths of the speed; 0 where it was not reached."""
        times = np.arange(self.launched) / self.config.loop.rate
        speeds = self.speeds[: self.launched]
        if max(speeds) < 0.7 * TOP:
            return 0.0
        low, high = (next(at for at, speed in enumerate(speeds) if speed >= share * TOP) for share in (0.3, 0.7))
        begun, ended = (_crossed(times, speeds, at, share * TOP) for at, share in ((low, 0.3), (high, 0.7)))
        return 0.4 * TOP / (ended - begun)

    @property
    def seconds_to_speed(self) -> float:
        """S from the command to nine tenths of the speed, inf if it is not reached."""
        times = (at for at, speed in enumerate(self.speeds[: self.launched]) if speed >= 0.9 * TOP)
        return next(times, inf) / self.config.loop.rate

    @property
    def slip(self) -> float:
        """Largest part of the speed by which a wheel slips in the launch."""
        pairs = zip(self.slips[: self.launched], self.speeds[: self.launched], strict=True)
        return max(slip / max(speed, CREEP) for slip, speed in pairs)

    @property
    def stopping_slip(self) -> float:
        """The same of the commanded stop."""
        pairs = zip(self.slips[self.launched :], self.speeds[self.launched :], strict=True)
        return max(slip / max(speed, CREEP) for slip, speed in pairs)

    @property
    def path_error(self) -> float:
        """M of the way aside."""
        (x, y), pose = self.direction, self.plant.pose
        return abs(x * pose.y - y * pose.x)

    @property
    def odometry_error(self) -> float:
        """M between where it is and where it takes itself to be."""
        told, true = self.outputs[-1].trace.pose, self.plant.pose
        return hypot(told.x - true.x, told.y - true.y)

    @property
    def law(self) -> LaunchLaw:
        law = self.loop.engine._law
        assert isinstance(law, LaunchLaw)
        return law

    def _start(self) -> None:
        for _ in range(75):
            self.loop.cycle()
        for _ in range(750):
            self._cycle(ZERO_TWIST)
            if self.loop.engine.mode is Mode.DRIVE:
                break
        assert self.loop.engine.mode is Mode.DRIVE

    def _drive(self, twist: Twist, seconds: float) -> None:
        for _ in range(round(seconds * self.config.loop.rate)):
            outputs = self._cycle(twist)
            rolling = self._kinematics.wheel_speeds(self.plant.twist, ())
            assert rolling is not None
            slips = [
                abs(radius * (rate - roll))
                for radius, rate, roll in zip(self._radii, self.plant.rates, rolling, strict=True)
            ]
            self.speeds.append(hypot(*self.plant.twist[:2]))
            self.slips.append(max(slips))
            self.outputs.append(outputs)
            self.measured.append(self.loop.engine._measured)
            if outputs.status is not None:
                self.limits |= set(outputs.status.limits_active)

    def _cycle(self, twist: Twist) -> Outputs:
        stamp = self.loop.now_ns + self.loop.period_ns
        command = TwistCommand("teleop", twist, TwistFrame.BODY, None, stamp, "teleop", stamped=False)
        _, outputs = self.loop.cycle(commands=[command])
        self.codes += [event.code for event in outputs.events]
        return outputs


def _crossed(times: Array, speeds: list[float], at: int, level: float) -> float:
    before, after = speeds[at - 1], speeds[at]
    return float(times[at] - (after - level) / (after - before) * (times[at] - times[at - 1]))


class Wheels(NamedTuple):
    """Rows of the rim matrix, and of each wheel in N: its load at rest, and what its motor pushes at half of TOP.

    Per m/s^2 in a direction: what that shifts of the load, and what the motor needs for the wheel itself.
    """

    rows: Array
    resting: Array
    shift: Array
    pushes: Array
    spins: Array


def wheels(config: RobotConfig, eighth: int) -> Wheels:
    """Of a rigid body on wheels of equal stiffness."""
    chassis = config.robot
    assert isinstance(chassis, OmniRobot)
    body, (x, y) = chassis.body, direction(eighth)
    assert body.centre_height is not None
    places = np.array([(wheel.x, wheel.y) for wheel in chassis.wheel])
    rows = np.array(
        [
            (-sin(w.axis_angle), cos(w.axis_angle), cos(w.axis_angle) * w.x + sin(w.axis_angle) * w.y)
            for w in chassis.wheel
        ]
    )
    plane = np.linalg.pinv(np.vstack([np.ones(len(places)), places.T]))
    lever = body.mass * body.centre_height
    pushes = [
        (motor.max_torque - body.joint_drag - body.joint_friction * TOP / 2.0 / wheel.radius) / wheel.radius
        for motor, wheel in zip(config.motors_in_order(), chassis.wheel, strict=True)
    ]
    spins = [body.joint_inertia / wheel.radius**2 for wheel in chassis.wheel] * (rows @ (x, y, 0.0))
    shift = plane @ (0.0, -lever * x, -lever * y)
    return Wheels(rows, plane[:, 0] * body.mass * GRAVITY, shift, np.array(pushes), np.array(spins))


def best(config: RobotConfig, eighth: int, friction: float) -> float:
    """The largest acceleration, m/s^2, for which there are forces within friction times the loads that it leaves.

    Unknowns are the forces and the acceleration a: rows' f = M a d, |f_k| <= mu (n_k + s_k a), n_k + s_k a >= 0, and
    |f_k| within what its motor has.
    At a corner as many of the inequalities are equalities as there are unknowns left.
    """
    rows, resting, shift, pushes, spins = wheels(config, eighth)
    count, mass = len(rows), config.robot.body.mass
    equal = np.hstack([rows.T, -mass * np.array([[*direction(eighth), 0.0]]).T])
    limits, most = [], []
    for wheel in range(count):
        for sign in (1.0, -1.0):
            limits.append([*(sign * np.eye(count)[wheel]), -friction * shift[wheel]])
            most.append(friction * resting[wheel])
            limits.append([*(sign * np.eye(count)[wheel]), abs(spins[wheel])])
            most.append(pushes[wheel])
    for wheel in range(count):
        limits.append([*np.zeros(count), -shift[wheel]])
        most.append(resting[wheel])
    bounds, ends = np.array(limits), np.array(most)
    found = 0.0
    for chosen in combinations(range(len(bounds)), count + 1 - len(equal)):
        matrix = np.vstack([equal, bounds[list(chosen)]])
        if abs(np.linalg.det(matrix)) < 1e-9:
            continue
        corner = np.linalg.solve(matrix, np.concatenate([np.zeros(len(equal)), ends[list(chosen)]]))
        if (bounds @ corner <= ends + 1e-6).all():
            found = max(found, float(corner[-1]))
    return found


def equal_torques(config: RobotConfig, eighth: int, friction: float) -> float:
    """The same where the wheels push by least norm, whatever they carry: until the first of them slips."""
    rows, resting, shift, pushes, spins = wheels(config, eighth)
    forces = np.linalg.pinv(rows.T) @ (config.robot.body.mass * np.array([*direction(eighth), 0.0]))
    least = inf
    for force, load, change, push, spin in zip(np.abs(forces), resting, shift, pushes, np.abs(spins), strict=True):
        floor, motor = force - friction * change, force + spin
        if floor > 0.0:
            least = min(least, friction * load / floor)
        if motor > 0.0:
            least = min(least, push / motor)
    return float(least)
