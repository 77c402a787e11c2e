"""All differences of a session, grouped by motor and field, with what has most likely caused them.

How this works
--------------
From a first difference on the recorded inputs still drive the core, but not as they would have come: what is compared
behind it is the core's own state gone another way. So at the next snapshot of the core it takes the recorded state
again, and what follows is judged afresh. From a first difference to that snapshot is an episode.

Its cause is told by what there is to prove it, in this order:

| cause | what proves it |
|---|---|
| tampered | the segments are not what was sealed, or not what the digest chain proves |
| arithmetic | nothing but numbers differ, in their last bits |
| software | another version or commit computes now |
| robot file | a recorded state is of another robot file |
| missing inputs | a reply to no request, or the inputs do not lead to the state recorded at the end of the episode |
| tampered | the inputs do lead to that state, so the outputs in between are not what was said then |
| unknown | nothing of it: no state is recorded behind the episode |
"""

from collections.abc import Iterable, Iterator, Sequence
from enum import Enum
from math import isfinite
from typing import NamedTuple

from drivers.contract import CanFrame
from gateway.config import parse
from gateway.core.engine import Engine
from gateway.core.frame_words import FrameWords
from gateway.core.snapshot import fingerprint
from gateway.types import Inputs, Odometry
from replay.compare.replay import CRASHES, Replay, same
from replay.sessions.chain import ALTERED, EXCHANGED
from replay.sessions.cycles import RecordedOutputs
from replay.sessions.reader import Session, packed
from replay.sessions.software import change

LAST_BITS = 1e-6  # of the larger of both: what is left of the last bits of a float32, in which motors are commanded
LEAST = 1e-6  # SI: a value below is as good as this one; what cancels out leaves last bits of what it came from
EXPLAINED = (
    "behind the first difference the recorded inputs still drive the core, whose state has gone another way; "
    "at the next recorded state of it the comparison begins afresh"
)
ANOTHER_ROBOT_FILE = "a recorded state of the core is of another robot file than the recorded one"
UNASKED = "a reply was recorded, and no request with its id"
LEADS_ELSEWHERE = "the recorded inputs do not lead to the recorded state"
LEADS_THERE = "the recorded inputs lead to the recorded state: the outputs on the way are not what was said then"
NO_PROOF = "missing inputs, or tampered: no recorded state follows that would tell"
PROOFS = ("not as it was written", "its seal is missing", ALTERED, EXCHANGED)


class Cause(Enum):
    """Why a replay differs from its recording."""

    TAMPERED = "tampered"
    ARITHMETIC = "arithmetic"
    SOFTWARE = "software"
    ROBOT_FILE = "robot file"
    MISSING_INPUTS = "missing inputs"
    UNKNOWN = "unknown"


class Differing(NamedTuple):
    """One value that differs in a cycle; None where it is no number, or is there only once."""

    motor: str | None
    field: str
    recorded: float | None = None
    replayed: float | None = None


class Group(NamedTuple):
    """All differences of a field. `largest`: of the absolute ones, in the unit of the field; None: of no number."""

    motor: str | None
    field: str
    cycles: int
    first_cycle: int
    last_cycle: int
    largest: float | None

    def joined(self, other: "Group") -> "Group":
        """Both together; the other one is of later cycles."""
        sizes = [size for size in (self.largest, other.largest) if size is not None]
        return self._replace(
            cycles=self.cycles + other.cycles, last_cycle=other.last_cycle, largest=max(sizes, default=None)
        )


class Episode(NamedTuple):
    """From a first difference to where the core took a recorded state again, or to the last cycle that was compared."""

    first_cycle: int
    last_cycle: int
    cause: Cause
    why: str
    groups: tuple[Group, ...]


class Differences(NamedTuple):
    """`cycles` compared, `different` of them."""

    cycles: int
    different: int
    episodes: tuple[Episode, ...]

    @property
    def groups(self) -> tuple[Group, ...]:
        """Over all episodes."""
        return tuple(_joined(group for episode in self.episodes for group in episode.groups))

    @property
    def causes(self) -> dict[Cause, str]:
        """Each with the reason for it, where it was first found."""
        return {episode.cause: episode.why for episode in reversed(self.episodes)}

    def as_json(self) -> dict[str, object]:
        """The documented keys of `--all --json`."""
        told = [
            episode._asdict() | {"cause": episode.cause.value, "groups": [group._asdict() for group in episode.groups]}
            for episode in self.episodes
        ]
        return {"cycles": self.cycles, "different": self.different, "explained": EXPLAINED, "episodes": told}


