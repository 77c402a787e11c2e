"""Who is on a bus, from what is heard of it: controllers, ids that nobody knows, and what does not fit together. Pure.

How this works
--------------
Every frame is shown to every protocol there is (`DriverType.sighted`). What a protocol would call a proof makes a
controller of it, unless its contents speak against it more often. One frame may prove controllers of two protocols, or
two kinds of one: then both are told, and so is that only one of them can be true. Of one id two controllers are seen
by their angles, which jump to and fro (`drivers.twins`), and where both stand alike by their rhythm: the frames of one
controller come at equal distances, those of two in turns near and far.
"""

from collections.abc import Collection, Iterable, Sequence
from itertools import pairwise
from typing import Final, NamedTuple

from drivers import DRIVERS
from drivers.contract import CanFrame, MotorSpec
from drivers.sighting import Evidence, Sighting
from drivers.twins import TwinWatch

TRUSTED: Final = 0.9  # of what is seen of an id, that must not speak against a controller
RHYTHMS_FROM_NS: Final = 5_000_000  # mean distance; in less, frames that waited for the bus look like two rhythms
LEAST_GAPS: Final = 8
UNEVEN: Final = 0.2  # of the mean, by which each distance differs from the next ...
EVEN: Final = 0.1  # ... while any two in a row make the same sum
STARVED: Final = 2.5  # mean distances: a longer one says that frames were lost
KEPT: Final = 256  # arrivals of an id and of one message
Known = tuple[str, str, int]  # driver, variant, id
_TOP_SPEED: Final = 1000.0  # rad/s at a shaft, of a motor not known; a robot is scanned while it stands


class Found(NamedTuple):
    """A controller. `told`: what it tells of itself, newest last said; `commanded`: a host tells it something."""

    driver: str
    variants: tuple[str, ...]
    id: int
    can_ids: tuple[tuple[int, bool], ...]  # of the proofs; whether extended
    rate_hz: float | None  # of its most frequent proof
    told: tuple[tuple[str, str], ...]
    commanded: bool

    @property
    def name(self) -> str:
        """In words."""
        kinds = "/".join(self.variants)
        return f"{self.driver} id {self.id}" if kinds == self.driver else f"{self.driver} {kinds} id {self.id}"


class Unknown(NamedTuple):
    """An id that no protocol knows, with the last data seen."""

    can_id: int
    extended: bool
    rate_hz: float | None
    data: bytes


class Report(NamedTuple):
    """What was heard in `seconds`.

    `commanded`: in words, what may be a host that tells something to controllers that nobody heard.
    """

    seconds: float
    frames: int
    found: tuple[Found, ...]
    unknown: tuple[Unknown, ...]
    conflicts: tuple[str, ...]
    commanded: tuple[str, ...]


_Key = tuple[str, int, str]  # driver, id, numbering


class _Seen:
    """What is known of one id of one protocol."""

    def __init__(self, sighting: Sighting) -> None:
        self.variants = set(sighting.variants)
        self.counts = dict.fromkeys(Evidence, 0)
        self.can_ids: dict[tuple[int, bool], None] = {}
        self.commands: set[tuple[int, bool]] = set()
        self.told: dict[str, str] = {}
        self.arrivals: dict[str, list[int]] = {}  # by message
        self.twins: TwinWatch | None = None
        self.twin = False

    @property
    def proven(self) -> bool:
        """Whether there is such a controller, as far as its frames go."""
        proofs, against = self.counts[Evidence.PROOF], self.counts[Evidence.AGAINST]
        return proofs > 0 and proofs >= TRUSTED * (proofs + against)

    def take(self, sighting: Sighting, frame: CanFrame, received_ns: int) -> None:
        """One more frame."""
        self.counts[sighting.evidence] += 1
        self.told.update(sighting.told)
        if sighting.evidence is Evidence.COMMAND:
            self.commands.add((frame.id, frame.extended))
        if sighting.evidence is Evidence.PROOF:
            self.can_ids[frame.id, frame.extended] = None
            self.arrivals.setdefault(sighting.message, []).append(received_ns)
            del self.arrivals[sighting.message][:-KEPT]
        if sighting.evidence in (Evidence.PROOF, Evidence.TALK):
            self._narrow(sighting.variants)
        if sighting.angle is not None:
            self.twins = self.twins or TwinWatch(_spec(sighting), turn=sighting.turn)
            self.twin |= self.twins.take(sighting.angle, sighting.velocity or 0.0, received_ns)

    def _narrow(self, variants: Iterable[str]) -> None:
        """What it can be after one more frame; where frames disagree it stays what it was."""
        self.variants = self.variants & set(variants) or self.variants

    def rate_hz(self) -> float | None:
        return max((rate for rate in map(_rate, self.arrivals.values()) if rate is not None), default=None)

    def two_rhythms(self) -> bool:
        return any(map(alternate, self.arrivals.values()))


