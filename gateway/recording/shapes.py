"""The robot as drawn from above: outlines and wheels at the poses of the robot file. Sent once per segment.

A flat drawing: heights only say what lies on top of what.
"""

from collections.abc import Sequence
from math import cos, pi, sin

import numpy as np
import numpy.typing as npt
import rerun as rr

from gateway.chassis.contract import DrawnWheel
from gateway.config import RobotConfig

WORLD = "/trace/world"
PATH = "/trace/world/path"
ROBOT = "/trace/world/robot"
CHASSIS_PATH = "/trace/world/robot/chassis"  # turns beneath the platform, which is the robot's frame
BODY = "/trace/world/robot/body"
COMMANDED = "/trace/world/robot/velocity/commanded"
MEASURED = "/trace/world/robot/velocity/measured"

COMMANDED_COLOUR = 0xFFB74DFF
MEASURED_COLOUR = 0x4FC3F7FF
BODY_COLOUR = 0xA98FD6FF  # to be seen on the dark ground of the viewer and on the light one
CHASSIS_COLOUR = 0x90A4AEFF
WHEEL_COLOUR = 0x607D8BFF
PATH_COLOUR = 0x66BB6AFF

WHEEL_HEIGHT = 0.01
CHASSIS_HEIGHT = 0.02
BODY_HEIGHT = 0.03
COMMANDED_HEIGHT = 0.04
MEASURED_HEIGHT = 0.07
LINE = 0.006  # m, half the width

# Hues that stay apart for colour-blind eyes on a dark ground; repeated after the sixth.
_HUES = (0x4FC3F7, 0xFFB74D, 0x81C784, 0xF48FB1, 0xFFF176, 0xB39DDB)

Points = npt.NDArray[np.float64]


def colours(count: int, *, pale: bool = False) -> list[int]:
    """RGBA of so many lines; the pale ones go with the strong ones of the same place."""
    return [(_HUES[place % len(_HUES)] << 8) | (0x70 if pale else 0xFF) for place in range(count)]


def send_shapes(recording: rr.RecordingStream, config: RobotConfig) -> None:
    """Everything of the picture that never changes within its own frame."""
    drawing = config.robot.drawing()
    recording.log(WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    size, below = drawing.reach, ROBOT if drawing.beneath is None else CHASSIS_PATH
    _wheels(recording, f"{below}/wheels", drawing.wheels)
    if drawing.frame:
        _outline(recording, f"{below}/frame", np.array(drawing.frame), height=CHASSIS_HEIGHT, colour=CHASSIS_COLOUR)
    _outline(recording, BODY, _circle(size), height=BODY_HEIGHT, colour=BODY_COLOUR)
    pointer = np.array([(0.55, 0.25), (0.95, 0.0), (0.55, -0.25)]) * size
    _outline(recording, f"{BODY}/front", pointer, height=BODY_HEIGHT, colour=BODY_COLOUR)
    recording.log(PATH, rr.LineStrips3D.from_fields(colors=PATH_COLOUR, radii=LINE), static=True)
    for path, colour, height, radius in (
        (COMMANDED, COMMANDED_COLOUR, COMMANDED_HEIGHT, 0.018),
        (MEASURED, MEASURED_COLOUR, MEASURED_HEIGHT, 0.008),
    ):
        style = rr.Arrows3D.from_fields(colors=colour, radii=radius, origins=[(0.0, 0.0, height)])
        recording.log(path, style, static=True)


def _circle(radius: float) -> Points:
    turns = np.linspace(0.0, 2 * pi, 49)
    return radius * np.column_stack((np.cos(turns), np.sin(turns)))


def _outline(recording: rr.RecordingStream, path: str, points: Points, *, height: float, colour: int) -> None:
    strip = np.column_stack((points, np.full(len(points), height)))
    recording.log(path, rr.LineStrips3D([strip], colors=colour, radii=LINE), static=True)


def _wheels(recording: rr.RecordingStream, path: str, wheels: Sequence[DrawnWheel]) -> None:
    boxes = rr.Boxes3D(
        centers=[(x, y, WHEEL_HEIGHT / 2) for x, y, _, _ in wheels],
        half_sizes=[(radius, 0.3 * radius, WHEEL_HEIGHT / 2) for *_, radius in wheels],
        quaternions=[(0.0, 0.0, sin(roll / 2), cos(roll / 2)) for _, _, roll, _ in wheels],
        colors=WHEEL_COLOUR,
        fill_mode=rr.components.FillMode.Solid,
    )
    recording.log(path, boxes, static=True)
