"""`drivegate watch --viewer`: the live view of a robot in a Rerun viewer on this machine.

How this works
--------------
The robot puts samples of its drive on a key of its own, and knows nothing of viewers. One thread receives them, one
draws them, by what draws a session too. When the viewer does not read, the drawing waits, then the receiving, and
Zenoh's ring drops what is old. The main thread never waits for either: it looks for Ctrl-C, for the end of the viewer
and for a robot that is silent.
"""

import os
import signal
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from queue import Full, Queue
from threading import Thread
from types import FrameType

import rerun as rr
import rerun.blueprint as rrb

from gateway.cli.output import complain, console
from gateway.cli.viewer import LiveViewer, ViewerError
from gateway.client import Client
from gateway.config import ConfigError, parse
from gateway.edges.live_view import Batch, decode_batch
from gateway.recording.failures import RecordingOffError
from gateway.recording.live import LiveRecording, Opens
from gateway.types import Event, Level

SILENT_S = 1.5  # without a batch; the slowest view has one every second
LOOK_S = 0.2
ENDING = (signal.SIGTERM, signal.SIGHUP)  # as Ctrl-C
EXIT_NO_VIEWER = 1


class Follower:
    """Draws the batches of a robot, a recording for each run of it. `say` tells a person what is the matter."""

    def __init__(self, client: Client, opens: Opens, say: Callable[[str], None]) -> None:
        self.recordings = 0
        self._client = client
        self._name = client.robot
        self._opens = opens
        self._say = say
        self._run: str | None = None
        self._recording: LiveRecording | None = None
        self._heard_s = time.monotonic()
        self._silent = False
        self._told: str | None = None
        self._waiting: Queue[bytes | Event] = Queue(1)
        client.look(self._receive)

    def draw_for_ever(self) -> None:
        """Draws what comes; in a thread of its own, which waits while the viewer does not read."""
        while True:
            self.draw_next()

    def draw_next(self) -> None:
        """Waits for the next batch, and draws it."""
        match self._waiting.get():
            case Event() as event:
                if self._recording is not None:
                    self._recording.say(event)
            case payload:
                self._draw(payload)

    def mind(self) -> None:
        """Tells when the robot falls silent, and when it is heard again. Never waits."""
        silent = time.monotonic() - self._heard_s > SILENT_S
        if silent is self._silent:
            return
        self._silent = silent
        text = self._why_silent() if silent else f"{self._name} is heard again"
        self._say(text)
        with suppress(Full):
            self._waiting.put_nowait(Event(Level.WARNING, "view", text))

    def _receive(self, payload: bytes) -> None:
        self._heard_s = time.monotonic()
        self._waiting.put(payload)

    def _draw(self, payload: bytes) -> None:
        batch = decode_batch(payload)
        if isinstance(batch, str):
            self._tell_once(f"{self._name}: {batch}")
            return
        recording = self._recording_of(batch)
        if recording is None:
            return
        try:
            recording.draw(batch.samples)
        except Exception as error:  # anybody may put there what he likes
            self._tell_once(f"{self._name}: cannot be drawn: {type(error).__name__}: {error}")

    def _recording_of(self, batch: Batch) -> LiveRecording | None:
        """Of the run of this batch, whose robot file may be another one than before."""
        if batch.run == self._run:
            return self._recording
        text = self._client.config_text()
        if text is None:
            return None  # it is asked again for the next batch
        if self._recording is not None:
            self._recording.close()
        self._run, self._recording = batch.run, None
        try:
            self._recording = LiveRecording(parse(text, f"{self._name}/config"), text, batch.run, self._opens)
        except (ConfigError, RecordingOffError) as error:
            self._tell_once(str(error))
            return None
        self._say(f"looking at {self._name}" if self.recordings == 0 else f"{self._name} was restarted")
        self.recordings += 1
        return self._recording

    def _why_silent(self) -> str:
        if not self._client.alive:
            return f"{self._name} is gone: waiting for it"
        if self._run is None:
            return (
                f"{self._name} answers and shows nothing: its software is older, "
                f"or {self._name}/view is not allowed to us"
            )
        return f"{self._name} is silent"

    def _tell_once(self, text: str) -> None:
        if text != self._told:
            self._told = text
            self._say(text)


def look(client: Client, *, web: bool) -> None:
    """Until Ctrl-C, or until the viewer is closed. Ends this process, whatever Rerun still waits for."""
    for number in ENDING:
        signal.signal(number, _interrupt)
    code = 0
    try:
        with LiveViewer(web=web) as viewer:
            where = f"look at {viewer.page}" if viewer.page else "the viewer is open"
            console.print(f"{where} (Ctrl-C ends it)", highlight=False, soft_wrap=True)
            follower = Follower(client, _sender(viewer.url), complain)
            Thread(target=follower.draw_for_ever, name="draw", daemon=True).start()
            with suppress(KeyboardInterrupt):
                while viewer.wait(LOOK_S):
                    follower.mind()
            _hush()
    except KeyboardInterrupt:
        pass  # before the viewer was there
    except ViewerError as error:
        complain(str(error))
        code = EXIT_NO_VIEWER
    client.close()
    # A stream whose viewer has gone may wait for it for ever at the end of the interpreter (measured with 0.41).
    os._exit(code)


def _hush() -> None:
    """That the viewer is gone, which ends now, is an error to Rerun and none to a person."""
    sys.stdout.flush()
    sys.stderr.flush()
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())


def _sender(url: str) -> Opens:
    def opens(recording: rr.RecordingStream, layout: rrb.Blueprint) -> None:
        recording.connect_grpc(url, default_blueprint=layout)

    return opens


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt
