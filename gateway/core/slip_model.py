"""What is known beforehand of the wheels that may slip: how exactly they are measured, and what their torques do.

How this works
--------------
The speed of wheel j is known to within e_j = its step + skew times acceleration + SPEED_TOLERANCE of it. The step is
the finest difference that its controller tells; skew is how much older the oldest measurement of a cycle is than the
newest; the acceleration is the most that all motors together can give the wheel while it grips. In the residual of
wheel i that is at most the sum of |P_ij| e_j: what exceeds it, none of these explains.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

from gateway.arithmetic import dot
from gateway.config import RobotConfig
from gateway.control.slip_correction import Wheel
from gateway.core.assembly import Robot
from gateway.kinematics.fixed_wheels import FixedWheels
from gateway.kinematics.linear import Matrix, Vector, product, pseudo_inverse, transpose
from gateway.kinematics.redundancy import Redundancy

SPEED_TOLERANCE: Final = 0.01  # of a speed: radius and axle of a worn wheel; half of what odometry takes a metre to err
LEAST_STEP: Final = 1e-5  # m/s: nobody measures a rim more finely
UNKNOWN_STEP: Final = 0.005  # of a motor's top speed, where its controller does not say how finely it measures


class SlipModel(NamedTuple):
    """Per wheel in chassis order. `steps`: m/s at the rim. `gripping`: m/s^2 at the rim, the most while it grips.

    `usual`: rad/s^2 that the limits of the body ask for at most. `spun`: rad/s^2 of each joint per N m of each, while
    all grip. `pushed`: m/s^2 and rad/s^2 of the body per N m that each joint gives to the ground. `resting`: what all
    the drag of joints does to the body at most. The last three: of one joint, kg m^2, N m and N m s/rad.
    """

    redundancy: Redundancy
    radii: tuple[float, ...]
    steps: tuple[float, ...]
    gripping: tuple[float, ...]
    usual: tuple[float, ...]
    spun: Matrix
    pushed: Matrix
    resting: Vector
    inertia: float
    drag: float
    friction: float

    def wheels(self, robot: Robot) -> list[Wheel]:
        """What is corrected while it slips."""
        return [
            Wheel(radius, limits.speed, limits.torque if able.limit else None, self.inertia)
            for radius, limits, able in zip(self.radii, robot.limits, robot.capabilities, strict=True)
        ]


def slip_model(config: RobotConfig, robot: Robot) -> SlipModel | None:
    """Of this robot; None where joint angles change the geometry, so that no wheel can be held against the others."""
    kinematics = robot.kinematics
    if not isinstance(kinematics, FixedWheels):
        return None
    rows, radii, body = kinematics.matrix(), kinematics.radii, config.robot.body
    motors = config.motors_in_order()
    alone = config.robot.inertia((0.0,) * len(rows))  # without what turns with the wheels
    columns = transpose(rows)
    wheels = product(columns, rows)
    together = _sum(alone, wheels, body.joint_inertia)
    spun = product(rows, product(pseudo_inverse(together), columns))
    pushed = product(pseudo_inverse(alone), columns)
    acceleration = config.limits.acceleration.as_rates(kinematics.axes)
    torques = [motor.max_torque for motor in motors]
    return SlipModel(
        redundancy=Redundancy(kinematics.rim_matrix),
        radii=radii,
        steps=tuple([max(LEAST_STEP, r * step) for r, step in zip(radii, _steps(config, robot), strict=True)]),
        gripping=tuple([radius * _most(row, torques) for radius, row in zip(radii, spun, strict=True)]),
        usual=tuple([_most(row, acceleration) for row in rows]),
        spun=spun,
        pushed=pushed,
        resting=tuple([body.joint_drag * _most(row, [1.0] * len(rows)) for row in pushed]),
        inertia=body.joint_inertia,
        drag=body.joint_drag,
        friction=body.joint_friction,
    )


def _steps(config: RobotConfig, robot: Robot) -> list[float]:
    """Rad/s at the output by which measured speeds differ at least."""
    return [
        UNKNOWN_STEP * motor.max_speed if able.speed_step is None else able.speed_step / motor.gear_ratio
        for motor, able in zip(config.motors_in_order(), robot.capabilities, strict=True)
    ]


def _most(row: Sequence[float], sizes: Sequence[float]) -> float:
    """The largest that the scalar product can be of numbers of these sizes."""
    return dot([abs(part) for part in row], sizes)


def _sum(matrix: Matrix, other: Matrix, factor: float) -> Matrix:
    return tuple(
        tuple(a + factor * b for a, b in zip(row, other_row, strict=True))
        for row, other_row in zip(matrix, other, strict=True)
    )
