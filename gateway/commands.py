"""Who drives: the freshest command of the highest priority, and why every other source does not."""

from collections.abc import Sequence
from typing import NamedTuple

from gateway.config import Source
from gateway.types import SourceStatus, TwistCommand


class Selection(NamedTuple):
    """The winning command, None when every source is silent, and its age."""

    command: TwistCommand | None
    age_ns: int | None


NOBODY = Selection(None, None)


class Arbiter:
    """Keeps the newest command of each source; ages count from arrival."""

    def __init__(self, sources: Sequence[Source]) -> None:
        ranked = sorted(sources, key=lambda source: -source.priority)
        self._timeout_ns = {source.name: round(source.timeout * 1e9) for source in ranked}
        self._latest: dict[str, TwistCommand] = {}

    def receive(self, command: TwistCommand) -> None:
        """Take one valid command; one of a source that is not configured has no priority and is left out."""
        if command.source in self._timeout_ns:
            self._latest[command.source] = command

    def select(self, now_ns: int) -> Selection:
        """The source that drives at this moment."""
        for name, timeout_ns in self._timeout_ns.items():
            command = self._latest.get(name)
            if command is not None and now_ns - command.received_ns <= timeout_ns:
                return Selection(command, now_ns - command.received_ns)
        return NOBODY

    def describe(self, selection: Selection, now_ns: int) -> tuple[SourceStatus, ...]:
        """Every source in order of priority, with the reason why it does not drive."""
        winner = selection.command.source if selection.command else None
        return tuple(self._status(name, winner, now_ns) for name in self._timeout_ns)

    def _status(self, name: str, winner: str | None, now_ns: int) -> SourceStatus:
        command = self._latest.get(name)
        if command is None:
            return SourceStatus(name, None, "never heard")
        age_ns, timeout_ns = now_ns - command.received_ns, self._timeout_ns[name]
        age_s = age_ns * 1e-9
        if name == winner:
            return SourceStatus(name, age_s, None)
        if age_ns > timeout_ns:
            return SourceStatus(name, age_s, f"silent for longer than its timeout of {timeout_ns * 1e-9:g} s")
        return SourceStatus(name, age_s, f"outranked by {winner}")
