"""The no-slip launch: speeding up and slowing down as hard as the floor lets the wheels, and no harder.

How this works
--------------
Before the limits of the body the law tells which share of their acceleration the floor bears in the direction of the
way (`gateway.control.grip`), so the setpoint keeps its direction and asks for no more. After them it adds to each
wheel's speed the torque of its share of that push. Shares are by load where the wheels have a choice: those at which
the wheels reach their limits together, taken in proportion. What a wheel is told depends on what its motor can be told:
- a torque besides its speed (a speed loop on the host): the share as feed-forward, constant current while the
  acceleration is constant, and a limit at its grip. Nothing has to be handed over: its speed is controlled all
  the while, and the share fades with the acceleration;
- a voltage: steps of Rojas 2005, section 8, the voltage of the share on top of the back-EMF of the measured speed, new
  in each cycle, as long as the wheels follow; then a speed again, from how fast they turn;
- nothing but a speed: the ramp, with the limit where it can be told.

A launch that slips all the same backs off (`gateway.control.launch_slip`): what the floor gave is the friction from
then on, until the process ends. A stop that nobody commanded is never made longer for the sake of grip, and no
torque is limited in it.
"""

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from drivers.records import maker
from drivers.setpoint import CommandKind
from gateway.control.drive_law import Features, JointCommand, Measured, Motion, SpeedLaw
from gateway.control.grip import Cone, Grip, Three, part_of, room
from gateway.control.launch_slip import LaunchSlip, Losses, Told
from gateway.control.limits import TURNING_SHARE, Ground, excess
from gateway.control.posture import Posture
from gateway.control.transmission import Winding
from gateway.types import Event, Facts, Level, Rates, Region

LEAST_FRICTION: Final = 0.05  # of the load, of rollers on a floor
MOST_FRICTION: Final = 2.0
FRICTION: Final = "friction"  # facts of the chassis in `state`: as it is taken to be ...
LAUNCH: Final = "launch"  # ... and whether it is launched
LOOKS: Final = "launch_looks"  # ... and how often its wheels were looked at in the full push of a launch
SLIPPED: Final = "launch_slipped"  # the event
MARGIN: Final = 0.965  # of what the floor gives, that is asked of it
LEAST_EFFORT: Final = 0.02  # of the acceleration limits, left where a curve takes all that the floor gives
LEAST_LEARNED: Final = 0.25  # of the friction in the robot file: with less, commanded braking would hardly brake
_QUIET: Final = 0.01  # of the acceleration limits: less is no push
_ACTIVE: Final = 0.05  # of them: more is a launch
_JUMP: Final = 1.2  # of them: so fast the setpoint does not move, it was put elsewhere
_SAME_WAY: Final = 1e-6  # of a direction
_ROUNDING: Final = 1e-9  # m/s^2
SAFE: Final = 0.95  # of what it gave, that is asked of it from then on
_FOLLOWING: Final = 0.05  # of top speed: wheels further from their setpoint do not follow their voltages
HOLD_TIME: Final = 0.3  # s after a launch in which a wheel that is behind gets no more torque than it grips
_BELOW: Final = 0.9  # of the torque that a wheel may have: with less, it is not held back
_CAUGHT_UP: Final = 0.005  # of top speed, where no torque is told
_NONE: Three = (0.0, 0.0, 0.0)
_made: Final = maker(Told)
_VELOCITY: Final = CommandKind.VELOCITY
_VOLTAGE: Final = CommandKind.VOLTAGE


class Pusher(NamedTuple):
    """What a motor can be told of a push: a torque besides its speed, a limit; `torque`: N m that it has at its output.

    `hosted`: its speed loop is here, and compares with what was measured before the cycle. `winding`: of one that is
    told voltages instead, as of its output, up to `supply` V.
    """

    feed_forward: bool
    limit: bool
    hosted: bool
    torque: float
    winding: Winding | None = None
    supply: float = 0.0


class Sharing(NamedTuple):
    """One way to push, and how; all of it per unit of the way. `part`: of what the floor gives.

    Of each wheel: `torques` N m for the floor, `rates` rad/s^2, and `shifts` N m of what it may push more or less.
    """

    way: Three
    part: float
    torques: tuple[float, ...]
    rates: tuple[float, ...]
    shifts: tuple[float, ...]


