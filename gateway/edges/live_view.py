"""What people see of a running robot, at a viewing rate and only while somebody looks on: `<robot>/view`.

How this works
--------------
While nobody subscribes, the loop asks one flag in each cycle and a thread waits for Zenoh to tell of a subscriber.
While somebody does, the loop leaves the samples of its cycles (`gateway.core.samples`) in a bounded queue, which drops
its oldest, and the thread packs and puts what is there, `zenoh.view_rate` times a second. It is put at the lowest
priority, and what finds no room is dropped: who does not read loses batches, and sees by the number of the cycles that
they are missing. Nothing here is asked for by the core, and a view that fails costs the view and nothing else.

A payload is MessagePack: `[schema, software, run, samples]`. The first three are the same in every version, so that a
viewer of another one can say so; `run` is drawn anew at each start of the service.
"""

import contextlib
import logging
import secrets
from collections import deque
from functools import cache
from threading import Event as Flag
from threading import Thread
from typing import NamedTuple

import msgspec
import zenoh
from zenoh.handlers import Callback

from gateway.build import version
from gateway.core.samples import Sampler
from gateway.edges.zenoh_session import CLOSE_S
from gateway.types import CycleTiming, Inputs, Outputs, Sample

VIEW_SCHEMA = 1  # another one whenever a field of a sample, or of what is in it, is another one
MAX_SAMPLES = 512  # waiting to be put, some seconds
ENCODING = "application/msgpack"

logger = logging.getLogger(__name__)


class Batch(NamedTuple):
    """Samples of one run of the service, in order."""

    run: str
    samples: tuple[Sample, ...]


class _Envelope(NamedTuple):
    schema: int
    software: str
    run: str
    samples: msgspec.Raw


_encode = msgspec.msgpack.Encoder().encode
_envelopes = msgspec.msgpack.Decoder(_Envelope)
_samples = msgspec.msgpack.Decoder(tuple[Sample, ...])


_software = cache(version)  # which looks on the disk


def encode_batch(batch: Batch) -> bytes:
    """Raises TypeError, ValueError, OverflowError for what no payload holds."""
    return _encode(_Envelope(VIEW_SCHEMA, _software(), batch.run, msgspec.Raw(_encode(batch.samples))))


def decode_batch(payload: bytes) -> Batch | str:
    """What was put; or, in words, why it cannot be read."""
    try:
        envelope = _envelopes.decode(payload)
        if envelope.schema == VIEW_SCHEMA:
            return Batch(envelope.run, _samples.decode(envelope.samples))
    except (msgspec.DecodeError, RecursionError) as error:
        return f"not a view of this software: {error}"
    return (
        f"the robot's software is another version: {envelope.software!r} tells views of schema {envelope.schema}, and "
        f"{_software()!r} here reads schema {VIEW_SCHEMA}; look on with the version of the robot"
    )


class LiveView:
    """Puts samples of one run on this key while anybody subscribes to it."""

    def __init__(self, session: zenoh.Session, key: str, rate: float) -> None:
        self._run = secrets.token_hex(4)
        self._period_s = 1.0 / rate
        self._sampler: Sampler | None = None
        self._waiting: deque[Sample] = deque(maxlen=MAX_SAMPLES)
        self._watched = False
        self._told = False
        self._ended = Flag()
        self._changed = Flag()  # somebody came, the last one went, or it is the end
        self._publisher = session.declare_publisher(
            key,
            encoding=zenoh.Encoding(ENCODING),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.BACKGROUND,
        )
        self._listener = self._publisher.declare_matching_listener(Callback(self._look_again, indirect=False))
        self._thread = Thread(target=self._serve, name="zenoh view", daemon=True)
        self._thread.start()

    def show(self, inputs: Inputs, outputs: Outputs, timing: CycleTiming) -> None:
        """Leaves what is drawn of a cycle, if somebody looks on; never waits."""
        if not self._watched:
            self._sampler = None
            return
        if self._sampler is None:
            # A new one, because the thread may be taking from the old one.
            self._sampler, self._waiting = Sampler(), deque(maxlen=MAX_SAMPLES)
        sample = self._sampler.step(inputs, outputs, timing)
        if sample is not None:
            self._waiting.append(sample)

    def close(self) -> None:
        """Ends the thread."""
        self._ended.set()
        self._changed.set()
        self._thread.join(CLOSE_S)
        with contextlib.suppress(zenoh.ZError):  # already gone with its session
            self._listener.undeclare()  # type: ignore[no-untyped-call]

    def _look_again(self, _: object) -> None:
        """Somebody came or the last one went; in a thread of Zenoh's own, which must not wait."""
        self._changed.set()

    def _serve(self) -> None:
        try:
            while not self._ended.is_set():
                self._changed.clear()
                self._watched = self._publisher.matching_status.matching  # type: ignore[attr-defined]
                if not self._watched:
                    self._changed.wait()
                elif not self._ended.wait(self._period_s):
                    self._put()
        except Exception as error:
            if not self._ended.is_set():
                logger.warning("nobody can look on any more: %s", error)
        finally:
            self._watched = False

    def _put(self) -> None:
        waiting = self._waiting
        samples = tuple(waiting.popleft() for _ in range(len(waiting)))
        if not samples:
            return
        try:
            payload = encode_batch(Batch(self._run, samples))
        except (OverflowError, TypeError, ValueError) as error:
            self._tell_once(f"cannot be told to those who look on: {error}")
        else:
            self._publisher.put(payload)

    def _tell_once(self, text: str) -> None:
        if not self._told:
            self._told = True
            logger.warning("%s", text)
