"""Whether a robot that would fall is up, may be put up, is let down, or has fallen.

How this works
--------------
Down is how it begins and what it comes back to; nothing but a person's request leads away from it. Asked to stand up,
it waits for its driver as any other robot does, as long as somebody can be expected to hold it: READY. What is
then armed balances: UP. Asked to let itself down, at rest and without a driver, it gives way within a second to whoever
holds it. If it leans too far, or nobody knows how far, it has fallen: it lets go at once and is down.
"""

from enum import Enum
from typing import Final

from gateway.types import Attitude

READY_NS: Final = 10_000_000_000  # for so long after the request somebody holds it
LOWERING_NS: Final = 1_000_000_000
BLIND_NS: Final = 40_000_000  # without news of its pitch it goes on for so long by what was last known
STUCK_NS: Final = 200_000_000  # a body that balances sways: what tells the very same for so long hangs
FALLING_NS: Final = 1_000_000_000  # a fall lasts at least so long


class Stance(Enum):
    """How it stands."""

    DOWN = "down"
    READY = "ready"
    UP = "up"
    LOWERING = "lowering"


_DOWN: Final = Stance.DOWN
_READY: Final = Stance.READY
_UP: Final = Stance.UP
_LOWERING: Final = Stance.LOWERING


class Posture:
    """State owner; the engine writes. `catch`: rad of pitch from which it comes up, `fall`: beyond which it falls."""

    def __init__(self, *, catch: float, fall: float) -> None:
        self._catch = catch
        self._fall = fall
        self._since_ns = 0
        self._now_ns = 0
        self._seen_ns = 0  # when how it leans was last known
        self._told: Attitude | None = None  # by the sensor, and since when the very same
        self._told_ns = 0
        self.attitude: Attitude | None = None
        self.stance = _DOWN
        self.fallen: str | None = None  # how, from the fall until it lies still
        self.whole = True  # every motor obeys; the engine's, as of the cycle before

    @property
    def stands(self) -> bool:
        """Whether its motors keep it from falling."""
        return self.stance in {_UP, _LOWERING}

    @property
    def strength(self) -> float:
        """Share of their torque that the motors may use, 0 to 1."""
        if self.stance is not _LOWERING:
            return 1.0
        return max(1.0 - (self._now_ns - self._since_ns) / LOWERING_NS, 0.0)

    def look(self, attitude: Attitude | None, now_ns: int) -> None:
        """Take how it leans in this cycle; None: not known."""
        self._now_ns = now_ns
        if attitude is None or attitude != self._told:
            self._told, self._told_ns = attitude, now_ns
        elif self.stands and now_ns - self._told_ns > STUCK_NS:
            attitude = None
        if _tells(attitude) or not self.stands or now_ns - self._seen_ns > BLIND_NS:
            self._seen_ns, self.attitude = now_ns, attitude
        if (self.stance is _READY and now_ns - self._since_ns > READY_NS) or (
            self.stance is _LOWERING and now_ns - self._since_ns >= LOWERING_NS
        ):
            self.stance = _DOWN
        elif self.stands:
            how = self._falls()
            if how is not None:
                self.stance, self._since_ns, self.fallen = _DOWN, now_ns, how

    def objection(self) -> str | None:
        """Why it is not to be armed now, in words; None: it may be."""
        leaning = self._not_upright()
        if self.stance is _READY and leaning is None:
            return None
        if self.stance is _READY:
            return f"hold it upright: {leaning}"
        return "it is down: hold it upright and ask it to stand up"

    def stand_up(self) -> str | None:
        """Somebody holds it and wants it to balance; why not, if not."""
        if self.stands:
            return "it stands"
        leaning = self._not_upright()
        if leaning is not None:
            return f"hold it upright: {leaning}"
        self.stance, self._since_ns = _READY, self._now_ns
        return None

    def let_down(self) -> str | None:
        """Somebody holds it and wants it to let go; why not, if not. Only of a robot at rest without a driver."""
        if not self.stands:
            return "it does not stand"
        if self.stance is _UP:
            self.stance, self._since_ns = _LOWERING, self._now_ns
        return None

    def rise(self) -> None:
        """Its motors are being armed."""
        self.stance = _UP

    def rest(self) -> None:
        """Its motors were let go."""
        self.stance = _DOWN

    def lies(self) -> None:
        """Its wheels stand: a fall that began a while ago is over."""
        if self._now_ns - self._since_ns >= FALLING_NS:
            self.fallen = None

    def _falls(self) -> str | None:
        attitude = self.attitude
        if attitude is None or not _tells(attitude):
            return "how it leans is not known any more"
        if abs(attitude.pitch) > self._fall:
            return f"pitch = {attitude.pitch:.2f} rad: must be from {-self._fall:g} to {self._fall:g}"
        return None

    def _not_upright(self) -> str | None:
        attitude = self.attitude
        if attitude is None:
            return "no sensor tells how it leans"
        if attitude.pitch_rate is None:
            return "the sensor of its attitude does not tell pitch_rate"
        if abs(attitude.pitch) > self._catch:
            return f"pitch = {attitude.pitch:.2f} rad: must be from {-self._catch:g} to {self._catch:g}"
        return None


def _tells(attitude: Attitude | None) -> bool:
    return attitude is not None and attitude.pitch_rate is not None
