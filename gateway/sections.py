"""What every part of the robot file is made of: numbers with their ranges, names, and what all chassis have."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

NAME_PATTERN = r"^[a-z][a-z0-9_-]{0,31}$"  # also safe as one chunk of a Zenoh key

Name = Annotated[str, Field(pattern=NAME_PATTERN, description="lower case, digits, _ and -, at most 32 characters")]
Metres = Annotated[float, Field(ge=-10.0, le=10.0)]
Length = Annotated[float, Field(ge=1e-3, le=10.0)]
Angle = Annotated[float, Field(ge=-6.3, le=6.3, description="rad")]
Rate = Annotated[float, Field(ge=0.1, le=1000.0, description="Hz")]
Limit = Annotated[float, Field(ge=1e-3, le=1e4, description="m or rad, per s, s^2 or s^3")]
Positive = Annotated[float, Field(ge=1e-6, le=1e6)]
NonNegative = Annotated[float, Field(ge=0.0, le=1e6)]
Height = Annotated[float, Field(gt=0.0, le=10.0, description="m above the floor")]


class Section(BaseModel):
    """A table of the robot file: unknown keys and numbers that are not finite are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Body(Section):
    """Mass properties of the whole robot, used by the simulated world (and by no control law yet)."""

    mass: Annotated[float, Field(gt=0.1, le=5000.0, description="kg")]
    inertia: Annotated[float, Field(gt=1e-4, le=5000.0, description="kg m^2 about the vertical through the centre")]
    joint_friction: NonNegative = 0.0  # N m s/rad at every driven joint
    joint_drag: NonNegative = 0.0  # N m of dry friction and rolling resistance at every driven joint
    joint_inertia: NonNegative = 0.0  # kg m^2 of every driven joint, rotor included, at the output
    centre_height: Height | None = (
        None  # of the centre of mass; unknown: acceleration shifts no load between the wheels
    )
