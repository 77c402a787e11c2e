"""Commanders in virtual time: each source streams its twist, and a mailbox keeps the newest of each."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from gateway.config import Source
from gateway.types import Region, Twist, TwistCommand, TwistFrame

SENDER = "scenario"  # of every source, unless told
_SECOND_NS = 1_000_000_000


@dataclass(slots=True)
class Stream:
    """One source that sends a twist at a rate from some instant on."""

    source: str
    twist: Twist
    period_ns: int
    due_ns: int
    stamped: bool
    sender: str
    region: Region = Region.ANY
    width_rate: float | None = None
    width: float | None = None


class Commanders:
    """All streams and the mailbox between them and the loop."""

    def __init__(self, recorded: Sequence[TwistCommand] = ()) -> None:
        """`recorded`: commands that are sent besides, each when it was received, until their source is silenced."""
        self._recorded = deque(recorded)
        self._silenced: set[str] = set()
        self._streams: dict[str, Stream] = {}
        self._sequences: dict[str, int] = {}
        self._newest: dict[str, TwistCommand] = {}
        self._frozen_since_ns: int | None = None

    def stream(  # noqa: PLR0913  # all that a command may say
        self,
        source: str,
        twist: Twist,
        *,
        rate: float,
        stamped: bool,
        sender: str,
        now_ns: int,
        region: Region = Region.ANY,
        width_rate: float | None = None,
        width: float | None = None,
    ) -> None:
        """From now on this sender sends this twist as this source."""
        self.send(now_ns)
        self._streams[source] = Stream(
            *(source, twist, round(_SECOND_NS / rate), now_ns, stamped, sender, region, width_rate, width)
        )

    def silence(self, source: str, now_ns: int) -> None:
        """This source sends nothing any more."""
        self.send(now_ns - 1)
        self._streams.pop(source, None)
        self._silenced.add(source)

    def send(self, until_ns: int) -> None:
        """Everything that is sent by then; of each source the mailbox keeps the newest."""
        while self._recorded and self._recorded[0].received_ns <= until_ns:
            command = self._recorded.popleft()
            if command.source not in self._silenced:
                self._newest[command.source] = command
        for stream in self._streams.values():
            while stream.due_ns <= until_ns:
                sequence = self._sequences[stream.source] = self._sequences.get(stream.source, -1) + 1
                self._newest[stream.source] = TwistCommand(
                    stream.source,
                    stream.twist,
                    TwistFrame.BODY,
                    sequence,
                    stream.due_ns,
                    stream.sender,
                    stream.stamped,
                    region=stream.region,
                    width_rate=stream.width_rate,
                    width=stream.width,
                )
                stream.due_ns += stream.period_ns

    def freeze(self, now_ns: int) -> None:
        """The process stands still from now to the next `drain`: what is sent meanwhile arrives only then."""
        self.send(now_ns)
        self._frozen_since_ns = now_ns

    def forget(self, until_ns: int) -> None:
        """Nobody listened until then."""
        self.send(until_ns)
        self._newest.clear()

    def drain(self, now_ns: int) -> list[TwistCommand]:
        """What the loop finds in its mailbox."""
        self.send(now_ns)
        commands = [self._arrived(command, now_ns) for command in self._newest.values()]
        self._newest.clear()
        self._frozen_since_ns = None
        return commands

    def _arrived(self, command: TwistCommand, now_ns: int) -> TwistCommand:
        """Ages count from arrival where the sender does not tell when it sent."""
        since_ns = self._frozen_since_ns
        late = since_ns is not None and command.received_ns > since_ns and not command.stamped
        return command._replace(received_ns=now_ns) if late else command


class Asked:
    """What the winning source asks for, whatever mode the robot is in: highest priority that is not silent."""

    def __init__(self, sources: list[Source]) -> None:
        ranked = sorted(sources, key=lambda source: -source.priority)
        self._timeouts_ns = {source.name: round(source.timeout * _SECOND_NS) for source in ranked}
        self._latest: dict[str, TwistCommand] = {}

    def update(self, commands: tuple[TwistCommand, ...], now_ns: int) -> Twist | None:
        """Take the commands of this cycle; None while every source is silent."""
        for command in commands:
            self._latest[command.source] = command
        for source, timeout_ns in self._timeouts_ns.items():
            command_or_none = self._latest.get(source)
            if command_or_none is not None and now_ns - command_or_none.received_ns <= timeout_ns:
                return command_or_none.twist
        return None
