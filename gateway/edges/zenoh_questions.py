"""Requests that somebody waits for: many in flight, each answered with the loop's own reply or in clear words.

How this works. A receiver's thread leaves the request to the loop and keeps the query here, without waiting; one thread
gives the loop's replies to their askers, matched by id, and "no answer" to those that waited too long. The number of
queries in flight is bounded, and the next one is told so at once: a crowd costs neither threads nor memory, and no
asker waits for another. A reply that comes too late finds nobody and is dropped.
"""

import itertools
import time
from collections.abc import Callable
from queue import Empty, SimpleQueue
from threading import Lock
from typing import NamedTuple

import zenoh

from gateway.edges import messages
from gateway.edges.mailbox import MAX_QUESTIONS
from gateway.types import Reply, Request

ANSWER_S = 1.0
NO_ANSWER = f"no answer from the control loop within {ANSWER_S:g} s"
TOO_MANY = f"too many requests: {MAX_QUESTIONS} already wait for their answer; ask again"
CLOSING = "the gateway is closing"
END = Reply(-1, ok=False, reason=None)  # after it no reply is given any more


class _Asked(NamedTuple):
    query: zenoh.Query
    key: str
    deadline_ns: int


class Questions:
    """From the threads that receive queries to the loop, and back."""

    def __init__(self, leave: Callable[[Request], None]) -> None:
        self._leave = leave
        self._ids = itertools.count(1)
        self._lock = Lock()  # never taken by the loop
        self._asked: dict[int, _Asked] = {}  # in order of their deadlines
        self._replies: SimpleQueue[Reply | None] = SimpleQueue()  # None: look at the deadlines

    def ask(self, query: zenoh.Query, key: str, request: Request) -> None:
        """Leaves the request, under an id of its own, to the loop; never waits."""
        deadline_ns = time.monotonic_ns() + round(ANSWER_S * 1e9)
        with self._lock:
            room = len(self._asked) < MAX_QUESTIONS
            if room:
                request = request._replace(id=next(self._ids))
                self._asked[request.id] = _Asked(query, key, deadline_ns)
        if not room:
            answer(query, key, TOO_MANY)
            return
        self._leave(request)
        self._replies.put(None)

    def reply(self, reply: Reply) -> None:
        """What the loop says to the request with this id; never waits."""
        self._replies.put(reply)

    def next_reply(self) -> Reply | None:
        """Waits for the loop's next reply, at most until a deadline (None); END after `close`."""
        with self._lock:
            first = next(iter(self._asked.values()), None)
        left = None if first is None else max(first.deadline_ns - time.monotonic_ns(), 0) * 1e-9
        try:
            return self._replies.get(timeout=left)
        except Empty:
            return None

    def settle(self, reply: Reply | None) -> None:
        """Gives the reply to its asker, and gives up on those whose deadline is over."""
        now_ns = time.monotonic_ns()
        with self._lock:
            asked = None if reply is None else self._asked.pop(reply.id, None)
            late = [self._asked.pop(key) for key, one in list(self._asked.items()) if one.deadline_ns <= now_ns]
        if reply is not None and asked is not None:
            answer(asked.query, asked.key, reply.reason, ok=reply.ok)
        for one in late:
            answer(one.query, one.key, NO_ANSWER)

    def close(self) -> None:
        """Ends the wait of all."""
        self._replies.put(END)
        with self._lock:
            asked, self._asked = list(self._asked.values()), {}
        for one in asked:
            answer(one.query, one.key, CLOSING)


def answer(query: zenoh.Query, key: str, reason: str | None, *, ok: bool = False) -> None:
    """The last word on a query."""
    with query:
        query.reply(key, messages.encode_reply(Reply(0, ok, reason)), encoding=zenoh.Encoding.APPLICATION_JSON)
