"""What people see of a session: plots, modes, events, CAN in words, the robot from above. Never read back.

How this works
--------------
Everything here follows from the inputs, which are recorded whole (`gateway.recording.schema`), so samples of the drive
are drawn (`gateway.core.samples`), in a session and for whoever looks on live (`gateway.recording.live`). Plotted
numbers have six digits. Every cycle and every frame can be had later, exactly: `drivegate replay trace`, `drivegate
replay can`.
"""

from collections.abc import Iterable, Sequence

import numpy as np
import numpy.typing as npt
import rerun as rr

from gateway.config import RobotConfig
from gateway.core.channels import Layout, channels_of, entities, owners
from gateway.core.frame_words import FrameWords
from gateway.core.samples import Sampler
from gateway.recording.columns import Times, arrays
from gateway.recording.packets import Gap, Record
from gateway.recording.schema import STATUS_ARCHETYPE, STATUS_COLUMNS, STATUS_PATH, status_row
from gateway.recording.shapes import CHASSIS_PATH, COMMANDED, MEASURED, PATH, ROBOT, colours, send_shapes
from gateway.types import Event, Level, Mode, Pose, Sample, Trace, Twist

CHANNELS_ROOT = "/trace"
LOOP = "/trace/loop"
MODE = "/trace/mode"
EVENTS = "/trace/events"
CAN_IN = "/trace/can/in"
CAN_OUT = "/trace/can/out"
CONFIG = "/config"

PATH_STEP = 0.01  # m; a standing robot draws nothing
ARROW_SECONDS = 0.8  # an arrow is as long as the way of this time

MODE_COLOURS = {
    Mode.IDLE: 0x78909CFF,
    Mode.STARTING: 0x29B6F6FF,
    Mode.DRIVE: 0x43A047FF,
    Mode.DEGRADED: 0xFFB300FF,
    Mode.STOPPING: 0x8E7CC3FF,
    Mode.ESTOP: 0xE53935FF,
    Mode.FAULT: 0xAD1457FF,
}
_LEVELS = {
    Level.INFO: rr.TextLogLevel.INFO,
    Level.WARNING: rr.TextLogLevel.WARN,
    Level.ERROR: rr.TextLogLevel.ERROR,
}

Floats = npt.NDArray[np.float64]
_UPPER_HALF = np.uint64(0xFFFF_FFFF_0000_0000)  # 20 of the 52 bits of the fraction


