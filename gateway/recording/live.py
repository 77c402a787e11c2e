"""One run of a robot as it is seen live: the entities, units and layout of a session, in a recording of its own."""

import time
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise

import rerun as rr
import rerun.blueprint as rrb

from gateway.config import RobotConfig
from gateway.recording.blueprint import blueprint
from gateway.recording.columns import Times
from gateway.recording.failures import RecordingOffError
from gateway.recording.packets import Gap
from gateway.recording.schema import APPLICATION_ID
from gateway.recording.views import Views, draw_events
from gateway.types import Event, Sample

# Gives a recording with this layout somewhere to go: to a viewer, to a file.
Opens = Callable[[rr.RecordingStream, rrb.Blueprint], None]
MISSING = "they did not arrive here"


class LiveRecording:
    """Draws samples as they come. `run`: of the service; another run is another recording. Its calls may block.

    Raises RecordingOffError at construction.
    """

    def __init__(self, config: RobotConfig, config_text: str, run: str, opens: Opens) -> None:
        name = config.robot.name
        self._recording = rr.RecordingStream(APPLICATION_ID, recording_id=f"{name}-live-{run}", send_properties=False)
        if not rr.is_enabled(recording=self._recording):
            raise RecordingOffError("Rerun is switched off (RERUN=off in the environment): nothing can be shown")
        rr.set_strict_mode(True)  # a mistake in a column is an error, not a warning and a hole
        self._views = Views(config)
        self._newest: Sample | None = None
        self._drawn_s = 0.0  # monotonic, of the newest
        opens(self._recording, blueprint(config, follow=True))
        self._recording.send_recording_name(f"{name} live {time.strftime('%H:%M:%S')}")
        self._views.begin(self._recording, config_text)

    def draw(self, samples: Sequence[Sample]) -> None:
        """The next batch; what is missing in front of and within it is said in the events.

        Raises whatever it is where that is no drive of this robot.
        """
        for piece in _pieces(samples):
            self._views.draw(self._recording, piece, self._gaps(piece[0]))
            self._newest, self._drawn_s = piece[-1], time.monotonic()

    def _gaps(self, sample: Sample) -> list[Gap]:
        """In front of this one."""
        if self._newest is None or sample.since <= self._newest.cycle + 1:
            return []
        return [Gap(self._newest.cycle + 1, sample.since - 1, MISSING)]

    def say(self, event: Event) -> None:
        """A line in the events that is not the robot's, as of now; before the first sample nothing."""
        if self._newest is not None:
            silent_ns = round((time.monotonic() - self._drawn_s) * 1e9)
            when = Times([self._newest.cycle], [self._newest.wall_ns + silent_ns]).at([0])
            draw_events(self._recording, [event], when)

    def close(self) -> None:
        """What was drawn is sent."""
        self._recording.disconnect()


def _pieces(samples: Sequence[Sample]) -> Iterator[Sequence[Sample]]:
    """Without a gap within."""
    breaks = [place for place in range(1, len(samples)) if samples[place].since > samples[place - 1].cycle + 1]
    for start, end in pairwise([0, *breaks, len(samples)]):
        if start < end:
            yield samples[start:end]
