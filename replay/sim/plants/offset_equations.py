"""The equations of motion of the offset-differential robot with its caster, in the three speeds that are free.

How this works
--------------
u = (v, w, W): speed of the platform joint along the chassis (m/s), rates of chassis and platform (rad/s). In chassis
axes the joint moves with (v, d1 w), the caster's joint with (v, D w), D = d1 + d4. Of the latter
    p = c v + s D w   lies along the caster's axle, r = s v - c D w along its fork   (s, c: sine, cosine of the swivel).
The five constraints (science 1.1, 1.2) are: the axle does not move sideways (in u already), wheels turn at
(v -+ w d2/2)/R, the fork swings at -p/d3 in the world, the caster rolls at r/Rc. So the acceleration of every body is
written down, and what the bodies resist along each of the three speeds is added up (Jourdain's principle): no heading,
no multipliers, nothing that drifts. A body of the caster at the share l of the trail moves with p (1 - l) and r.
Plain floats throughout, and no function that another processor computes otherwise.
"""

from collections.abc import Container
from typing import NamedTuple

from gateway.arithmetic import dot
from replay.sim.plants.offset_parameters import CASTER, JOINT, LEFT, PLATFORM, RIGHT, SWIVEL, OffsetParameters, X, Y

Motion = tuple[float, float, float]
Force = tuple[float, float, float]  # along each of the three speeds: N, N m, N m


class _Caster(NamedTuple):
    """What fork and caster wheel resist; sums over both, l their share of the trail, I what swings, Q what rolls."""

    mass: float  # m
    ahead: float  # m (1 - l)
    behind: float  # m l
    axle: float  # m (1 - l)^2 + I/d3^2: along the axle
    mixed: float  # m (1 - l) l - I/d3^2
    fork: float  # m + Q: along the fork
    swept: float  # m l + Q


