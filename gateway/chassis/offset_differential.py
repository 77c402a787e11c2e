"""Two driven wheels whose axle lies d1 behind a driven platform joint, and a passive caster (MOBY, Otbot)."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from gateway.chassis.contract import Drawing, DrawnWheel, LoopLimit
from gateway.kinematics.offset_differential import PLATFORM, CasterGeometry, OffsetDifferentialKinematics
from gateway.sections import Body, Length, Name, Section
from gateway.types import PLANAR, Rates

# ln(1 + 2/(k - 1)) of the pull-region compensation with k = 2: mirror-image decay (preprints202312.1327, Eq. 23)
_COMPENSATION = 1.0986122886681098


class Caster(Section):
    """The passive caster: trail d3, joint distance d4 ahead of the pivot, wheel radius Rc."""

    trail: Length
    position: Length
    radius: Length

    def geometry(self) -> CasterGeometry:
        """The same for the kinematics."""
        return CasterGeometry(self.trail, self.position, self.radius)


class OffsetDifferentialRobot(Section):
    """Two driven wheels whose axle lies `axle_offset` behind a driven platform joint (MOBY, Otbot)."""

    GEOMETRY: ClassVar[str] = "wheel_radius, axle_offset and track"
    AXES: ClassVar[tuple[str, ...]] = PLANAR

    kind: Literal["offset_differential"]
    name: Name
    body: Body
    chassis_inertia: Annotated[float, Field(gt=1e-4, le=5000.0, description="kg m^2, the chassis below the joint")]
    wheel_radius: Length
    axle_offset: Length  # d1 of the paper
    track: Length  # d2
    left: Name
    right: Name
    platform: Name
    caster: Caster | None = None

    def motor_names(self) -> tuple[str, ...]:
        """Left wheel, right wheel, platform joint."""
        return (self.left, self.right, self.platform)

    def kinematics(self) -> OffsetDifferentialKinematics:
        """From radius, offset and track; the caster is passive."""
        caster = None if self.caster is None else self.caster.geometry()
        return OffsetDifferentialKinematics(
            wheel_radius=self.wheel_radius, axle_offset=self.axle_offset, track=self.track, caster=caster
        )

    def masses(self) -> Rates:
        """The whole body; that of a chassis below its joint is left out."""
        return (self.body.mass, self.body.mass, self.body.inertia)

    def drawing(self) -> Drawing:
        """The axle lies behind the joint, which is the middle of the body above; both turn against each other."""
        rear, half, radius = -self.axle_offset, self.track / 2, self.wheel_radius
        front = self.caster.position if self.caster is not None else self.axle_offset
        return Drawing(
            reach=max(self.axle_offset, half),
            wheels=(DrawnWheel(rear, half, 0.0, radius), DrawnWheel(rear, -half, 0.0, radius)),
            frame=((rear, half), (front, half / 2), (front, -half / 2), (rear, -half), (rear, half)),
            beneath=PLATFORM,
        )

    def loop_limits(self, top_speed: float) -> tuple[LoopLimit, ...]:
        """h < ln(1 + 2/(k - 1)) d1 / c: beyond it sampled compensation swings (science 1.4, e^a < 3 for k = 2)."""
        return (LoopLimit("compensation", _COMPENSATION * self.axle_offset / top_speed),)
