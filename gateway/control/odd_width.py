"""How wide a chassis is whose wheels go apart: by its wheels, by a sensor, and what may be done while they differ.

How this works
--------------
Without a sensor the width is what the wheels add up to from that of the robot file.

With one it is unknown until the sensor has told the same for STEADY_S, within the range of the width, while the robot
is released and its wheels do not change the width. From then on the wheels carry it from cycle to cycle, and the sensor
draws it. A sample further from it than a gate and the doubt of the wheels is none: nothing goes there in no time, so
the sensor jumped. While it is silent, or has jumped, the wheels alone tell the width: at a share of the rate, and each
end of the range nearer by what they may be off, which grows with way and time, and fast where they tell nothing either;
after BLIND_WAY or BLIND_S the width is held. Once the sensor tells what the wheels do, it is believed again.

What the wheels alone have added up to shows whether the two agree over a way (FORGET_WAY). Where they differ by DISPUTE
either the wheels slip, a slide is stuck, or the wire is caught, and nothing here can tell which: the width is that of
the sensor, and held, until they agree again. At rest and released what the sensor tells is taken as at the start,
whatever was before.
"""

from typing import Final, NamedTuple

from gateway.types import Event, Level

CORRECTION: Final = 12.5  # per s, of what the sensor tells otherwise: noise of it is averaged over 0.1 s
GATE: Final = 0.015  # m, besides what a slide that is stuck puts between the two; source: ours, noise and delay
DISPUTE: Final = 0.05  # m; source: ours, a slip of a seventh on all of a range of 0.35 m
AGREED: Final = 0.5  # of DISPUTE, from where on they agree again
FORGET_WAY: Final = 0.4  # m; so a slip of a tenth is no dispute, and standing still does not end one
STEADY_S: Final = 0.2
STEADY: Final = 0.005  # m
AT_REST: Final = 0.005  # m/s
OUTSIDE: Final = 0.01  # m beyond the range that a slide at its stop may tell
WHEELS_OFF: Final = 0.1  # of their way, that wheels may be off by; source: ours
DRIFT: Final = 0.001  # m/s, that a robot without a sensor may be pushed apart unseen; source: ours
UNSEEN: Final = 1.0  # m/s, at which wheels that tell nothing may go apart: they do what they were told last
BLIND_SHARE: Final = 0.5  # of the rate
BLIND_WAY: Final = 0.2  # m, of the width
BLIND_S: Final = 10.0

FROM_FILE: Final = "robot file and wheels"
SENSED: Final = "sensor"
BY_WHEELS: Final = "wheels"
HELD: Final = "wheels, held"
DISPUTED: Final = "sensor, held"
UNKNOWN: Final = "unknown"
_EVENTS: Final = {
    SENSED: (Level.INFO, "width_sensed"),
    BY_WHEELS: (Level.WARNING, "width_by_wheels"),
    HELD: (Level.WARNING, "width_held"),
    DISPUTED: (Level.WARNING, "width_disputed"),
}


class Freedom(NamedTuple):
    """How the width may change: the share of its rate, and by how much (m) each end of the range comes nearer."""

    share: float
    margin: float


FREE: Final = Freedom(1.0, 0.0)


