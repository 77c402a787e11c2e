"""Pose from measured wheel motion: displacement of the wheels, fitted to a rigid motion, integrated along its arc.

Displacements (not speeds) are integrated, so a late or lost frame costs nothing: the next one carries the way. The
covariance grows with the way driven and, where the wheels carry redundancy, with the motion they cannot explain: alike
along all axes while that is noise, and while wheels slip along the twists by which they put the motion wrong.
Where a gyro tells the heading, the turn is the gyro's and the wheels tell the way only. Between two of its samples the
wheels tell the turn as well; the next sample puts the gyro's in its place, and where none comes the wheels' stands.
"""

from collections.abc import Sequence
from math import remainder, tau
from typing import Final

from drivers.records import maker
from gateway.arithmetic import sin_cos
from gateway.chassis.contract import ALIKE, Sideways
from gateway.kinematics.contract import Kinematics
from gateway.types import CHOSEN_GROWTH, NO_DISPLACEMENT, Displacement, Growth, Odometry, Pose, Twist

_pose: Final = maker(Pose)
_displacement: Final = maker(Displacement)
# A gyro's heading wanders with time and errs by its scale: 1 mrad after a second, 1 % of a turn of 1 rad.
# Source: chosen by us for an uncalibrated MEMS gyro.
_GYRO_VARIANCE_PER_SECOND: Final = 1e-6  # rad^2/s
_GYRO_VARIANCE_PER_RADIAN: Final = 1e-4  # rad^2/rad
_SLIP_CORRELATION: Final = 1.0  # s; a slip goes on for about so long, so its error adds up over that time
_SLIP_LEVER: Final = 0.25  # m; turns an unexplained rim speed into a yaw rate error
_LONGEST_GAP: Final = 0.5  # s; a controller that reports more rarely counts as silent anyway
_JUMP_FACTOR: Final = 2.0  # a displacement beyond this many times what top speed allows is a counter that restarted
_SMALL_ANGLE: Final = 0.01  # rad; below it the series are exact but for the last bit, and 1 - cos is not

Spread = tuple[float, float, float, float, float, float]  # xx, xy, xt, yy, yt, tt
Covariance = tuple[float, float, float, float, float, float, float, float, float]
# Nobody starts a pose graph with certainty: 1 mm and 1 mrad keep the matrix positive definite (filters invert it).
_FIRST_VARIANCE: Final = 1e-6  # m^2, m^2, rad^2
# Not final: mypyc leaves a final tuple of floats unset.
_FIRST_COVARIANCE: Covariance = (_FIRST_VARIANCE, 0.0, 0.0, 0.0, _FIRST_VARIANCE, 0.0, 0.0, 0.0, _FIRST_VARIANCE)


def advance(pose: Pose, way: Displacement) -> Pose:
    """The pose after a displacement along the exact arc of constant velocity (SE(2) exponential)."""
    dx, dy, turn = way
    if abs(turn) < _SMALL_ANGLE:
        square = turn * turn
        along = 1.0 + square * (-1 / 6 + square / 120.0)
        across = turn * (0.5 + square * (-1 / 24 + square / 720.0))
    else:
        s, c = sin_cos(turn)
        along, across = s / turn, (1.0 - c) / turn
    forward, left = along * dx - across * dy, across * dx + along * dy
    x, y, theta = pose
    s, c = sin_cos(theta)
    return _pose((x + c * forward - s * left, y + s * forward + c * left, theta + turn))


