"""Whether a command of one source may pass: from the right sender, in order, and not too long on its way.

How this works. Arrival says nothing of age: a link that stalls delivers all at once what it held back, and a process
that was stopped reads old samples when it goes on. So a sender may stamp its commands with its own monotonic clock. The
two clocks share no zero, but arrival minus stamp is the same for every command except for what it waited on its way:
the smallest such offset belongs to the fastest command, and what another one has more is its delay. Age counts from
arrival less that delay; a delay beyond the timeout is refused. What the fastest command itself waited stays unknown.

So it is with the samples of sensors, of which each sensor is a source.

One sender holds a source, so that two that publish by mistake do not alternate, until it was silent for the timeout.
"""

from dataclasses import dataclass
from typing import TypeVar

from gateway.types import Refusal, RefusalCode, SensorSample, TwistCommand

# How far two clocks may drift apart: the kernel slews a clock by at most 500 ppm (adjtimex(2)); quartz has below 100.
DRIFT_PPM = 500


_Sent = TypeVar("_Sent", TwistCommand, SensorSample)


@dataclass(slots=True)
class SourceGate:
    """The gate of one source; remembers its present sender only. Times are arguments."""

    timeout_ns: int
    _sender: str | None = None
    _generation: int = 0  # how often this sender's clock began anew
    _passed_ns: int | None = None  # from when the age of the last passed command counts; None: none has passed
    _sequence: int | None = None  # of the last passed command; so for the stamp
    _stamp_ns: int | None = None
    _offset_ns: int = 0  # arrival - stamp of the fastest command, allowing for drift
    _offset_at_ns: int = 0

    def admit(self, command: _Sent, stamp_ns: int | None) -> _Sent | Refusal:
        """The command with its age corrected and its sender noted, or why it does not pass.

        `stamp_ns`: when it was sent by its sender's clock; None: not told, and its age counts from arrival. A first
        command cannot be judged and passes; the core wants a zero from every sender it does not know.
        """
        silent = self._passed_ns is None or command.received_ns - self._passed_ns > self.timeout_ns
        if command.sender != self._sender and not silent:
            return _refusal(command, RefusalCode.SECOND_SENDER, self._held(command))
        if not silent and (why := self._out_of_order(command, stamp_ns)):
            return _refusal(command, RefusalCode.OLD_SEQUENCE, why)
        if command.sender != self._sender:
            self._sender, self._generation, self._sequence, self._stamp_ns = command.sender, 0, None, None
        delay_ns = None if stamp_ns is None else self._delay(command.received_ns, stamp_ns)
        if delay_ns is not None and delay_ns > self.timeout_ns:
            text = f"{_name(command.sender)}: {delay_ns * 1e-9:.3f} s on its way, by its stamp: must be at most"
            return _refusal(command, RefusalCode.STALE, f"{text} the timeout of {self.timeout_ns * 1e-9:g} s")
        self._sequence = self._sequence if command.sequence is None else command.sequence
        self._stamp_ns = self._stamp_ns if stamp_ns is None else stamp_ns
        self._passed_ns = command.received_ns - (delay_ns or 0)
        return command._replace(received_ns=self._passed_ns, sender=self._known_as(), stamped=delay_ns is not None)

    def _held(self, command: _Sent) -> str:
        holder, other = _name(self._sender), _name(command.sender)
        return f"{other}: {holder} holds this source until it is silent for {self.timeout_ns * 1e-9:g} s"

    def _out_of_order(self, command: _Sent, stamp_ns: int | None) -> str | None:
        # A commander that restarted counts from its beginning; it is believed once its former self has timed out.
        if command.sequence is not None and self._sequence is not None and command.sequence <= self._sequence:
            return f"seq = {command.sequence}: must be greater than the last accepted one, {self._sequence}"
        if stamp_ns is not None and self._stamp_ns is not None and stamp_ns < self._stamp_ns:
            stamp, last = stamp_ns * 1e-9, self._stamp_ns * 1e-9
            return f"stamp = {stamp:.3f}: must not be smaller than the last accepted one, {last:.3f}"
        return None

    def _delay(self, arrival_ns: int, stamp_ns: int) -> int | None:
        """How long it took longer than the fastest; None when there is nothing to judge by."""
        offset_ns = arrival_ns - stamp_ns
        drift_ns = (arrival_ns - self._offset_at_ns) * DRIFT_PPM // 1_000_000
        # After a long silence the drift alone may be more than the timeout, and the old offset says nothing any more.
        if self._stamp_ns is None or stamp_ns < self._stamp_ns or drift_ns > self.timeout_ns:
            self._generation += self._stamp_ns is not None
            self._offset_ns, self._offset_at_ns = offset_ns, arrival_ns
            return None
        self._offset_ns, self._offset_at_ns = min(offset_ns, self._offset_ns + drift_ns), arrival_ns
        return offset_ns - self._offset_ns

    def _known_as(self) -> str | None:
        # Whoever's clock began anew is another sender to the core, even when the loop misses the command that says so.
        return self._sender if self._generation == 0 else f"{self._sender or ''}#{self._generation}"


def _name(sender: str | None) -> str:
    return "a sender without a name" if sender is None else f"sender {sender}"


def _refusal(command: TwistCommand | SensorSample, code: RefusalCode, text: str) -> Refusal:
    return Refusal(command.source, code, text, command.received_ns)
