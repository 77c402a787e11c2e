"""The simple plant of an offset-differential robot (MOBY, Otbot)."""

from collections.abc import Sequence
from math import cos, sin

from gateway.chassis.offset_differential import OffsetDifferentialRobot
from gateway.sections import Body
from gateway.types import Twist
from replay.sim.plants.rigid_body import Chassis, RigidBody, Vector


def plant(robot: OffsetDifferentialRobot) -> RigidBody:
    """A platform that turns on a differential chassis, whose axle lies behind it."""
    return RigidBody(robot.body, lambda body: chassis(robot, body))


def chassis(robot: OffsetDifferentialRobot, body: Body) -> Chassis:
    """u = (speed of the joint along the chassis, chassis rate, platform rate); the whole mass sits at the joint.

    Its weight is carried by the axle behind it and the caster before it, the nearer the more; swivelling changes that
    little and is left out.
    The joint moves with (u0, d1 u1) in chassis axes, so it accelerates with (u0' - d1 u1^2, d1 u1' + u0 u1).
    """
    mass, offset, radius = body.mass, robot.axle_offset, robot.wheel_radius
    lever = robot.track / 2.0
    coupling = mass * offset
    carried = 1.0 if robot.caster is None else robot.caster.position / (robot.caster.position + offset)

    def body_twist(u: Vector, angles: Sequence[float]) -> Twist:
        along, across = u[0], offset * u[1]
        c, s = cos(angles[2]), sin(angles[2])
        return Twist(along * c + across * s, across * c - along * s, u[2])

    return Chassis(
        body=body,
        rows=((1.0 / radius, -lever / radius, 0.0), (1.0 / radius, lever / radius, 0.0), (0.0, -1.0, 1.0)),
        wheel_radii=(radius, radius, None),
        load_shares=(carried / 2.0, carried / 2.0, 0.0),
        mass=(
            (mass, 0.0, 0.0),
            (0.0, robot.chassis_inertia + coupling * offset, 0.0),
            (0.0, 0.0, body.inertia),
        ),
        across=offset,
        gyroscopic=lambda u: (coupling * u[1] * u[1], -coupling * u[1] * u[0], 0.0),
        body_twist=body_twist,
        chassis_angle=lambda heading, angles: heading - angles[2],
    )
