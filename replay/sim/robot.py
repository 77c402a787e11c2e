"""The simulated robot: motor controllers on a moving chassis, advanced in fixed substeps. It knows no bus."""

from collections.abc import Callable
from typing import NamedTuple

from gateway.config import Motor, RobotConfig
from gateway.types import Pose, Twist
from replay.sim.device import STEP_NS, MotorSetup, Shaft, SimulatedDevice
from replay.sim.dji import SimulatedDji
from replay.sim.dynamics import CHASSIS, Dynamics
from replay.sim.odrive import SimulatedODrive

CONTROLLERS: dict[str, Callable[[MotorSetup], SimulatedDevice]] = {
    "odrive": SimulatedODrive,
    "dji": SimulatedDji,
}


class Truth(NamedTuple):
    """What no sensor tells: the real motion."""

    time_ns: int
    pose: Pose
    twist: Twist
    joint_angles: tuple[float, ...]  # rad at the output as the robot file counts them, in config order
    joint_rates: tuple[float, ...]  # rad/s
    chassis_angle: float  # rad in the world; differs from the heading where the platform turns on the chassis


class _Joint(NamedTuple):
    """Where a motor shaft meets its output: shaft angle = output angle * scale."""

    device: SimulatedDevice
    scale: float  # gear ratio with the sign of the mounting direction
    zero: float  # output angle where the chassis counts the joint as zero


class SimulatedRobot:
    """Devices by motor name and the dynamics they drive. `start` sets the time origin; substeps count from it."""

    def __init__(self, config: RobotConfig) -> None:
        self.dynamics = Dynamics(CHASSIS[config.robot.kind](config.robot))
        self._joints = tuple(
            _Joint(_device(motor, inertia), motor.gear_ratio * motor.direction, motor.zero)
            for motor, inertia in zip(config.motors_in_order(), self.dynamics.reflected_inertia, strict=True)
        )
        self.devices = {joint.device.setup.name: joint.device for joint in self._joints}
        self._torques = [0.0] * len(self._joints)
        self._time_ns: int | None = None

    @property
    def next_step_ns(self) -> int:
        """The instant up to which the devices see no new shaft state."""
        return self._time() + STEP_NS

    @property
    def truth(self) -> Truth:
        dynamics = self.dynamics
        return Truth(
            time_ns=self._time(),
            pose=dynamics.pose,
            twist=dynamics.twist,
            joint_angles=tuple(a + joint.zero for a, joint in zip(dynamics.angles, self._joints, strict=True)),
            joint_rates=dynamics.rates,
            chassis_angle=dynamics.chassis_angle,
        )

    def start(self, now_ns: int) -> None:
        """Power on everything at this instant, every joint at its zero."""
        self._time_ns = now_ns
        for joint, shaft in zip(self._joints, self._shafts(), strict=True):
            joint.device.start(shaft, now_ns)

    def advance(self, now_ns: int) -> None:
        """Run every whole substep up to now."""
        time_ns = self._time() + STEP_NS
        while time_ns <= now_ns:
            self._time_ns = time_ns
            self.dynamics.step(self._torques)
            self._torques = [
                joint.device.step(shaft, time_ns) * joint.scale
                for joint, shaft in zip(self._joints, self._shafts(), strict=True)
            ]
            time_ns += STEP_NS

    def _time(self) -> int:
        if self._time_ns is None:
            raise RuntimeError("the simulated robot has not been started")
        return self._time_ns

    def _shafts(self) -> list[Shaft]:
        dynamics = self.dynamics
        return [
            Shaft((angle + joint.zero) * joint.scale, rate * joint.scale)
            for joint, angle, rate in zip(self._joints, dynamics.angles, dynamics.rates, strict=True)
        ]


def _device(motor: Motor, inertia: float) -> SimulatedDevice:
    """The controller as commissioned on this robot; limits and inertia moved from the output to the shaft."""
    make = CONTROLLERS.get(motor.driver)
    if make is None:
        raise ValueError(
            f"motor {motor.name}: driver {motor.driver!r} has no simulated controller: {list(CONTROLLERS)}"
        )
    return make(
        MotorSetup(
            name=motor.name,
            bus=motor.bus,
            id=motor.id,
            variant=motor.variant,
            max_speed=motor.max_speed * motor.gear_ratio,
            max_torque=motor.max_torque / motor.gear_ratio,
            max_current=motor.max_current,
            inertia=inertia / motor.gear_ratio**2,
            feedback_rate=motor.feedback_rate,
            watchdog=motor.watchdog,
        )
    )