class _Open:
    """An episode while it is being looked at."""

    def __init__(self, first_cycle: int) -> None:
        self.first_cycle = self.last_cycle = first_cycle
        self.groups: dict[tuple[str | None, str], Group] = {}
        self.last_bits = True
        self.unasked = False  # a reply to a request that is not there
        self.leads_there: bool | None = None  # whether the inputs lead to the state recorded at the end

    def add(self, inputs: Inputs, recorded: RecordedOutputs, found: Iterable[Differing]) -> None:
        asked = {request.id for request in inputs.requests}
        self.unasked = self.unasked or any(reply.id not in asked for reply in recorded.replies)
        grouped: dict[tuple[str | None, str], Group] = {}
        for one in found:
            size = _size(one)
            self.last_bits = self.last_bits and size is not None and _in_last_bits(one, size)
            new = Group(one.motor, one.field, 1, inputs.cycle, inputs.cycle, size)
            before = grouped.get(new[:2])
            grouped[new[:2]] = new if before is None else before.joined(new)._replace(cycles=1)
        for key, group in grouped.items():
            self.groups[key] = self.groups[key].joined(group) if key in self.groups else group


def differences(session: Session) -> Differences:
    """Of a session, in one pass. Raises ConfigError if this version of the software refuses the recorded robot file."""
    search = _Search(session)
    for inputs, recorded in session.cycles():
        search.cycle(inputs, recorded)
    judge = _Judge(session, another_robot_file=len(search.robot_files) > 1)
    return Differences(search.cycles, search.different, tuple(map(judge.episode, search.episodes)))


class _Search:
    """Give it every cycle in order."""

    def __init__(self, session: Session) -> None:
        config = parse(session.config_text, "robot file of the session")
        self.cycles = self.different = 0
        self.episodes: list[_Open] = []
        self.robot_files = {fingerprint(config)}
        self._snapshot = session.snapshot
        self._replay, self._words = Replay(config, session.snapshot), FrameWords(config)
        self._episode: _Open | None = None

    def cycle(self, inputs: Inputs, recorded: RecordedOutputs) -> None:
        engine = self._replay.engine(inputs)
        if engine is None:
            self._episode = None
            return
        self.cycles += 1
        found = self._found(engine, inputs, recorded)
        if found:
            self.different += 1
            self._opened(inputs.cycle).add(inputs, recorded, found)
        if self._episode is not None:
            self._episode.last_cycle = inputs.cycle
            self._look_at_state(self._episode, inputs.cycle)

    def _found(self, engine: Engine, inputs: Inputs, recorded: RecordedOutputs) -> list[Differing]:
        try:
            outputs = engine.step(inputs)
        except CRASHES as error:
            self._replay.lose()
            return [Differing(None, f"exception {type(error).__name__}")]
        return [] if same(outputs, recorded) else list(differing(self._words, recorded, RecordedOutputs.of(outputs)))

    def _opened(self, cycle: int) -> "_Open":
        if self._episode is None:
            self._episode = _Open(cycle)
            self.episodes.append(self._episode)
        return self._episode

    def _look_at_state(self, episode: "_Open", cycle: int) -> None:
        state = self._snapshot(cycle)
        if state is None:
            return
        self.robot_files.add(str(state.get("robot_file")))
        reached = self._replay.state()
        episode.leads_there = reached is not None and packed(reached) == packed(state)
        if self._replay.restore(cycle):
            self._episode = None


class _Judge:
    """Names the cause of episodes, once the session was read whole."""

    def __init__(self, session: Session, *, another_robot_file: bool) -> None:
        self._unsealed = next((one for one in session.problems if any(words in one for words in PROOFS)), None)
        self._software = change(session.header)
        self._another_robot_file = another_robot_file

    def episode(self, found: _Open) -> Episode:
        cause, why = self._cause(found)
        return Episode(found.first_cycle, found.last_cycle, cause, why, tuple(found.groups.values()))

    def _cause(self, found: _Open) -> tuple[Cause, str]:
        last_bits = "only numbers differ, in their last bits"
        if self._software is not None:
            last_bits += f"; the software: {self._software}"
        proofs = (
            (self._unsealed is not None, Cause.TAMPERED, self._unsealed or ""),
            (found.last_bits, Cause.ARITHMETIC, last_bits),
            (self._software is not None, Cause.SOFTWARE, self._software or ""),
            (self._another_robot_file, Cause.ROBOT_FILE, ANOTHER_ROBOT_FILE),
            (found.unasked, Cause.MISSING_INPUTS, UNASKED),
            (found.leads_there is False, Cause.MISSING_INPUTS, LEADS_ELSEWHERE),
            (found.leads_there is True, Cause.TAMPERED, LEADS_THERE),
        )
        return next(((cause, why) for proven, cause, why in proofs if proven), (Cause.UNKNOWN, NO_PROOF))