class WidthEstimate:
    """State owner, all in m. `sensed`: there is a sensor of it; `by`: where the width is from, in words.

    `gate`: a sample further off is none; at least GATE and what the sensor is behind at the top rate (CORRECTION).
    """

    def __init__(self, metres: float, *, narrowest: float, widest: float, gate: float, sensed: bool) -> None:
        self._gate = gate
        self._narrowest = narrowest
        self._widest = widest
        self._sensor = sensed
        self.metres = metres
        self.doubt = 0.0
        self.by = UNKNOWN if sensed else FROM_FILE
        self._why = self._why_not(None)  # of what the sensor tells nothing is believed
        self._released = True
        self._steady_at = metres  # where the sensor began to tell the same, and for how long it has
        self._steady_s = 0.0
        self._wheels = metres  # what they alone would tell
        self._blind_s = 0.0
        self._blind_way = 0.0

    @property
    def freedom(self) -> Freedom:
        """How it may change now."""
        if self.by in (HELD, DISPUTED, UNKNOWN):
            return Freedom(0.0, self.doubt)
        return FREE if self.doubt == 0.0 else Freedom(BLIND_SHARE, self.doubt)

    @property
    def unready(self) -> str | None:
        """Why nothing may be driven yet; None: it may. Only of a robot that is released."""
        if self.by in (SENSED, FROM_FILE):
            return None
        return f"the width is not known: {self._why}"

    def release(self) -> None:
        """The wheels were let go: somebody may have moved them."""
        self._released = True
        self._steady_s = 0.0

    def drive(self) -> None:
        """The wheels are told to turn."""
        self._released = False

    def measure(self, rate: float | None, told: float | None, dt: float) -> tuple[Event, ...]:
        """Take a cycle: `rate`, m/s, as the wheels have it, and what the sensor tells; what there is to say of it."""
        before = self.by
        way = 0.0 if rate is None else rate * dt
        self.metres = self._within(self.metres + way)
        self._wheels += way
        if self._sensor:
            self._steady(told, rate, dt)
            self._judge(told, rate, dt)
        if self.by == before or self.by not in _EVENTS:
            return ()
        level, code = _EVENTS[self.by]
        return (Event(level, code, self._words()),)

    def _judge(self, told: float | None, rate: float | None, dt: float) -> None:
        if told is not None and self._released and self._steady_s >= STEADY_S and self._is_width(told):
            if self.by != SENSED:
                self._take(told)
        elif self.by == UNKNOWN:
            self._why = self._why_not(told)
            return
        if told is None or abs(told - self.metres) > self._gate + self.doubt:
            self._why = self._why_not(told)
            self._go_blind(rate, dt)
            return
        self._blind_s = self._blind_way = 0.0
        self.metres = self._within(self.metres + min(1.0, CORRECTION * dt) * (told - self.metres))
        self._wheels += min(1.0, abs(rate or 0.0) * dt / FORGET_WAY) * (told - self._wheels)
        if self.doubt > 0.0:
            self._wheels += min(max(told - self._wheels, -self.doubt), self.doubt)
            self.doubt = max(0.0, min(self.doubt, abs(told - self.metres) - self._gate))
        apart = abs(self._wheels - told)
        self.by = DISPUTED if apart > (AGREED * DISPUTE if self.by == DISPUTED else DISPUTE) else SENSED
        self._why = f"wheels and sensor are {apart:.3f} m apart: wheels slip, a slide is stuck, or the wire is caught"

    def _take(self, told: float) -> None:
        """What the sensor tells, at rest."""
        self.metres = self._wheels = self._within(told)
        self.doubt = 0.0
        self.by = SENSED

    def _go_blind(self, rate: float | None, dt: float) -> None:
        """By the wheels alone; where they tell nothing either it may soon be any width."""
        way = abs(rate or 0.0) * dt
        self._blind_s += dt
        self._blind_way += way
        doubt = self.doubt + (WHEELS_OFF * way + DRIFT * dt if rate is not None else UNSEEN * dt)
        self.doubt = min(doubt, self._widest - self._narrowest)
        self.by = HELD if self._blind_s > BLIND_S or self._blind_way > BLIND_WAY else BY_WHEELS

    def _steady(self, told: float | None, rate: float | None, dt: float) -> None:
        """For how long the sensor has told the same of wheels that stand."""
        moving = rate is not None and abs(rate) > AT_REST
        if told is None or moving or abs(told - self._steady_at) > STEADY:
            self._steady_s = 0.0
            self._steady_at = self.metres if told is None else told
        else:
            self._steady_s += dt

    def _why_not(self, told: float | None) -> str:
        if told is None:
            return "its sensor is silent"
        if not self._is_width(told):
            return f"its sensor tells {told:.3f} m, must be from {self._narrowest:g} to {self._widest:g} m"
        return "its sensor does not stand still yet" if self.by == UNKNOWN else "its sensor jumped"

    def _is_width(self, told: float) -> bool:
        return self._narrowest - OUTSIDE <= told <= self._widest + OUTSIDE

    def _within(self, metres: float) -> float:
        return min(max(metres, self._narrowest), self._widest)

    def _words(self) -> str:
        if self.by == SENSED:
            return f"the width is that of its sensor, {self.metres:.3f} m"
        if self.by == DISPUTED:
            return f"{self._why}; the width is held"
        held = "held" if self.by == HELD else "driven at half the rate, and not to the ends of its range"
        return f"{self._why}: the width, {self.metres:.3f} m, goes by the wheels and is {held}"
