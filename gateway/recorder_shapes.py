"""The robot as drawn from above: outlines and wheels at the poses of the robot file. Sent once per segment."""

from collections.abc import Sequence
from math import cos, pi, sin

import numpy as np
import numpy.typing as npt
import rerun as rr

from gateway.config import OffsetDifferentialRobot, OmniRobot, RobotConfig

WORLD = "/trace/world"
PATH = "/trace/world/path"
ROBOT = "/trace/world/robot"
CHASSIS = "/trace/world/robot/chassis"  # turns beneath the platform, which is the robot's frame
SURROUNDINGS = "/trace/world/robot/surroundings"
COMMANDED = "/trace/world/robot/velocity/commanded"
MEASURED = "/trace/world/robot/velocity/measured"

COMMANDED_COLOUR = 0xFFB74DFF
MEASURED_COLOUR = 0x4FC3F7FF
BODY_COLOUR = 0xECEFF1FF
CHASSIS_COLOUR = 0x90A4AEFF
WHEEL_COLOUR = 0x546E7AFF
PATH_COLOUR = 0x66BB6AFF
REACH = 1.1  # m around the robot that the picture shows

# Four hues that stay apart for colour-blind eyes (Okabe and Ito's set, lightened for a dark ground), then repeated.
_HUES = (0x4FC3F7, 0xFFB74D, 0x81C784, 0xF48FB1, 0xFFF176, 0xB39DDB)

Points = npt.NDArray[np.float64]


def colours(count: int, *, pale: bool = False) -> list[int]:
    """RGBA of so many lines; the pale ones go with the strong ones of the same place."""
    return [(_HUES[place % len(_HUES)] << 8) | (0x70 if pale else 0xFF) for place in range(count)]


def send_shapes(recording: rr.RecordingStream, config: RobotConfig) -> None:
    """Everything of the picture that never changes within its own frame."""
    robot = config.robot
    recording.log(WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    if isinstance(robot, OffsetDifferentialRobot):
        _send_offset(recording, robot)
        height = 2.2 * robot.wheel_radius
    else:
        _send_omni(recording, robot)
        height = 2.2 * max(wheel.radius for wheel in robot.wheel)
    recording.log(PATH, rr.LineStrips3D.from_fields(colors=PATH_COLOUR, radii=0.012), static=True)
    recording.log(SURROUNDINGS, rr.Points3D([(REACH, REACH, 0.0), (-REACH, -REACH, 0.0)], radii=1e-5), static=True)
    for path, colour in ((COMMANDED, COMMANDED_COLOUR), (MEASURED, MEASURED_COLOUR)):
        style = rr.Arrows3D.from_fields(colors=colour, radii=0.014, origins=[(0.0, 0.0, height)])
        recording.log(path, style, static=True)


def _send_omni(recording: rr.RecordingStream, robot: OmniRobot) -> None:
    """A wheel rolls at right angles to its axle."""
    top = 2.0 * max(wheel.radius for wheel in robot.wheel)
    reach = max(np.hypot(wheel.x, wheel.y) for wheel in robot.wheel)
    _outline(recording, f"{ROBOT}/body", _circle(reach), height=top, colour=BODY_COLOUR)
    _nose(recording, f"{ROBOT}/body/nose", reach, height=top, colour=BODY_COLOUR)
    _wheels(
        recording,
        f"{ROBOT}/wheels",
        [(wheel.x, wheel.y, wheel.axis_angle + pi / 2, wheel.radius) for wheel in robot.wheel],
    )


def _send_offset(recording: rr.RecordingStream, robot: OffsetDifferentialRobot) -> None:
    """The axle lies behind the joint; the platform is a disc on top, so that the chassis is seen to turn."""
    rear, half = -robot.axle_offset, robot.track / 2
    front = robot.caster.position if robot.caster is not None else robot.axle_offset
    corners = [(rear, half), (front, half / 2), (front, -half / 2), (rear, -half), (rear, half)]
    height = 2.0 * robot.wheel_radius
    _outline(recording, f"{CHASSIS}/frame", np.array(corners), height=robot.wheel_radius, colour=CHASSIS_COLOUR)
    _wheels(
        recording,
        f"{CHASSIS}/wheels",
        [(rear, half, 0.0, robot.wheel_radius), (rear, -half, 0.0, robot.wheel_radius)],
    )
    reach = max(robot.axle_offset, half)
    _outline(recording, f"{ROBOT}/body", _circle(reach), height=height, colour=BODY_COLOUR)
    _nose(recording, f"{ROBOT}/body/nose", reach, height=height, colour=BODY_COLOUR)


def _circle(radius: float) -> Points:
    turns = np.linspace(0.0, 2 * pi, 49)
    return radius * np.column_stack((np.cos(turns), np.sin(turns)))


def _nose(recording: rr.RecordingStream, path: str, reach: float, *, height: float, colour: int) -> None:
    """A pointer to the front, inside the outline."""
    corners = np.array([(0.55, 0.25), (0.95, 0.0), (0.55, -0.25)]) * reach
    _outline(recording, path, corners, height=height, colour=colour)


def _outline(recording: rr.RecordingStream, path: str, points: Points, *, height: float, colour: int) -> None:
    strip = np.column_stack((points, np.full(len(points), height)))
    recording.log(path, rr.LineStrips3D([strip], colors=colour, radii=0.008), static=True)


def _wheels(recording: rr.RecordingStream, path: str, wheels: Sequence[tuple[float, float, float, float]]) -> None:
    """Wheels as (x, y, rolling direction, radius)."""
    boxes = rr.Boxes3D(
        centers=[(x, y, radius) for x, y, _, radius in wheels],
        half_sizes=[(radius, 0.25 * radius, radius) for *_, radius in wheels],
        quaternions=[(0.0, 0.0, sin(roll / 2), cos(roll / 2)) for _, _, roll, _ in wheels],
        colors=WHEEL_COLOUR,
        fill_mode=rr.components.FillMode.Solid,
    )
    recording.log(path, boxes, static=True)
