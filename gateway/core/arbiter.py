"""Who drives: the freshest command of the highest priority, and why every other source does not.

How this works
--------------
A source may drive only after a zero of its own since the robot last came to rest, was stopped, failed or started:
whoever takes the robot over has its stick in the middle. It loses that right when another sender appears under its
name, when it asks for motion before the robot has started (something keeps it from that, and may do so for long), and
by a silence longer than its timeout: what comes after such a silence may be the past of a commander that is long dead.
Where commands tell when they were sent it is not that, and a silence of LONGEST_DIP_NS is forgiven; whoever was gone
for longer finds another world, perhaps with another source that drives.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

from drivers.records import maker
from gateway.config import Source
from gateway.control.drive_law import TWISTS, Features
from gateway.types import Refusal, RefusalCode, SourceStatus, TwistCommand

LONGEST_DIP_NS: Final = 2_000_000_000  # a link that stalls, a process that swaps; source: ours


class Selection(NamedTuple):
    """The winning command, None when nobody may drive, and its age."""

    command: TwistCommand | None
    age_ns: int | None


NOBODY: Final = Selection(None, None)
_selection: Final = maker(Selection)


class Arbiter:
    """Keeps the newest command of each source and who has sent a zero; ages count from `received_ns`."""

    def __init__(self, sources: Sequence[Source], abilities: Features = TWISTS) -> None:
        self._abilities = abilities
        ranked = sorted(sources, key=lambda source: -source.priority)
        self._timeout_ns = {source.name: round(source.timeout * 1e9) for source in ranked}
        self._latest: dict[str, TwistCommand] = {}
        self._admitted: set[str] = set()
        self._dismissed_ns: int | None = None

    def receive(self, command: TwistCommand) -> Refusal | None:
        """Take one valid command; why not, if this chassis cannot do what it asks for.

        One of a source that is not configured has no priority and is left out.
        """
        name = command.source
        if name not in self._timeout_ns:
            return None
        objection = self._abilities.objection(command)
        if objection is not None:
            return Refusal(name, RefusalCode.UNSUPPORTED, objection, command.received_ns)
        if self._starts_over(command, self._latest.get(name)):
            self._admitted.discard(name)
        since = self._dismissed_ns
        if command.still and (since is None or command.received_ns > since):
            self._admitted.add(name)
        self._latest[name] = command
        return None

    def dismiss(self, now_ns: int) -> None:
        """The robot rests, was stopped or failed: every source has to send zero again, after this moment."""
        self._admitted.clear()
        self._dismissed_ns = now_ns

    def dismiss_moving(self) -> None:
        """Nothing has started: who asks for motion all the same has to send zero again."""
        self._admitted = {name for name in self._admitted if self._latest[name].still}

    def select(self, now_ns: int) -> Selection:
        """The source that drives at this moment."""
        for name in self._timeout_ns:
            command = self._latest.get(name)
            if command is not None and name in self._admitted and self._fresh(command, now_ns):
                return _selection((command, now_ns - command.received_ns))
        return NOBODY

    def moving(self, now_ns: int) -> TwistCommand | None:
        """A fresh command of any source, whether it may drive or not, that asks for motion."""
        for command in self._latest.values():
            if not command.still and self._fresh(command, now_ns):
                return command
        return None

    def describe(self, selection: Selection, now_ns: int) -> tuple[SourceStatus, ...]:
        """Every source in order of priority, with the reason why it does not drive."""
        winner = selection.command.source if selection.command else None
        return tuple(self._status(name, winner, now_ns) for name in self._timeout_ns)

    def _fresh(self, command: TwistCommand, now_ns: int) -> bool:
        return now_ns - command.received_ns <= self._timeout_ns[command.source]

    def _starts_over(self, command: TwistCommand, before: TwistCommand | None) -> bool:
        if before is None:
            return False
        if command.sender != before.sender:
            return True
        silent_ns = command.received_ns - before.received_ns
        forgiven_ns = LONGEST_DIP_NS if command.stamped and before.stamped else 0
        return silent_ns > max(self._timeout_ns[command.source], forgiven_ns)

    def _status(self, name: str, winner: str | None, now_ns: int) -> SourceStatus:
        command = self._latest.get(name)
        if command is None:
            return SourceStatus(name, None, "never heard")
        age_s = (now_ns - command.received_ns) * 1e-9
        if name == winner:
            return SourceStatus(name, age_s, None)
        if not self._fresh(command, now_ns):
            timeout_s = self._timeout_ns[name] * 1e-9
            return SourceStatus(name, age_s, f"silent for longer than its timeout of {timeout_s:g} s")
        if name not in self._admitted:
            return SourceStatus(name, age_s, "has to send zero first")
        return SourceStatus(name, age_s, f"outranked by {winner}")
