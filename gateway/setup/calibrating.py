"""Has one ODrive 0.6 calibrate its motor, which turns by itself: what to send, given what was heard and the time. Pure.

How this works
--------------
    LISTEN -> ASKED -> TURNING -> END -> DONE
        \\---------\\----------/

The controller turns the motor on its own, so that nothing here can hold it to a speed: what can be done is to look, and
to tell it IDLE, which lets the motor go, at the first thing that is not right: no heartbeat or no estimate for a while,
an error, too fast, too far, too long, or a person who asks. A setpoint of zero in every cycle feeds its watchdog, which
would end the calibration. Where this program is killed the controller goes on to the end of its calibration.
"""

from enum import Enum
from math import isfinite
from typing import Final, NamedTuple

from drivers.contract import CanFrame
from drivers.odrive import tables
from drivers.odrive.firmware import FIRMWARES, error_words
from drivers.odrive.tables import AxisState

FULL_CALIBRATION: Final = 3  # FULL_CALIBRATION_SEQUENCE; ODriveResources, examples/can_calibrate.py
FIRMWARE: Final = FIRMWARES["0.6"]
SILENCE_NS: Final = 350_000_000  # three heartbeats of 100 ms
LISTEN_NS: Final = 500_000_000
ASKED_NS: Final = 2_000_000_000  # until it begins
LONGEST_NS: Final = 60_000_000_000
END_NS: Final = 300_000_000
CONFIRM_NS: Final = 1_000_000_000
FASTEST: Final = 5.0  # turns/s of the rotor; as delivered it turns with half to one
FAST_FOR: Final = 3  # estimates one after the other: one alone may be the moment in which its encoder is found
FURTHEST: Final = 20.0  # turns of the rotor, there and back together

_ESTIMATES: Final = tables.COMMON_FROM_DEVICE[tables.GET_ENCODER_ESTIMATES].layout
_STATE: Final = tables.COMMON_TO_DEVICE[tables.SET_AXIS_STATE].layout
_ZERO: Final = tables.COMMON_TO_DEVICE[tables.SET_INPUT_VEL].layout.pack(0.0, 0.0)


class Phase(Enum):
    """Where a calibration is."""

    LISTEN = "listen"
    ASKED = "asked"
    TURNING = "turning"
    END = "end"
    DONE = "done"


class Outcome(NamedTuple):
    """`reason`: why not, in words. `released`: the controller said that it is idle again."""

    ok: bool
    reason: str
    released: bool

    @property
    def well(self) -> bool:
        """Whether it may be saved, and the next one begin."""
        return self.ok and self.released