class Views:
    """Draws the samples of each batch; keeps the few values that go on from batch to batch and segment to segment."""

    def __init__(self, config: RobotConfig) -> None:
        self._config = config
        self._joint = config.robot.drawing().beneath
        self._owners = owners(config)
        self._entities = entities(channels_of(config))  # each costs a kilobyte per batch
        self._layouts = {entity: Layout(self._owners, channels) for entity, channels in self._entities.items()}
        self._blank = dict.fromkeys(self._layouts, True)  # whether its last row had no number
        self._mode: Mode | None = None
        self._words = FrameWords(config)
        self._sampler = Sampler()
        self._joint_angle = 0.0
        self._path_end: Pose | None = None

    def begin(self, recording: rr.RecordingStream, config_text: str) -> None:
        """Everything static, which Rerun keeps only in the segment it was sent to."""
        self._mode = None
        shown = f"```toml\n{config_text}\n```"
        recording.log(CONFIG, rr.TextDocument(shown, media_type=rr.MediaType.MARKDOWN), static=True)
        for entity, channels in self._entities.items():
            asked, measured = (
                [label for channel in channels if channel.asked is wanted for label in channel.labels(self._owners)]
                for wanted in (True, False)
            )
            _lines(recording, f"{CHANNELS_ROOT}/{entity}", measured, asked=asked)
        _lines(recording, LOOP, ["late [ms]", "work [ms]"])
        words = [mode.value for mode in MODE_COLOURS]
        styles = rr.StateConfiguration(
            values=words, labels=words, colors=np.array(list(MODE_COLOURS.values()), np.uint32)
        )
        recording.log(MODE, styles, static=True)
        send_shapes(recording, self._config)

    def send(self, recording: rr.RecordingStream, records: Iterable[Record], gaps: Sequence[Gap]) -> None:
        """The pictures of one batch of cycles."""
        found = (self._sampler.step(record.inputs, record.outputs, record.timing) for record in records)
        self.draw(recording, [sample for sample in found if sample is not None], gaps)

    def draw(self, recording: rr.RecordingStream, samples: Sequence[Sample], gaps: Sequence[Gap]) -> None:
        """The pictures of one batch of samples; gaps are in front of the first of them."""
        if not samples:
            return
        times = Times([sample.cycle for sample in samples], [sample.wall_ns for sample in samples])
        self._draw_plots(recording, samples, times)
        self._draw_modes(recording, samples, times)
        _draw_events(recording, samples, gaps, times)
        self._draw_can(recording, samples, times)
        self._draw_pictures(recording, samples, times)
        _draw_status(recording, samples, times)

    def _draw_plots(self, recording: rr.RecordingStream, samples: Sequence[Sample], times: Times) -> None:
        places = [place for place, sample in enumerate(samples) if sample.plotted]
        if not places:
            return
        plotted = [samples[place] for place in places]
        for entity, layout in self._layouts.items():
            # None: NaN, a hole in the line
            numbers = np.array([layout.row(sample.trace) for sample in plotted if sample.trace is not None], np.float64)
            told = self._told(entity, numbers)
            if told:
                columns = rr.Scalars.columns(scalars=_shown(numbers[told]))
                recording.send_columns(f"{CHANNELS_ROOT}/{entity}", times.at([places[row] for row in told]), columns)
        spent = np.array([(sample.late_ns, sample.work_ns) for sample in plotted], np.float64) * 1e-6
        recording.send_columns(LOOP, times.at(places), rr.Scalars.columns(scalars=_shown(spent)))

    def _told(self, entity: str, numbers: Floats) -> list[int]:
        """Rows that say something: of several without any number the first, however they come in batches."""
        told = []
        for place, row in enumerate(numbers):
            blank = bool(np.isnan(row).all())
            if not (blank and self._blank[entity]):
                told.append(place)
            self._blank[entity] = blank
        return told

    def _draw_modes(self, recording: rr.RecordingStream, samples: Sequence[Sample], times: Times) -> None:
        changes: list[int] = []
        for place, sample in enumerate(samples):
            if sample.mode is not self._mode:
                self._mode = sample.mode
                changes.append(place)
        if changes:
            modes = [samples[place].mode.value for place in changes]
            recording.send_columns(MODE, times.at(changes), rr.StateChange.columns(state=modes))

    def _draw_can(self, recording: rr.RecordingStream, samples: Sequence[Sample], times: Times) -> None:
        """As message, motor and fields."""
        for path, frames in (
            (CAN_IN, [sample.frames_in for sample in samples]),
            (CAN_OUT, [sample.frames_out for sample in samples]),
        ):
            said = [(place, self._words.of(frame)) for place, some in enumerate(frames) for frame in some]
            if said:
                texts = rr.TextLog.columns(text=[text for _, text in said])
                recording.send_columns(path, times.at([place for place, _ in said]), texts)

    def _draw_pictures(self, recording: rr.RecordingStream, samples: Sequence[Sample], times: Times) -> None:
        pictured = [
            (place, sample.trace)
            for place, sample in enumerate(samples)
            if sample.pictured and sample.trace is not None
        ]
        if not pictured:
            return
        places, shown = [place for place, _ in pictured], [trace for _, trace in pictured]
        when = times.at(places)
        poses = np.array([trace.pose for trace in shown], np.float64)
        flat = np.column_stack((poses[:, :2], np.zeros(len(shown))))
        recording.send_columns(ROBOT, when, rr.Transform3D.columns(translation=flat, quaternion=_turned(poses[:, 2])))
        if self._joint is not None:
            angles = self._joint_angles(shown)
            recording.send_columns(CHASSIS_PATH, when, rr.Transform3D.columns(quaternion=_turned(-angles)))
        for path, twists in ((COMMANDED, [t.target for t in shown]), (MEASURED, [t.measured for t in shown])):
            recording.send_columns(path, when, rr.Arrows3D.columns(vectors=_arrows(twists)))
        self._draw_path(recording, shown, places, times)

    def _joint_angles(self, traces: Sequence[Trace]) -> Floats:
        """Platform relative to chassis (rad); the last known angle where it was not measured."""
        angles = []
        for trace in traces:
            position = trace.wheel_positions[self._joint or 0]
            if position is not None:
                self._joint_angle = position
            angles.append(self._joint_angle)
        return np.array(angles)

    def _draw_path(
        self, recording: rr.RecordingStream, traces: Sequence[Trace], places: Sequence[int], times: Times
    ) -> None:
        """One short line per picture in which the robot moved; the viewer shows those of the last minutes together."""
        points, drawn = [], []
        for place, trace in zip(places, traces, strict=True):
            end = self._path_end or trace.pose
            if self._path_end is None or np.hypot(trace.pose.x - end.x, trace.pose.y - end.y) >= PATH_STEP:
                points.append([(end.x, end.y, 0.0), (trace.pose.x, trace.pose.y, 0.0)])
                drawn.append(place)
                self._path_end = trace.pose
        if drawn:
            columns = rr.LineStrips3D.columns(strips=np.array(points, np.float32))
            recording.send_columns(PATH, times.at(drawn), columns)


