"""What every part of the robot file is made of: numbers with their ranges, names, and what all chassis have."""

from typing import Annotated, NamedTuple

from pydantic import BaseModel, ConfigDict, Field

NAME_PATTERN = r"^[a-z][a-z0-9_-]{0,31}$"  # also safe as one chunk of a Zenoh key


class Unit(NamedTuple):
    """What a number of the robot file is counted in: goes into the `Annotated` of its key."""

    name: str


class Form(NamedTuple):
    """What a text of the robot file has to be like, in words, for people who do not read regular expressions."""

    words: str


Name = Annotated[
    str, Field(pattern=NAME_PATTERN), Form("lower case letters, digits, _ and -, a letter first, at most 32 of them")
]
Metres = Annotated[float, Field(ge=-10.0, le=10.0), Unit("m")]
Length = Annotated[float, Field(ge=1e-3, le=10.0), Unit("m")]
Angle = Annotated[float, Field(ge=-6.3, le=6.3), Unit("rad")]
Rate = Annotated[float, Field(ge=0.1, le=1000.0), Unit("Hz")]
Limit = Annotated[float, Field(ge=1e-3, le=1e4)]
Positive = Annotated[float, Field(ge=1e-6, le=1e6)]
NonNegative = Annotated[float, Field(ge=0.0, le=1e6)]
Height = Annotated[float, Field(gt=0.0, le=10.0), Unit("m")]


class Section(BaseModel):
    """A table of the robot file: unknown keys and numbers that are not finite are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Body(Section):
    """Mass properties of the whole robot: for the simulated world, and to find a wheel that slips or a torque lost."""

    mass: Annotated[float, Field(gt=0.1, le=5000.0, description="of the whole robot"), Unit("kg")]
    inertia: Annotated[
        float, Field(gt=1e-4, le=5000.0, description="about the vertical through the centre"), Unit("kg m^2")
    ]
    joint_friction: Annotated[
        NonNegative, Field(description="viscous friction of every driven joint, at the output"), Unit("N m s/rad")
    ] = 0.0
    joint_drag: Annotated[
        NonNegative, Field(description="dry friction and rolling resistance of every driven joint"), Unit("N m")
    ] = 0.0
    joint_inertia: Annotated[
        NonNegative, Field(description="of every driven joint, rotor included, at the output"), Unit("kg m^2")
    ] = 0.0
    centre_height: Annotated[
        Height | None,
        Field(
            description="of the centre of mass above the floor; without it acceleration shifts no load between wheels"
        ),
    ] = None
