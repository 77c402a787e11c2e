"""What people see of a session: plots, modes, events, CAN in words, the robot from above. Never read back.

How this works
--------------
Everything here follows from the inputs, which are recorded whole (`gateway.recording.schema`), so it is drawn at a
viewing rate: plots 50 times a second, the robot 20 times, and of each CAN message the first of every half second, so
that a rare one is always there. Of the loop's timing the worst since the point before is drawn. Plotted numbers have
six digits. Every cycle and every frame can be had later, exactly: `drivegate replay trace`, `drivegate replay can`.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import rerun as rr

from drivers.contract import CanFrame
from gateway.config import RobotConfig
from gateway.core.channels import Layout, channels_of, entities, owners
from gateway.core.frame_words import FrameWords
from gateway.recording.columns import Integers, Times
from gateway.recording.packets import Gap, Record
from gateway.recording.shapes import CHASSIS_PATH, COMMANDED, MEASURED, PATH, ROBOT, colours, send_shapes
from gateway.types import Event, Level, Mode, Pose, Trace, Twist

CHANNELS_ROOT = "/trace"
LOOP = "/trace/loop"
MODE = "/trace/mode"
EVENTS = "/trace/events"
CAN_IN = "/trace/can/in"
CAN_OUT = "/trace/can/out"

PLOT_PERIOD_NS = 20_000_000
PICTURE_PERIOD_NS = 50_000_000
CAN_PERIOD_NS = 500_000_000
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
FrameKey = tuple[object, ...]  # bus and id


class Views:
    """Sends the pictures of each batch; keeps the few values that go on from batch to batch and segment to segment."""

    def __init__(self, config: RobotConfig) -> None:
        self._config = config
        self._names = tuple(motor.name for motor in config.motors_in_order())
        self._joint = config.robot.drawing().beneath
        self._owners = owners(config)
        self._entities = entities(channels_of(config))  # each costs a kilobyte per batch
        self._layouts = {entity: Layout(self._owners, channels) for entity, channels in self._entities.items()}
        self._mode: Mode | None = None
        self._words = FrameWords(config)
        self._plot = self._picture = self._slot = -1
        self._seen: dict[str, set[FrameKey]] = {CAN_IN: set(), CAN_OUT: set()}
        self._joint_angle = 0.0
        self._path_end: Pose | None = None

    def begin(self, recording: rr.RecordingStream) -> None:
        """Everything static, which Rerun keeps only in the segment it was sent to."""
        self._mode = None
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

    def send(self, recording: rr.RecordingStream, records: Sequence[Record], gaps: Sequence[Gap], times: Times) -> None:
        """The pictures of one batch."""
        traces = [record.outputs.trace for record in records]
        plotted, self._plot = _places(times, PLOT_PERIOD_NS, self._plot)
        if plotted.size:
            when = times.at(plotted)
            self._send_plots(recording, [traces[place] for place in plotted], when)
            self._send_loop(recording, records, plotted, when)
        self._send_modes(recording, records, times)
        self._send_events(recording, records, gaps, times)
        self._send_can(recording, records, times)
        self._send_pictures(recording, traces, times)

    def _send_plots(self, recording: rr.RecordingStream, traces: Sequence[Trace], when: list[rr.TimeColumn]) -> None:
        for entity, layout in self._layouts.items():
            numbers = np.array([layout.row(trace) for trace in traces], np.float64)  # None: NaN, a hole in the line
            if not np.isnan(numbers).all():
                recording.send_columns(f"{CHANNELS_ROOT}/{entity}", when, rr.Scalars.columns(scalars=_shown(numbers)))

    @staticmethod
    def _send_loop(
        recording: rr.RecordingStream, records: Sequence[Record], places: Integers, when: list[rr.TimeColumn]
    ) -> None:
        """The worst of the cycles since the point before, so that none of them hides between two points."""
        spent = np.array([(record.timing.late_ns, record.timing.work_ns) for record in records], np.float64) * 1e-6
        begins = np.concatenate([[0], places[:-1] + 1])
        worst = np.maximum.reduceat(spent[: places[-1] + 1], begins)
        recording.send_columns(LOOP, when, rr.Scalars.columns(scalars=_shown(worst)))

    def _send_modes(self, recording: rr.RecordingStream, records: Sequence[Record], times: Times) -> None:
        changes: list[int] = []
        for place, record in enumerate(records):
            if record.outputs.mode is not self._mode:
                self._mode = record.outputs.mode
                changes.append(place)
        if changes:
            modes = [records[place].outputs.mode.value for place in changes]
            recording.send_columns(MODE, times.at(np.array(changes)), rr.StateChange.columns(state=modes))

    @staticmethod
    def _send_events(
        recording: rr.RecordingStream, records: Sequence[Record], gaps: Sequence[Gap], times: Times
    ) -> None:
        """Events of the core, and gaps of the recording as a person should see them."""
        said = [
            (0, Event(Level.WARNING, "gap", f"cycles {gap.first_cycle} to {gap.last_cycle} are missing: {gap.reason}"))
            for gap in gaps
        ]
        said += [(place, event) for place, record in enumerate(records) for event in record.outputs.events]
        if said:
            columns = rr.TextLog.columns(
                text=[f"{event.code}: {event.text}" for _, event in said],
                level=[_LEVELS[event.level] for _, event in said],
            )
            recording.send_columns(EVENTS, times.at(np.array([place for place, _ in said])), columns)

    def _send_can(self, recording: rr.RecordingStream, records: Sequence[Record], times: Times) -> None:
        """Of each message the first of every half second, as message, motor and fields."""
        shown: dict[str, list[tuple[int, CanFrame]]] = {CAN_IN: [], CAN_OUT: []}
        for place, record in enumerate(records):
            slot = record.inputs.now_ns // CAN_PERIOD_NS
            if slot != self._slot:
                self._slot = slot
                for seen in self._seen.values():
                    seen.clear()
            for path, frames in ((CAN_IN, record.inputs.frames), (CAN_OUT, record.outputs.frames)):
                for frame in frames:
                    key = frame[:2]
                    if key not in self._seen[path]:
                        self._seen[path].add(key)
                        shown[path].append((place, frame))
        for path, chosen in shown.items():
            if chosen:
                texts = rr.TextLog.columns(text=[self._words.of(frame) for _, frame in chosen])
                recording.send_columns(path, times.at(np.array([place for place, _ in chosen])), texts)

    def _send_pictures(self, recording: rr.RecordingStream, traces: Sequence[Trace], times: Times) -> None:
        places, self._picture = _places(times, PICTURE_PERIOD_NS, self._picture)
        if not places.size:
            return
        shown = [traces[place] for place in places]
        when = times.at(places)
        poses = np.array([trace.pose for trace in shown], np.float64)
        flat = np.column_stack((poses[:, :2], np.zeros(len(shown))))
        recording.send_columns(ROBOT, when, rr.Transform3D.columns(translation=flat, quaternion=_turned(poses[:, 2])))
        if self._joint is not None:
            angles = self._joint_angles(shown)
            recording.send_columns(CHASSIS_PATH, when, rr.Transform3D.columns(quaternion=_turned(-angles)))
        for path, twists in ((COMMANDED, [t.target for t in shown]), (MEASURED, [t.measured for t in shown])):
            recording.send_columns(path, when, rr.Arrows3D.columns(vectors=_arrows(twists)))
        self._send_path(recording, shown, places, times)

    def _joint_angles(self, traces: Sequence[Trace]) -> Floats:
        """Platform relative to chassis (rad); the last known angle where it was not measured."""
        angles = []
        for trace in traces:
            position = trace.wheel_positions[self._joint or 0]
            if position is not None:
                self._joint_angle = position
            angles.append(self._joint_angle)
        return np.array(angles)

    def _send_path(
        self, recording: rr.RecordingStream, traces: Sequence[Trace], places: Integers, times: Times
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
            recording.send_columns(PATH, times.at(np.array(drawn)), columns)


def _shown(numbers: Floats) -> Floats:
    """To six digits: the lower half of a float64, which is noise to Rerun's LZ4 and to the eye, is zero."""
    return (numbers.view(np.uint64) & _UPPER_HALF).view(np.float64)


def _places(times: Times, period_ns: int, slot: int) -> tuple[Integers, int]:
    """The first cycle of each period, after that of number `slot`; and the number of the last period."""
    slots = times.mono // period_ns
    return np.flatnonzero(np.diff(slots, prepend=slot) != 0), int(slots[-1])


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
