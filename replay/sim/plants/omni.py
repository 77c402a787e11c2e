"""The simple plant of a robot on omni wheels."""

from math import cos, sin

from gateway.chassis.omni import OmniRobot
from gateway.sections import Body
from gateway.types import Twist
from replay.sim.plants.rigid_body import Chassis, RigidBody


def plant(robot: OmniRobot) -> RigidBody:
    """n omni wheels under one rigid body."""
    return RigidBody(robot.body, lambda body: chassis(robot, body))


def chassis(robot: OmniRobot, body: Body) -> Chassis:
    """u is the body twist; a wheel drives along its axle direction turned by 90 degrees."""
    mass, inertia = body.mass, body.inertia
    rows = []
    for wheel in robot.wheel:
        drive_x, drive_y = -sin(wheel.axis_angle), cos(wheel.axis_angle)
        rows.append(
            (drive_x / wheel.radius, drive_y / wheel.radius, (drive_y * wheel.x - drive_x * wheel.y) / wheel.radius)
        )
    return Chassis(
        body=body,
        rows=tuple(rows),
        wheel_radii=tuple(wheel.radius for wheel in robot.wheel),
        load_shares=(1.0 / len(robot.wheel),) * len(robot.wheel),
        mass=((mass, 0.0, 0.0), (0.0, mass, 0.0), (0.0, 0.0, inertia)),
        across=1.0,
        gyroscopic=lambda u: (mass * u[2] * u[1], -mass * u[2] * u[0], 0.0),
        body_twist=lambda u, _: Twist(*u),
        chassis_angle=lambda heading, _: heading,
    )