def differing(words: FrameWords, recorded: RecordedOutputs, replayed: RecordedOutputs) -> Iterator[Differing]:
    """Every value of a cycle that differs, frames in the fields of their drivers."""
    if recorded.frames != replayed.frames:
        yield from _of_frames(words, recorded.frames, replayed.frames)
    if recorded.mode is not replayed.mode:
        yield Differing(None, "mode")
    if recorded.odometry != replayed.odometry:
        yield from _of_odometry(recorded.odometry, replayed.odometry)
    if recorded.events != replayed.events:
        yield Differing(None, "events")
    if recorded.replies != replayed.replies:
        yield Differing(None, "replies")


def _of_frames(words: FrameWords, recorded: Sequence[CanFrame], replayed: Sequence[CanFrame]) -> Iterator[Differing]:
    """Frames of one bus, id and place among those of that id are each other's."""
    before, after = _by_id(recorded), _by_id(replayed)
    shared = 0
    for key in dict.fromkeys([*before, *after]):
        one, other = before.get(key), after.get(key)
        if one is None or other is None:
            there = one or other
            assert there is not None
            decoded = words.decode(there)
            message = f"{there.bus} {there.id:X}" if decoded is None else decoded.message
            yield Differing(None if decoded is None else decoded.motor, f"frame {message}")
        elif one != other:
            yield from _of_frame(words, one, other)
        else:
            shared += 1
    if shared == len(before) == len(after):
        yield Differing(None, "order of the frames")


def _by_id(frames: Sequence[CanFrame]) -> dict[tuple[str, int, int], CanFrame]:
    found: dict[tuple[str, int, int], CanFrame] = {}
    for frame in frames:
        place = 0
        while (frame.bus, frame.id, place) in found:
            place += 1
        found[frame.bus, frame.id, place] = frame
    return found


def _of_frame(words: FrameWords, before: CanFrame, after: CanFrame) -> Iterator[Differing]:
    one, other = words.decode(before), words.decode(after)
    if one is None or other is None or one[:2] != other[:2] or len(one.fields) != len(other.fields):
        yield Differing(None if one is None else one.motor, f"frame {before.bus} {before.id:X}")
        return
    owners = one.owners or (one.motor,) * len(one.fields)
    changed = [
        Differing(motor, f"{one.message}.{field}", value, new)
        for motor, (field, value), (_, new) in zip(owners, one.fields, other.fields, strict=True)
        if value != new
    ]
    yield from changed or [Differing(one.motor, f"frame {one.message}")]  # the same in words


def _of_odometry(before: Odometry | None, after: Odometry | None) -> Iterator[Differing]:
    one, other = _numbers(before), _numbers(after)
    for name in dict.fromkeys([*one, *other]):
        if one.get(name) != other.get(name):
            yield Differing(None, f"odometry.{name}", one.get(name), other.get(name))


def _numbers(odometry: Odometry | None) -> dict[str, float | None]:
    if odometry is None:
        return {"due": None}
    twist = {} if odometry.twist is None else odometry.twist._asdict()
    covariance = {f"covariance{place}": value for place, value in enumerate(odometry.covariance)}
    return {"due": 1.0, **odometry.pose._asdict(), **twist, **covariance, "residual": odometry.residual}


def _size(one: Differing) -> float | None:
    if one.recorded is None or one.replayed is None:
        return None
    size = abs(one.replayed - one.recorded)
    return size if isfinite(size) else None


def _in_last_bits(one: Differing, size: float) -> bool:
    assert one.recorded is not None
    assert one.replayed is not None
    return size <= LAST_BITS * max(abs(one.recorded), abs(one.replayed), LEAST)


def _joined(groups: Iterable[Group]) -> Iterator[Group]:
    found: dict[tuple[str | None, str], Group] = {}
    for group in groups:
        found[group[:2]] = found[group[:2]].joined(group) if group[:2] in found else group
    yield from found.values()