def draw_events(recording: rr.RecordingStream, events: Sequence[Event], when: list[rr.TimeColumn]) -> None:
    """One line for each."""
    columns = rr.TextLog.columns(
        text=[f"{event.code}: {event.text}" for event in events], level=[_LEVELS[event.level] for event in events]
    )
    recording.send_columns(EVENTS, when, columns)


def _draw_events(recording: rr.RecordingStream, samples: Sequence[Sample], gaps: Sequence[Gap], times: Times) -> None:
    """Events of the core, and gaps of the recording as a person should see them."""
    said = [
        (0, Event(Level.WARNING, "gap", f"cycles {gap.first_cycle} to {gap.last_cycle} are missing: {gap.reason}"))
        for gap in gaps
    ]
    said += [(place, event) for place, sample in enumerate(samples) for event in sample.events]
    if said:
        draw_events(recording, [event for _, event in said], times.at([place for place, _ in said]))


def _draw_status(recording: rr.RecordingStream, samples: Sequence[Sample], times: Times) -> None:
    said = [(place, sample.status) for place, sample in enumerate(samples)]
    rows = [(place, status_row(status)) for place, status in said if status is not None]
    if rows:
        columns = arrays(STATUS_COLUMNS, [row for _, row in rows])
        status = rr.DynamicArchetype.columns(archetype=STATUS_ARCHETYPE, components=columns)
        recording.send_columns(STATUS_PATH, times.at([place for place, _ in rows]), status)


def _shown(numbers: Floats) -> Floats:
    """To six digits: the lower half of a float64, which is noise to Rerun's LZ4 and to the eye, is zero."""
    return (numbers.view(np.uint64) & _UPPER_HALF).view(np.float64)


def _lines(recording: rr.RecordingStream, path: str, measured: Sequence[str], *, asked: Sequence[str] = ()) -> None:
    """What was asked for is drawn wide and pale, so that what was measured lies visibly on top of it."""
    shades = np.array([*colours(len(asked), pale=True), *colours(len(measured))], np.uint32)
    widths = [5.0] * len(asked) + [1.5] * len(measured)
    recording.log(path, rr.SeriesLines(names=[*asked, *measured], colors=shades, widths=widths), static=True)


def _turned(angles: Floats) -> Floats:
    """Quaternions (x, y, z, w) of turns about the vertical."""
    zero = np.zeros_like(angles)
    return np.column_stack((zero, zero, np.sin(angles / 2), np.cos(angles / 2)))


def _arrows(twists: Sequence[Twist | None]) -> Floats:
    """Velocity as a vector; nothing where it is unknown."""
    flat = [(0.0, 0.0, 0.0) if twist is None else (twist.vx, twist.vy, 0.0) for twist in twists]
    return ARROW_SECONDS * np.array(flat)