class WheelOdometry:
    """Integrates output positions (rad) of the driven joints; one writer, the engine.

    `sideways`: how much more than forward the chassis errs that way; `growth`: how much it errs forward.
    """

    def __init__(
        self,
        kinematics: Kinematics,
        *,
        top_speeds: Sequence[float],
        sideways: Sideways = ALIKE,
        growth: Growth = CHOSEN_GROWTH,
    ) -> None:
        self._kinematics = kinematics
        self._growth = growth
        self._sideways = sideways
        self._top_speeds = tuple(top_speeds)
        self._positions: list[float | None] = [None] * len(self._top_speeds)
        self._seen_ns: list[int] = [0] * len(self._top_speeds)  # cycles of the newest measurements
        self._last_ns = 0
        self._unseen: set[int] = set()  # joints that fell silent since their position was last known
        self.pose = Pose(0.0, 0.0, 0.0)
        self._jumped: list[int] = []
        self._covariance: Covariance = _FIRST_COVARIANCE
        self._reference = self.pose  # pose at which the covariance was last brought up to date
        self._heading: float | None = None  # of the gyro, in the cycle before
        # Since then: what errs in position, and what errs in heading (the wheels' share of it, and the gyro's).
        self._way = 0.0
        self._slip_variance = 0.0  # integral of residual^2 dt, m^2/s
        self._slip_spread = (0.0, 0.0, 0.0, 0.0, 0.0)  # xx, xy, xt, yy, yt in the world: m^2/s, m rad/s
        self._turned = 0.0
        self._turning_way = 0.0
        self._turning_slip_variance = 0.0
        self._gyro_variance = 0.0  # rad^2
        # Since the last sample of the gyro: what the wheels turned the pose, and the variance of that.
        self._bridged = 0.0
        self._bridge_variance = 0.0
        self._bridge_time = 0.0

    def deltas(
        self, positions: Sequence[float | None], ages_ns: Sequence[int | None], now_ns: int
    ) -> tuple[list[float | None], list[int]]:
        """Way of every joint since the last call, rad, and the joints that moved further than they can turn.

        `ages_ns`: of the positions; how far a joint can turn counts from its last measurement, also from one at rest.
        The way of a joint that was silent is unknown and left out: its controller may have counted from zero again.
        """
        self._jumped = []
        fresh_ns, self._last_ns = now_ns - self._last_ns, now_ns
        deltas: list[float | None] = []
        for index, (position, age_ns) in enumerate(zip(positions, ages_ns)):
            if position is None or position != self._positions[index]:
                deltas.append(self._delta(index, position, now_ns))
                continue
            deltas.append(0.0)
            if age_ns is not None and age_ns < fresh_ns:
                self._seen_ns[index] = now_ns
        return deltas, self._jumped

    def forget(self, index: int) -> None:
        """The next position of this joint is a new reference."""
        self._positions[index] = None

    def forget_heading(self) -> None:
        """The next heading only tells where it counts from."""
        self._heading = None

    def update(  # what is known of one cycle
        self,
        deltas: Sequence[float | None],
        angles: Sequence[float | None],
        *,
        residual: float | None,
        dt: float,
        heading: float | None = None,
        fresh: bool = True,
        spread: Spread | None = None,
        beside: float = 0.0,
    ) -> None:
        """Move by the ways of this cycle. `angles`: those of untrusted steered joints are None; `residual`: m/s.

        `heading`: of a gyro, rad, from any zero and wrapped or not; None while it is silent. Its change since the
        sample before is the turn, in place of that of the wheels; the first one only tells where it counts from.
        `fresh`: it is of this cycle; what is not fresh says only that the gyro is not silent.
        `spread`: variances of the twist in the frame of the body, of wheels that slip; then the residual says nothing.
        `beside`: m along axes beyond the twist, which errs as a way to the side does.
        """
        self._beside(abs(beside), turns=heading is None)
        way = self._displacement(deltas, angles) if any(deltas) else None
        if spread is None:
            slip_variance = residual * residual * dt if residual else 0.0
            self._slip_variance += slip_variance
        else:
            slip_variance = self._spread(spread, dt, turns=heading is None)
        if heading is not None and self._heading is not None and not fresh:
            self._bridge(way or NO_DISPLACEMENT, slip_variance, dt)
            return
        turn = self._turn(heading)
        if way is not None or turn:
            self._move(way or NO_DISPLACEMENT, turn)
        if turn is None:
            self._turning_slip_variance += slip_variance
            self._gyro_variance += self._bridge_variance  # the turn of the wheels stands
        else:
            elapsed = self._bridge_time + dt
            self._gyro_variance += _GYRO_VARIANCE_PER_SECOND * elapsed
            self._gyro_variance += _GYRO_VARIANCE_PER_RADIAN * abs(self._bridged + turn)
        self._bridged = self._bridge_variance = self._bridge_time = 0.0

    def read(self, twist: Twist | None, residual: float | None) -> Odometry:
        """Pose with its covariance brought up to date."""
        self._grow()
        return Odometry(self.pose, twist, self._covariance, residual)

    def _delta(self, index: int, position: float | None, now_ns: int) -> float | None:
        before = self._positions[index]
        if position is None:
            self._unseen.add(index)
            return None
        if index in self._unseen:
            self._unseen.discard(index)
            before = None
        elapsed = (now_ns - self._seen_ns[index]) * 1e-9
        self._positions[index], self._seen_ns[index] = position, now_ns
        if before is None:
            return None
        delta = position - before
        longest = _JUMP_FACTOR * self._top_speeds[index]  # rad per s
        if abs(delta) > longest * (elapsed if elapsed < _LONGEST_GAP else _LONGEST_GAP):
            self._jumped.append(index)
            return None
        return delta

    def _turn(self, heading: float | None) -> float | None:
        """What the gyro turned since its last sample beyond the bridge, rad within half a turn; None: unknown."""
        before, self._heading = self._heading, heading
        return None if heading is None or before is None else remainder(heading - before - self._bridged, tau)

    def _spread(self, spread: Spread, dt: float, *, turns: bool) -> float:
        """Keep what slip does to the position; what it does to the heading is given back, as at its lever: m^2/s.

        `turns`: the heading is that of the wheels, and so errs together with the position.
        """
        xx, xy, xt, yy, yt, tt = spread
        s, c = sin_cos(self.pose.theta)
        before_xx, before_xy, before_xt, before_yy, before_yt = self._slip_spread
        along, across = (xt, yt) if turns else (0.0, 0.0)
        self._slip_spread = (
            before_xx + dt * (c * c * xx - 2.0 * s * c * xy + s * s * yy),
            before_xy + dt * (s * c * (xx - yy) + (c * c - s * s) * xy),
            before_xt + dt * (c * along - s * across),
            before_yy + dt * (s * s * xx + 2.0 * s * c * xy + c * c * yy),
            before_yt + dt * (s * along + c * across),
        )
        return tt * _SLIP_LEVER * _SLIP_LEVER * dt

    def _beside(self, way: float, *, turns: bool) -> None:
        """What a way along other axes puts wrong; `turns`: also the heading, which is the wheels'."""
        self._way += self._sideways.position * way
        if turns:
            self._turning_way += self._sideways.heading * way

    def _bridge(self, way: Displacement, slip_variance: float, dt: float) -> None:
        """Move as the wheels have it, until the gyro tells more."""
        self._way += abs(way.x) + self._sideways.position * abs(way.y)
        turning_way = abs(way.x) + self._sideways.heading * abs(way.y)
        self._bridged += way.turn
        self._bridge_variance += self._turning_variance(abs(way.turn), turning_way, slip_variance)
        self._bridge_time += dt
        if way != NO_DISPLACEMENT:
            self.pose = advance(self.pose, way)

    def _displacement(self, deltas: Sequence[float | None], positions: Sequence[float | None]) -> Displacement | None:
        """Of the body, as the wheels have it; None where they do not determine it."""
        if self._kinematics.steered:  # the geometry of mid-way serves the whole way to second order
            positions = [
                None if position is None else position - 0.5 * (delta or 0.0)
                for position, delta in zip(positions, deltas)
            ]
        way = self._kinematics.motion(deltas, positions)
        return None if way is None else _displacement(way)

    def _move(self, way: Displacement, turn: float | None) -> None:
        dx, dy, turned = way
        self._way += abs(dx) + self._sideways.position * abs(dy)
        if turn is None:
            self._turned += abs(turned)
            self._turning_way += abs(dx) + self._sideways.heading * abs(dy)
            self.pose = advance(self.pose, way)
        else:
            self.pose = advance(self.pose, _displacement((dx, dy, turn)))

    def _grow(self) -> None:
        """P <- F P F' + Q for the motion since the last call; F moves the lever of the heading error."""
        dx, dy = self.pose.x - self._reference.x, self.pose.y - self._reference.y
        slip = self._slip_variance * _SLIP_CORRELATION
        across = self._growth.position * self._way + slip
        turned, way = self._turned, self._turning_way
        heading = self._turning_variance(turned, way, self._turning_slip_variance) + self._gyro_variance
        xx, xy, xt, _, yy, yt, _, _, tt = self._covariance
        new_xx = xx - 2.0 * dy * xt + dy * dy * tt + across
        new_xy = xy + dx * xt - dy * yt - dx * dy * tt
        new_yy = yy + 2.0 * dx * yt + dx * dx * tt + across
        new_xt, new_yt, new_tt = xt - dy * tt, yt + dx * tt, tt + heading
        slip_xx, slip_xy, slip_xt, slip_yy, slip_yt = [_SLIP_CORRELATION * part for part in self._slip_spread]
        new_xx, new_xy, new_xt = new_xx + slip_xx, new_xy + slip_xy, new_xt + slip_xt
        new_yy, new_yt = new_yy + slip_yy, new_yt + slip_yt
        self._covariance = (new_xx, new_xy, new_xt, new_xy, new_yy, new_yt, new_xt, new_yt, new_tt)
        self._reference, self._way, self._slip_variance = self.pose, 0.0, 0.0
        self._slip_spread = (0.0, 0.0, 0.0, 0.0, 0.0)
        self._turned = self._turning_way = self._turning_slip_variance = self._gyro_variance = 0.0

    def _turning_variance(self, turned: float, way: float, slip_variance: float) -> float:
        """Of a turn that the wheels tell, rad^2."""
        return (
            self._growth.heading_turning * turned
            + self._growth.heading_driving * way
            + slip_variance * _SLIP_CORRELATION / (_SLIP_LEVER * _SLIP_LEVER)
        )
