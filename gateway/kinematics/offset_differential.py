"""Two driven wheels whose axle lies d1 behind a driven platform joint, and a passive caster (MOBY, Otbot).

How this works
--------------
Everything is expressed in the platform frame (`base_link`, at the joint). The joint angle phi = platform - chassis
heading, so the chassis axis points along e = (cos phi, -sin phi) and its left normal is n = (sin phi, cos phi).
Moving the joint at v makes the chassis turn at (n . v)/d1 and roll at e . v (preprints202312.1327, Eqs. 8-12, which
are right as printed; the caster rows, Eqs. 6 and 13, carry the corrected sign of beta rate).
The wheel rows are written once, in `_rows`; the forward direction solves the same rows.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

from drivers.records import maker
from gateway.arithmetic import sin_cos
from gateway.kinematics.contract import Estimate, GeometryError, Reach
from gateway.kinematics.linear import Matrix
from gateway.kinematics.reach import ReachTable
from gateway.types import PLANAR, Rates, Twist

_twist: Final = maker(Twist)
_estimate: Final = maker(Estimate)
PLATFORM: Final = 2  # place of the joint; the wheels are 0 (left) and 1 (right)
MIN_AXLE_OFFSET: Final = 1e-3  # m; singular at zero (science: det J = R^2 d1 / d2)


class CasterGeometry(NamedTuple):
    """Trail d3, caster joint distance d4 ahead of the platform joint, caster wheel radius Rc; m."""

    trail: float
    position: float
    radius: float


class CasterRates(NamedTuple):
    """Swivel rate (beta) and rolling rate (alpha_c) of the passive caster, rad/s."""

    swivel: float
    roll: float


class OffsetDifferentialKinematics:
    """Kinematics of the offset-differential chassis; motors in the order left, right, platform joint."""

    steered: tuple[int, ...] = (PLATFORM,)
    axes: tuple[str, ...] = PLANAR

    def __init__(
        self, *, wheel_radius: float, axle_offset: float, track: float, caster: CasterGeometry | None = None
    ) -> None:
        if axle_offset < MIN_AXLE_OFFSET:
            message = f"axle_offset = {axle_offset}: singular below {MIN_AXLE_OFFSET} m"
            raise GeometryError(message)
        if min(wheel_radius, track) <= 0.0:
            message = f"wheel_radius = {wheel_radius} and track = {track} must be positive"
            raise GeometryError(message)
        self._radius = wheel_radius
        self._offset = axle_offset
        self._lever = track / (2.0 * axle_offset)  # half track over offset: wheel speed per sideways speed
        self._caster = caster
        self._seen, self._seen_rows = 0.0, self._rows(0.0)  # the joint angle measured last, rad
        self._reach = ReachTable(self.matrix())

    def wheel_speeds(self, rates: Rates, positions: Sequence[float | None]) -> list[float] | None:
        """Inverse kinematics (Eqs. 11-12), rad/s; None while the joint angle is unknown."""
        phi = positions[PLATFORM]
        if phi is None:
            return None
        vx, vy, wz = rates
        (lx, ly), (rx, ry), (px, py) = self._rows(phi)
        return [lx * vx + ly * vy, rx * vx + ry * vy, px * vx + py * vy + wz]

    def twist(self, speeds: Sequence[float | None], positions: Sequence[float | None]) -> Estimate | None:
        """Forward kinematics; three wheels for three axes leave no residual."""
        twist = self.motion(speeds, positions)
        return None if twist is None else _estimate((twist, None, None, ()))

    def motion(self, speeds: Sequence[float | None], positions: Sequence[float | None]) -> Twist | None:
        """Forward kinematics (Eqs. 8-9): the same rows solved."""
        left, right, joint = speeds
        phi = positions[PLATFORM]
        if left is None or right is None or joint is None or phi is None:
            return None
        if phi != self._seen or phi == 0.0:  # the joint is measured more seldom than asked for; 0.0 equals -0.0
            self._seen, self._seen_rows = phi, self._rows(phi)
        (lx, ly), (rx, ry), (px, py) = self._seen_rows
        determinant = lx * ry - ly * rx
        vx = (left * ry - right * ly) / determinant
        vy = (right * lx - left * rx) / determinant
        return _twist((vx, vy, joint - px * vx - py * vy))

    def reach(self, usable: Sequence[bool]) -> Reach:
        """Three motors for three axes: every one is needed."""
        return self._reach.of(usable)

    def matrix(self, positions: Sequence[float] | None = None) -> Matrix:
        """Wheel matrix at this joint angle; None: the platform looks along the chassis."""
        (lx, ly), (rx, ry), (px, py) = self._rows(0.0 if positions is None else positions[PLATFORM])
        return (lx, ly, 0.0), (rx, ry, 0.0), (px, py, 1.0)

    def caster_rates(self, twist: Twist, *, phi: float, beta: float) -> CasterRates:
        """Rates of the passive caster swivelled to beta (Eqs. 6 and 7 with +d3 beta rate; n and u of science 0)."""
        if self._caster is None:
            message = "this robot has no caster"
            raise GeometryError(message)
        trail, position, radius = self._caster
        (sin_phi, cos_phi), (sin_beta, cos_beta) = sin_cos(phi), sin_cos(beta)
        sin_heading, cos_heading = sin_cos(beta - phi)
        chassis_rate = (sin_phi * twist.vx + cos_phi * twist.vy) / self._offset
        lateral = cos_heading * twist.vx + sin_heading * twist.vy
        along = sin_heading * twist.vx - cos_heading * twist.vy
        swivel = -(lateral + (trail + position * sin_beta) * chassis_rate) / trail
        return CasterRates(swivel, (along - position * cos_beta * chassis_rate) / radius)

    def _rows(self, phi: float) -> tuple[tuple[float, float], tuple[float, float], tuple[float, float]]:
        """Rad/s of left, right and joint per m/s of (vx, vy); the joint adds wz itself."""
        s, c = sin_cos(phi)
        ex, ey, nx, ny = c / self._radius, -s / self._radius, s / self._radius, c / self._radius
        k = self._lever
        return (
            (ex - k * nx, ey - k * ny),
            (ex + k * nx, ey + k * ny),
            (-s / self._offset, -c / self._offset),
        )