class OffsetEquations:
    """Of one set of parameters. `loose`: wheels (LEFT, RIGHT) that turn at a speed of their own, not held to theirs."""

    def __init__(self, parameters: OffsetParameters, loose: Container[int] = ()) -> None:
        p = self.parameters = parameters
        friction = p.friction
        if friction[X] != friction[Y]:
            raise ValueError(f"friction {friction[X]:g} along x and {friction[Y]:g} along y: the floor knows no axes")
        half, radius, offset = p.track / 2.0, p.wheel_radius, p.axle_offset
        left, right = (0.0 if wheel in loose else 1.0 / radius for wheel in (LEFT, RIGHT))
        self._half, self._reach = half, offset + p.caster_position
        self._caster = _caster(p)
        # What moves with the chassis: kg, and m ahead of the axle.
        masses = (p.chassis_mass, 2.0 * p.wheel_mass, p.platform_mass)
        ahead = (offset + p.chassis_offset, 0.0, offset)
        self._mass = dot(masses, (1.0, 1.0, 1.0))
        self._moment = dot(masses, ahead)
        turning = dot(masses, [one * one for one in ahead]) + p.chassis_inertia
        turning += 2.0 * (p.wheel_mass * half * half + p.wheel_radial)
        # Wheels that are held resist through their rows, and so do inertia and friction of the joint's motor.
        spin = p.wheel_axial
        self._m11 = self._mass + spin * (left * left + right * right)
        self._m12 = spin * half * (right * right - left * left)
        self._m22 = turning + spin * half * half * (left * left + right * right) + p.joint_inertia
        self._m23 = -p.joint_inertia
        self._m33 = p.platform_inertia + p.joint_inertia
        slow_left, slow_right = friction[LEFT] * left * left, friction[RIGHT] * right * right
        self._b11 = slow_left + slow_right + friction[X]
        self._b12 = half * (slow_right - slow_left)
        self._b22 = half * half * (slow_left + slow_right) + friction[JOINT] + friction[Y] * offset * offset
        self._b23 = -friction[JOINT]
        self._b33 = friction[PLATFORM] + friction[JOINT]
        self._b_swivel, self._b_caster = friction[SWIVEL], friction[CASTER]
        self._ratio = half / radius

    def driven(self, left: float, right: float, joint: float) -> Force:
        """What these torques, N m, do along the three speeds."""
        return (left + right) / self.parameters.wheel_radius, self._ratio * (right - left) - joint, joint

    def motors(self, force: Force) -> tuple[float, float, float]:
        """Torques of wheels and joint that do this: the inverse of `driven`."""
        along, turning, joint = force
        both, apart = along * self.parameters.wheel_radius, (turning + joint) / self._ratio
        return (both - apart) / 2.0, (both + apart) / 2.0, joint

    def joint_rates(self, motion: Motion) -> tuple[float, float, float]:
        """Of left and right wheel and of the platform joint, rad/s. Linear in the motion."""
        v, w, platform = motion
        radius, turn = self.parameters.wheel_radius, w * self._half
        return (v - turn) / radius, (v + turn) / radius, platform - w

    def caster_rates(self, s: float, c: float, motion: Motion) -> tuple[float, float]:
        """Of swivel and caster wheel, rad/s; s, c: sine and cosine of the swivel. Linear in the motion."""
        v, w, _ = motion
        p, r = c * v + s * self._reach * w, s * v - c * self._reach * w
        return -p / self.parameters.trail - w, r / self.parameters.caster_radius

    def caster_changes(self, s: float, c: float, motion: Motion) -> tuple[float, float]:
        """Accelerations of swivel and caster, rad/s^2, while the three speeds do not change."""
        v, w, _ = motion
        p, r = c * v + s * self._reach * w, s * v - c * self._reach * w
        swivel = -p / self.parameters.trail - w
        return swivel * r / self.parameters.trail, swivel * p / self.parameters.caster_radius

    def acceleration(self, s: float, c: float, motion: Motion, force: Force) -> Motion:
        """How the three speeds change under this force."""
        along, turning, platform = self.resistance(s, c, motion)
        return self.yielding(s, c, (force[0] - along, force[1] - turning, force[2] - platform))

    def torques_for(self, s: float, c: float, motion: Motion, change: Motion) -> tuple[float, float, float]:
        """N m of the joints with which the three speeds change so: the inverse of `acceleration`."""
        along, turning, platform = self.resistance_to(s, c, change)
        against = self.resistance(s, c, motion)
        return self.motors((along + against[0], turning + against[1], platform + against[2]))

    def resistance(self, s: float, c: float, motion: Motion) -> Force:
        """What it takes that the three speeds do not change: inertia of the bends, and friction."""
        v, w, platform = motion
        reach = self._reach
        p, r = c * v + s * reach * w, s * v - c * reach * w
        swing = -p / self.parameters.trail
        _, _, _, axle, mixed, fork, swept = self._caster
        of_axle, of_fork = r * (axle * w + mixed * swing), p * (swept * swing - fork * w)
        if self._b_swivel or self._b_caster:
            of_axle -= self._b_swivel * (swing - w) / self.parameters.trail
            of_fork += self._b_caster * r / (self.parameters.caster_radius * self.parameters.caster_radius)
        return (
            c * of_axle + s * of_fork - self._moment * w * w + self._b11 * v + self._b12 * w,
            reach * (s * of_axle - c * of_fork)
            + self._moment * w * v
            + self._b12 * v
            + self._b22 * w
            + self._b23 * platform
            - self._b_swivel * (swing - w),
            self._b23 * w + self._b33 * platform,
        )

    def resistance_to(self, s: float, c: float, change: Motion) -> Force:
        """Mass matrix times a change of the three speeds: also the momentum that belongs to a motion."""
        m11, m12, m22 = self._with_caster(s, c)
        v, w, platform = change
        return m11 * v + m12 * w, m12 * v + m22 * w + self._m23 * platform, self._m23 * w + self._m33 * platform

    def yielding(self, s: float, c: float, force: Force) -> Motion:
        """Inverse of the mass matrix times a force (or an impulse)."""
        m11, m12, m22 = self._with_caster(s, c)
        along, turning, platform = force
        share = self._m23 / self._m33
        m22 -= share * self._m23
        turning -= share * platform
        scale = 1.0 / (m11 * m22 - m12 * m12)
        w = (m11 * turning - m12 * along) * scale
        return (m22 * along - m12 * turning) * scale, w, (platform - self._m23 * w) / self._m33

    def energy(self, s: float, c: float, motion: Motion) -> float:
        """Of the motion, J, without wheels that are loose."""
        return dot(self.resistance_to(s, c, motion), motion) / 2.0

    def weight(self, s: float, c: float, along: float, across: float) -> Force:
        """What a field that accelerates everything alike does, m/s^2 in chassis axes."""
        caster = self._caster
        of_axle = caster.ahead * (c * along + s * across)
        of_fork = caster.mass * (s * along - c * across)
        return (
            self._mass * along + c * of_axle + s * of_fork,
            self._moment * across + self._reach * (s * of_axle - c * of_fork),
            0.0,
        )

    def momentum(self, s: float, c: float, motion: Motion) -> tuple[float, float]:
        """Sum of mass times velocity of all bodies, kg m/s in chassis axes."""
        v, w, _ = motion
        small, trailed = self._caster.mass, self._caster.behind * (c * v + s * self._reach * w)
        return (self._mass + small) * v - trailed * c, (self._moment + small * self._reach) * w - trailed * s

    def ground(self, s: float, c: float, motion: Motion, change: Motion) -> tuple[float, float]:
        """Sum of mass times acceleration of all bodies, N in chassis axes: without a push, the force of the ground."""
        v, w, _ = motion
        reach = self._reach
        p, r = c * v + s * reach * w, s * v - c * reach * w
        swing = -p / self.parameters.trail
        of_joint = (change[0] - reach * w * w, reach * change[1] + w * v)
        of_axle = c * of_joint[0] + s * of_joint[1] - swing * r
        behind, small = self._caster.behind, self._caster.mass
        return (
            self._mass * change[0]
            - self._moment * w * w
            + small * of_joint[0]
            + behind * (s * p * swing - c * of_axle),
            self._moment * change[1]
            + self._mass * w * v
            + small * of_joint[1]
            - behind * (c * p * swing + s * of_axle),
        )

    def _with_caster(self, s: float, c: float) -> tuple[float, float, float]:
        """Mass matrix of the first two speeds."""
        reach = self._reach
        axle, fork = self._caster.axle, self._caster.fork
        ss, cc = s * s, c * c
        return (
            self._m11 + axle * cc + fork * ss,
            self._m12 + reach * s * c * (axle - fork),
            self._m22 + reach * reach * (axle * ss + fork * cc),
        )


def _caster(p: OffsetParameters) -> _Caster:
    masses, shares = (p.fork_mass, p.caster_mass), (p.fork_share, 1.0)
    swings = (p.fork_inertia + p.caster_radial) / (p.trail * p.trail)
    rolls = p.caster_axial / (p.caster_radius * p.caster_radius)
    rest = [1.0 - share for share in shares]
    mass, ahead, behind = dot(masses, (1.0, 1.0)), dot(masses, rest), dot(masses, shares)
    return _Caster(
        mass=mass,
        ahead=ahead,
        behind=behind,
        axle=dot(masses, [one * one for one in rest]) + swings,
        mixed=dot(masses, [one * share for one, share in zip(rest, shares, strict=True)]) - swings,
        fork=mass + rolls,
        swept=behind + rolls,
    )