def stepped_voltage(start: float, back_emf: float, most: float) -> float:
    """V of an interval: `start`, that of the torque, on top of the back-EMF, within `most` (Rojas 2005, section 8)."""
    return max(-most, min(most, start + back_emf))


class LaunchLaw:
    """Every joint at its speed, pushed as hard as its wheel grips. State owner: what it told, friction learned."""

    def __init__(
        self,
        speeds: SpeedLaw,
        *,
        grip: Grip,
        friction: float,
        radii: Sequence[float],
        losses: Losses,
        acceleration: Rates,
        top_speeds: Sequence[float],
        pushers: Sequence[Pusher],
    ) -> None:
        """`radii` m; `acceleration`: limits of the body; `top_speeds` rad/s."""
        self._speeds = speeds
        self._grip = grip
        self._given = friction
        self._radii = tuple(radii)
        self._losses = losses
        self._acceleration = acceleration
        self._top_speeds = tuple(top_speeds)
        self._pushers = tuple(pushers)
        self._able = tuple([(pusher.feed_forward, pusher.limit, pusher.hosted) for pusher in pushers])
        self._features = speeds.features._replace(grip=True)
        self._rows = tuple([(a / r, b / r, c / r) for (a, b, c), r in zip(grip.rows, radii, strict=True)])
        self._still = (0.0,) * len(radii)
        self._free: tuple[float | None, ...] = (None,) * len(radii)
        self._steps = any(pusher.winding is not None for pusher in pushers)
        self._lifting = grip.lifting()
        self._whole = True
        self._driven: Rates | None = None  # the last setpoint; None: nothing to tell an acceleration from
        self._told: Told | None = None  # in the last cycle; None: nothing was pushed
        self._turning: Sequence[float] | None = None  # rad/s of the last setpoint; None: it was put elsewhere since
        self._slip = LaunchSlip(
            grip,
            radii=radii,
            losses=losses,
            top_speeds=top_speeds,
            led=[pusher.feed_forward or pusher.winding is not None for pusher in pushers],
            period=speeds.period,
        )
        self._held = 0.0  # s for which the torques stay bounded
        self._stepped = False  # voltages were told in the last cycle
        self._followed = True  # no wheel was far from its setpoint under voltages since rest
        self._push: Sharing
        self._standing: tuple[
            Told, Told, list[float]
        ]  # bounds of wheels that stand, N m; the same all through a launch
        self._learn(friction)

    @property
    def facts(self) -> Facts:
        """Friction as it is taken to be, whether it is launched, and how often that was looked at for slip."""
        launch = self._told is not None and self._told.launch
        return {FRICTION: self.friction, LAUNCH: launch, LOOKS: float(self._slip.looks)}

    @property
    def features(self) -> Features:
        """Twists, and what the floor gives."""
        return self._features

    @property
    def posture(self) -> Posture | None:
        """It stands by itself."""
        return None

    @property
    def settings(self) -> Mapping[str, float]:
        """Friction, as it is taken to be."""
        return {FRICTION: self.friction}

    def set(self, name: str, value: float) -> str | None:
        """Another friction; what was learned of the floor is forgotten."""
        self._given = value
        self._learn(value)
        return None

    @property
    def unready(self) -> str | None:
        """Nothing."""
        return None

    def width_rate(self, width: float) -> float:
        """It knows no width."""
        return 0.0

    def aim(self, target: Rates, measured: Measured, *, region: Region, path_rate: float | None, whole: bool) -> Rates:
        """All of it."""
        return target

    def ground(self, *, whole: bool) -> Ground:
        """Itself."""
        self._whole = whole
        return self

    def turning(self, rates: Rates) -> float:
        """How many times the share for turning of what the floor gives the w x v of a steady twist takes."""
        vx, vy, wz = rates
        return 0.0 if wz == 0.0 else part_of(self._limits, (-wz * vy, wz * vx, 0.0)) / TURNING_SHARE

    def effort(self, rates: Rates, way: Rates, beside: Rates) -> float:
        """The share of the acceleration limits that the floor bears this way, on top of w x v and what there is."""
        size = excess(way, self._acceleration)
        if size == 0.0:
            return 1.0
        unit = (way[0] / size, way[1] / size, way[2] / size)
        vx, vy, wz = rates
        ax, ay, az = beside
        if wz == ax == ay == az == 0.0:
            given = MARGIN / self._push_along(unit).part
        else:
            given = MARGIN * room(self._limits, (ax - wz * vy, ay + wz * vx, az), unit)
        return max(LEAST_EFFORT, min(given, 1.0))

    def motion(self, setpoint: Rates, measured: Measured, *, braking: bool, path_rate: float | None = None) -> Motion:
        """Commands for this setpoint."""
        speeds, share = self._speeds.speeds_at(setpoint, measured.angles, braking=braking)
        if share < 1.0:
            setpoint = (setpoint[0] * share, setpoint[1] * share, setpoint[2] * share)
        before, expected = self._told, self._expected(measured, speeds)
        events: tuple[Event, ...] = ()
        if before is not None and before.launch and setpoint[2] == 0.0:
            events = self._backed_off(before, expected, measured)
            if events:  # the setpoint went on while wheels slipped: it goes on from how they turn
                back = _turned(speeds, measured.speeds)
                share, speeds = share * back, [speed * back for speed in speeds]
                expected = speeds
                setpoint = (setpoint[0] * back, setpoint[1] * back, setpoint[2] * back)
        else:
            self._slip.forget()
        told = self._told = self._push_for(setpoint, measured.dt, braking=braking)
        self._turning = speeds
        if self._steps:
            speeds, back = self._handed_over(setpoint, speeds, measured.speeds)
            share, expected = share * back, expected if back == 1.0 else speeds
        bounds = self._bounds_now(told, before, speeds, expected, measured, braking=braking)
        if told is None and bounds is self._free:
            commands = _velocities(speeds)
        else:
            commands = self._commands(told or self._rest, speeds, expected, bounds)
        if self._stepped and told is not None:
            commands = self._voltages(commands, told, measured.speeds)
        return Motion(commands, share, _limits(share), (), events)

    def stop(self, measured: Measured) -> Motion:
        """Every joint braked, with all that it has."""
        self.forget_told()
        return self._speeds.stop(measured)

    def moves(self, measured: Measured, *, turning: bool | None) -> bool | None:
        """It stands when its wheels do."""
        return self._speeds.moves(measured, turning=turning)

    def may_release(self, measured: Measured) -> bool:
        """It stands by itself."""
        return self._speeds.may_release(measured)

    def forget_told(self) -> None:
        """The next setpoint tells of no acceleration."""
        self._driven = self._told = self._turning = None
        self._stepped = False
        self._held = 0.0

    # the push

    def _gained(self, setpoint: Rates, dt: float) -> tuple[Three, float]:
        """Acceleration of the setpoint since the last cycle, and its size; none where it was put elsewhere."""
        before, self._driven = self._driven, setpoint
        if before is None or dt <= 0.0 or before == setpoint:
            return _NONE, 0.0
        gained = ((setpoint[0] - before[0]) / dt, (setpoint[1] - before[1]) / dt, (setpoint[2] - before[2]) / dt)
        size = excess(gained, self._acceleration)
        return (gained, size) if size <= _JUMP else (_NONE, 0.0)

    def _push_along(self, way: Three) -> Sharing:
        """How to push that way; that of before is kept as long as it is the same, as in a launch straight on."""
        x, y, z = self._push.way
        if abs(way[0] - x) > _SAME_WAY or abs(way[1] - y) > _SAME_WAY or abs(way[2] - z) > _SAME_WAY:
            self._push = self._sharing(way)
        return self._push

    def _sharing(self, way: Three) -> Sharing:
        """In the cone that the way is in."""
        x, y, z = way
        most, found = 0.0, 0
        for index, (a, b, c) in enumerate(self._cones):
            part = a * x + b * y + c * z
            if part > most:
                most, found = part, index
        torques = tuple([a * x + b * y + c * z for a, b, c in self._torques[found]])
        rates = tuple([a * x + b * y + c * z for a, b, c in self._rows])
        shifts = tuple([a * x + b * y for a, b in self._shifts])
        return Sharing(way, max(most, part_of(self._lifting, way)), torques, rates, shifts)

    def _push_for(self, setpoint: Rates, dt: float, *, braking: bool) -> Told | None:
        """What the wheels are to push for this setpoint, for speeding up and for turning; None: nothing."""
        if not self._whole:
            self._driven = None
            return None
        gained, size = self._gained(setpoint, dt)
        vx, vy, wz = setpoint
        x, y, z = gained if size > _QUIET else _NONE
        felt, much = (x, y, z), size
        if wz != 0.0:
            felt = (x - wz * vy, y + wz * vx, z)
            much = excess(felt, self._acceleration)
        elif size <= _QUIET:
            return None
        if much == 0.0:
            return None
        launch = size > _ACTIVE and not braking
        before = self._told
        if before is not None and wz == 0.0 and before.launch is launch and _same(felt, before.felt):
            return before
        push = self._push_along((felt[0] / much, felt[1] / much, felt[2] / much))
        if wz == 0.0:
            rates = tuple([rate * much for rate in push.rates])
        else:
            rates = tuple([a * x + b * y + c * z for a, b, c in self._rows])
        part, inertia = push.part * much, self._losses.inertia
        pushed = much if part <= 1.0 else much / part  # a stop that nobody commanded: what is not given nobody pushes
        torques = tuple([torque * pushed + inertia * rate for torque, rate in zip(push.torques, rates)])
        bears = tuple([rest + shift * much for rest, shift in zip(self._bears, push.shifts)])
        return _made((torques, felt, rates, bears, launch))

    def _expected(self, measured: Measured, speeds: Sequence[float]) -> Sequence[float]:
        """Rad/s that the wheels had when they were measured, by what they were told before; `speeds`: of now."""
        told, turning, dt = self._told, self._turning, measured.dt
        if turning is None:
            return speeds
        if told is None:
            return turning
        period_ns = dt * 1e9
        return [
            speed if age_ns is None else speed - rate * (age_ns * 1e-9 if age_ns < period_ns else dt)
            for speed, rate, age_ns in zip(turning, told.rates, measured.ages_ns)
        ]

    def _bounds_now(
        self,
        told: Told | None,
        before: Told | None,
        speeds: Sequence[float],
        expected: Sequence[float],
        measured: Measured,
        *,
        braking: bool,
    ) -> Sequence[float | None]:
        """N m that each wheel may have: in a launch, and after it until none is held back by that any more.

        Not for long: what a wheel cannot turn against then is to be seen by all of its torque.
        """
        if told is not None and told.launch:
            self._held = HOLD_TIME
        elif braking or not self._whole:
            self._held = 0.0
        if self._held <= 0.0:
            return self._free
        bounds = self._bounds(told or self._rest, before or self._rest, speeds)
        if told is None or not told.launch:
            self._held -= measured.dt
            if self._caught_up(bounds, expected, measured):
                self._held = 0.0
        return bounds

    def _caught_up(self, bounds: Sequence[float], expected: Sequence[float], measured: Measured) -> bool:
        """Whether more torque than that would change nothing."""
        return all(
            abs(torque) < _BELOW * bound if torque is not None else speed is None or abs(speed - due) < _CAUGHT_UP * top
            for bound, due, speed, torque, top in zip(
                bounds, expected, measured.speeds, measured.torques, self._top_speeds
            )
        )

    def _commands(
        self, told: Told, speeds: Sequence[float], expected: Sequence[float], bounds: Sequence[float | None]
    ) -> tuple[JointCommand, ...]:
        """Speeds with what the motors can be told besides.

        A speed loop that is here compares with what was measured before the cycle, so it is told what was due then.
        """
        return tuple(
            [
                JointCommand(_VELOCITY, then if hosted else speed, torque if able else 0.0, bound if limited else None)
                for speed, then, torque, bound, (able, limited, hosted) in zip(
                    speeds, expected, told.torques, bounds, self._able
                )
            ]
        )

    def _bounds(self, told: Told, before: Told, speeds: Sequence[float]) -> list[float]:
        """N m that each wheel may have: with which it slips, and what does not reach the floor.

        The load of a wheel is the least of this cycle and the one before: the robot follows a little later.
        """
        known, known_before, bounds = self._standing
        if known is not told or known_before is not before:
            inertia = self._losses.inertia
            bounds = [
                max(0.0, one if one < other else other) + inertia * abs(rate)
                for one, other, rate in zip(told.bears, before.bears, told.rates)
            ]
            self._standing = told, before, bounds
        _, friction, drag = self._losses
        return [bound + friction * (speed if speed > 0.0 else -speed) + drag for bound, speed in zip(bounds, speeds)]

    def _torques_of(self, cone: Cone) -> tuple[Three, ...]:
        """N m of each wheel per acceleration of the body, without its own inertia."""
        return tuple([(r * x, r * y, r * z) for r, (x, y, z) in zip(self._radii, cone.forces, strict=True)])

    # a launch that slips all the same

    def _learn(self, friction: float) -> None:
        """The floor is taken to give so much from now on."""
        self.friction = friction
        cones = self._grip.cones(friction)
        self._cones = tuple([cone.limit for cone in cones])
        self._limits = (*self._cones, *self._lifting)
        self._torques = tuple([self._torques_of(cone) for cone in cones])
        pairs = [(friction * r, shift) for r, shift in zip(self._radii, self._grip.shifts, strict=True)]
        self._shifts = tuple([(lever * x, lever * y) for lever, (x, y) in pairs])
        self._bears = tuple([lever * load for (lever, _), load in zip(pairs, self._grip.resting, strict=True)])
        self._rest = Told(self._still, _NONE, self._still, self._bears, launch=False)
        self._push = self._sharing((1.0, 0.0, 0.0))
        self._standing = self._rest, self._rest, [max(0.0, bears) for bears in self._bears]

    def _backed_off(self, told: Told, expected: Sequence[float], measured: Measured) -> tuple[Event, ...]:
        """Take the floor for worse once wheels have slipped; what is told of it."""
        before, least = self.friction, LEAST_LEARNED * self._given
        given = self._slip.look(told, expected, measured, before)
        if given is None or before <= least:
            return ()
        self._learn(max(least, SAFE * given))
        self._told = None
        text = f"wheels slipped: friction is taken for {self.friction:.2f}, no longer {before:.2f}"
        return (Event(Level.WARNING, SLIPPED, text),)

    # by voltage

    def _handed_over(
        self, setpoint: Rates, speeds: list[float], measured: Sequence[float | None]
    ) -> tuple[list[float], float]:
        """Whether voltages are told in this cycle; once no longer, the speeds from how fast the wheels turn."""
        told, follow, before = self._told, self._follow(speeds, measured), self._stepped
        if not any(setpoint):
            self._followed = True
        elif before and not follow:
            self._followed = False
        self._stepped = told is not None and told.launch and follow and self._followed
        if self._stepped or not before:
            return speeds, 1.0
        back = _turned(speeds, measured)
        speeds = [speed * back for speed in speeds]
        self._driven, self._turning = tuple([axis * back for axis in setpoint]), speeds
        return speeds, back

    def _follow(self, speeds: Sequence[float], measured: Sequence[float | None]) -> bool:
        """Whether every wheel turns about as fast as it is to."""
        return all(
            is_ is not None and abs(is_ - speed) <= _FOLLOWING * top
            for speed, is_, top in zip(speeds, measured, self._top_speeds)
        )

    def _voltages(
        self, commands: Sequence[JointCommand], told: Told, measured: Sequence[float | None]
    ) -> tuple[JointCommand, ...]:
        """The step of this interval for those that can be told it, and what the others are told."""
        return tuple(
            [
                command
                if pusher.winding is None or speed is None
                else JointCommand(_VOLTAGE, _step(pusher.winding, pusher.supply, torque, speed))
                for command, pusher, torque, speed in zip(commands, self._pushers, told.torques, measured)
            ]
        )


def _same(one: Three, other: Three) -> bool:
    """Whether these accelerations are the same but for rounding."""
    return abs(one[0] - other[0]) < _ROUNDING and abs(one[1] - other[1]) < _ROUNDING and one[2] == other[2]


def _velocities(speeds: Sequence[float]) -> tuple[JointCommand, ...]:
    return tuple([JointCommand(_VELOCITY, speed) for speed in speeds])


def _step(winding: Winding, supply: float, torque: float, speed: float) -> float:
    return stepped_voltage(winding.volts_per_torque * torque, winding.back_emf * speed, supply)


def _turned(speeds: Sequence[float], measured: Sequence[float | None]) -> float:
    """Share of their speeds that wheels turn, 0 to 1: what is to be told them so that none is told a step."""
    along = square = 0.0
    for speed, is_ in zip(speeds, measured):
        along += speed * (speed if is_ is None else is_)
        square += speed * speed
    return max(0.0, min(1.0, along / square)) if square > 0.0 else 1.0


def _limits(share: float) -> tuple[str, ...]:
    return () if share == 1.0 else ("motor_speed",)
