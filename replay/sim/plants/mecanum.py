"""The simple plant of a robot on mecanum wheels."""

from math import cos, tan

from gateway.chassis.mecanum import MecanumRobot
from gateway.sections import Body
from gateway.types import Twist
from replay.sim.plants.rigid_body import Chassis, RigidBody


def plant(robot: MecanumRobot) -> RigidBody:
    """n mecanum wheels under one rigid body."""
    return RigidBody(robot.body, lambda body: chassis(robot, body))


def chassis(robot: MecanumRobot, body: Body) -> Chassis:
    """u is the body twist. The floor pushes a wheel along its roller's axis alone, so it rolls with that component.

    A torque at the wheel pushes along that axis with 1 / cos of it more, and so loses its grip that much earlier.
    """
    mass, inertia = body.mass, body.inertia
    rows = []
    for wheel in robot.wheel:
        across = tan(wheel.roller_angle)
        rows.append((1.0 / wheel.radius, across / wheel.radius, (across * wheel.x - wheel.y) / wheel.radius))
    return Chassis(
        body=body,
        rows=tuple(rows),
        wheel_radii=tuple(wheel.radius * abs(cos(wheel.roller_angle)) for wheel in robot.wheel),
        load_shares=(1.0 / len(robot.wheel),) * len(robot.wheel),
        mass=((mass, 0.0, 0.0), (0.0, mass, 0.0), (0.0, 0.0, inertia)),
        across=1.0,
        gyroscopic=lambda u: (mass * u[2] * u[1], -mass * u[2] * u[0], 0.0),
        body_twist=lambda u, _: Twist(*u),
        chassis_angle=lambda heading, _: heading,
    )