class Census:
    """Takes frames in the order of their stamps."""

    def __init__(self) -> None:
        self._seen: dict[_Key, _Seen] = {}
        self._arrived: dict[tuple[int, bool], tuple[list[int], bytes]] = {}  # stamps and last data, by CAN id
        self._frames = 0

    def take(self, frames: Iterable[CanFrame]) -> None:
        """What was received."""
        for frame in frames:
            self._frames += 1
            self._take(frame, frame.received_ns or 0)

    def heard(self, driver: str) -> list[int]:
        """Ids of this driver that are proven."""
        return sorted(at for (name, at, _), seen in self._seen.items() if name == driver and seen.proven)

    def report(self, seconds: float, known: Collection[Known] = ()) -> Report:
        """After so many seconds. `known`: by the robot file; where a frame has several readings those are the true."""
        found = _without_others([self._found(key) for key in sorted(self._seen) if self._seen[key].proven], known)
        return Report(
            seconds=seconds,
            frames=self._frames,
            found=tuple(found),
            unknown=tuple(self._unknown_ids(found)),
            conflicts=(*self._twins(), *self._ambiguous(found)),
            commanded=tuple(self._commanded_only(found)),
        )

    def _take(self, frame: CanFrame, received_ns: int) -> None:
        sightings = [one for driver in DRIVERS.values() for one in driver.sighted(frame)]
        for sighting in sightings:
            key = (sighting.driver, sighting.id, sighting.numbering)
            self._seen.setdefault(key, _Seen(sighting)).take(sighting, frame, received_ns)
        if not frame.remote:
            arrivals, _ = self._arrived.get((frame.id, frame.extended), ([], b""))
            arrivals.append(received_ns)
            del arrivals[:-KEPT]
            self._arrived[frame.id, frame.extended] = (arrivals, frame.data)

    def _found(self, key: _Key) -> Found:
        seen, (driver, at, _) = self._seen[key], key
        variants = tuple(one for one in DRIVERS[driver].variants if one in seen.variants)
        told = tuple((name, value) for name, value in seen.told.items() if value)
        commanded = seen.counts[Evidence.COMMAND] > 0
        return Found(driver, variants, at, tuple(seen.can_ids), seen.rate_hz(), told, commanded)

    def _unknown_ids(self, found: Sequence[Found]) -> list[Unknown]:
        """Ids that belong neither to a controller that was found nor to a host that commands."""
        known = {(one.driver, one.id) for one in found}
        result = []
        for (at, extended), (arrivals, data) in sorted(self._arrived.items()):
            frame = CanFrame("", at, data, extended)
            readings = [one for driver in DRIVERS.values() for one in driver.sighted(frame)]
            theirs = any((one.driver, one.id) in known for one in readings)
            if not theirs and not any(one.evidence is Evidence.COMMAND for one in readings):
                result.append(Unknown(at, extended, _rate(arrivals), data))
        return result

    def _twins(self) -> list[str]:
        words = []
        for (driver, at, _), seen in sorted(self._seen.items(), key=lambda item: item[0]):
            if not seen.proven:
                continue
            if seen.twin:
                words.append(f"two controllers answer as {driver} id {at}: their angles take turns")
            elif seen.two_rhythms():
                words.append(f"two controllers seem to answer as {driver} id {at}: frames come in two rhythms")
        return words

    def _ambiguous(self, found: Sequence[Found]) -> list[str]:
        """CAN ids that more than one controller explains."""
        words: dict[str, None] = {}
        for at, extended in sorted({can_id for one in found for can_id in one.can_ids}):
            owners = [one for one in found if (at, extended) in one.can_ids]
            if len(owners) > 1:
                names = " or ".join(one.name for one in owners)
                words[f"0x{at:X} may be of {names}: take one off the bus, or say in the robot file which it is"] = None
        return list(words)

    def _commanded_only(self, found: Sequence[Found]) -> list[str]:
        """What would command a controller that nobody heard, and is no word of one that was."""
        words = {can_id for one in found for can_id in one.can_ids}
        return [
            f"{_ids(seen.commands - words)} would command {driver} id {at}, which does not answer; or nobody knows it"
            for (driver, at, _), seen in sorted(self._seen.items(), key=lambda item: item[0])
            if not seen.proven and seen.commands - words
        ]


def _without_others(found: Sequence[Found], known: Collection[Known]) -> list[Found]:
    """Those of the robot file, and what is left when every frame that may be theirs is."""
    sure = [one for one in found if any((one.driver, kind, one.id) in known for kind in one.variants)]
    theirs = {can_id for one in sure for can_id in one.can_ids}
    return [one for one in found if one in sure or not set(one.can_ids) <= theirs]


def alternate(arrivals: Sequence[int]) -> bool:
    """Whether frames at these instants, ns, come from two clocks of one period."""
    gaps = [after - before for before, after in pairwise(arrivals)]
    if len(gaps) < LEAST_GAPS:
        return False
    mean = (arrivals[-1] - arrivals[0]) / len(gaps)
    pairs = [first + second for first, second in pairwise(gaps)]
    if mean < RHYTHMS_FROM_NS or max(gaps) > STARVED * mean:
        return False
    uneven = all(abs(one - other) > UNEVEN * mean for one, other in pairwise(gaps))
    return uneven and max(pairs) - min(pairs) < EVEN * mean


def _ids(can_ids: Iterable[tuple[int, bool]]) -> str:
    return ", ".join(f"0x{at:X}" for at, _ in sorted(can_ids))


def _rate(arrivals: Sequence[int]) -> float | None:
    """Hz; None for less than two."""
    if len(arrivals) < 2 or arrivals[-1] <= arrivals[0]:
        return None
    return (len(arrivals) - 1) * 1e9 / (arrivals[-1] - arrivals[0])


def _spec(sighting: Sighting) -> MotorSpec:
    """Of a motor not known, for the watch over two of one id: standing, at the usual rates."""
    return MotorSpec(
        name=f"{sighting.driver} {sighting.id}",
        id=sighting.id,
        variant=sighting.variants[0],
        max_speed=_TOP_SPEED,
        max_torque=1.0,
        max_current=1.0,
        feedback_rate=100.0,
        command_rate=100.0,
        watchdog_s=None,
    )