class Calibration:
    """For `gateway.edges.turning`: `step` once per cycle until `finished`."""

    def __init__(self, bus: str, node: int) -> None:
        self.phase = Phase.LISTEN
        self.outcome: Outcome | None = None
        self._bus = bus
        self._node = node
        self._entered_ns: int | None = None
        self._reason: str | None = None
        self._ok = False
        self._state: int | None = None
        self._errors = self._result = 0
        self._heartbeat_ns: int | None = None
        self._estimate_ns: int | None = None
        self._turns = 0.0
        self._fast = 0

    @property
    def finished(self) -> bool:
        """Whether there is nothing more to send."""
        return self.phase is Phase.DONE

    def stop(self, reason: str) -> None:
        """Let the motor go."""
        self._reason = self._reason or reason

    def step(self, frames: list[CanFrame], now_ns: int) -> list[CanFrame]:
        """What to send now, given what was received since the last call."""
        for frame in frames:
            self._take(frame, now_ns)
        if self._entered_ns is None:
            self._entered_ns = now_ns
            return [self._frame(tables.CLEAR_ERRORS, bytes(1))]  # what is over is no error; it arms nothing
        asking = self._advance(now_ns, now_ns - self._entered_ns)
        if self.phase in (Phase.LISTEN, Phase.DONE):
            return []
        if self.phase is Phase.END:
            return self.coast_frames()
        return [*([self._asks(FULL_CALIBRATION)] if asking else []), self._zero()]

    def stop_frames(self, *, now_ns: int) -> list[CanFrame]:
        """It cannot be told to brake: IDLE lets it go."""
        return self.coast_frames()

    def coast_frames(self) -> list[CanFrame]:
        """Frames that release it."""
        return [self._asks(AxisState.IDLE), self._zero()]

    def _advance(self, now_ns: int, gone_ns: int) -> bool:
        """At most one step further; whether to ask for the calibration now."""
        if self.phase in (Phase.LISTEN, Phase.ASKED, Phase.TURNING) and self._objects(now_ns, gone_ns):
            self._enter(Phase.END, now_ns)
        elif self.phase is Phase.LISTEN and gone_ns >= LISTEN_NS:
            self._enter(Phase.ASKED, now_ns)
            return True
        elif self.phase is Phase.ASKED and self._state not in (None, AxisState.IDLE):
            self._enter(Phase.TURNING, now_ns)
        elif self.phase is Phase.TURNING and self._state == AxisState.IDLE:
            self._ok = self._result == 0
            self._reason = None if self._ok else self._told()
            self._enter(Phase.END, now_ns)
        elif self.phase is Phase.END and gone_ns >= END_NS and (self._idle(now_ns) or gone_ns >= CONFIRM_NS):
            self.outcome = Outcome(self._ok, self._reason or "", self._idle(now_ns))
            self.phase = Phase.DONE
        return False

    def _enter(self, phase: Phase, now_ns: int) -> None:
        self.phase = phase
        self._entered_ns = now_ns

    def _objects(self, now_ns: int, gone_ns: int) -> bool:
        """Whether it must not go on; the first reason counts."""
        self._reason = self._reason or self._objection(now_ns, gone_ns)
        return self._reason is not None

    def _objection(self, now_ns: int, gone_ns: int) -> str | None:
        if self.phase is Phase.LISTEN and gone_ns < LISTEN_NS:
            return None
        deaf = _silent(self._heartbeat_ns, now_ns) or _silent(self._estimate_ns, now_ns)
        found = {
            "it is not heard: heartbeat and encoder estimates must come": deaf,
            f"it reports {error_words(self._errors, FIRMWARE.errors)}": self._errors != 0,
            "it is not idle": self.phase is Phase.LISTEN and self._state != AxisState.IDLE,
            f"it turned faster than {FASTEST:g} turns/s": self._fast >= FAST_FOR,
            f"it turned further than {FURTHEST:g} turns": self._turns > FURTHEST,
            f"it did not begin: {self._told()}": self.phase is Phase.ASKED and gone_ns >= ASKED_NS,
            f"it takes longer than {LONGEST_NS * 1e-9:g} s": self.phase is Phase.TURNING and gone_ns >= LONGEST_NS,
        }
        return next((words for words, so in found.items() if so), None)

    def _told(self) -> str:
        return f"procedure result {FIRMWARE.results.get(self._result, self._result)}"

    def _idle(self, now_ns: int) -> bool:
        return self._state == AxisState.IDLE and not _silent(self._heartbeat_ns, now_ns)

    def _take(self, frame: CanFrame, now_ns: int) -> None:
        if frame.extended or frame.remote or frame.id >> tables.NODE_SHIFT != self._node:
            return
        command = frame.id & tables.COMMAND_MASK
        if command == tables.HEARTBEAT and (heard := FIRMWARE.heard(frame.data)) is not None:
            self._errors, self._state, self._result = heard
            self._heartbeat_ns = now_ns
        elif command == tables.GET_ENCODER_ESTIMATES and len(frame.data) >= _ESTIMATES.size:
            self._follow(_ESTIMATES.unpack_from(frame.data)[1], now_ns)

    def _follow(self, speed: float, now_ns: int) -> None:
        """Turns/s; while the encoder is being found it may tell none."""
        if not isfinite(speed):
            speed = 0.0
        if self._estimate_ns is not None and self.phase is not Phase.LISTEN:
            self._turns += abs(speed) * min(now_ns - self._estimate_ns, SILENCE_NS) * 1e-9
        self._fast = self._fast + 1 if abs(speed) > FASTEST else 0
        self._estimate_ns = now_ns

    def _asks(self, state: int) -> CanFrame:
        return self._frame(tables.SET_AXIS_STATE, _STATE.pack(state))

    def _zero(self) -> CanFrame:
        return self._frame(tables.SET_INPUT_VEL, _ZERO)

    def _frame(self, command: int, data: bytes) -> CanFrame:
        return CanFrame(self._bus, self._node << tables.NODE_SHIFT | command, data)


def _silent(heard_ns: int | None, now_ns: int) -> bool:
    return heard_ns is None or now_ns - heard_ns > SILENCE_NS
