"""How far a robot's true dimensions may be from those that its file describes."""

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from castor_envs.description import CONFIG

Relative = Annotated[float, Field(ge=0, le=0.3)]


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class Tolerances:
    """Standard deviations of true dimensions about those described, as a data sheet or a calibration states them.

    radius, lateral, offset: relative. pivot: of each coordinate of a castor's pivot, m. pivot_zero: of the zero of
    pivot encoders and of the angle of fixed castors, rad.

    Errors of different wheels and castors are independent.
    """

    radius: Relative = 0.0
    lateral: Relative = 0.0
    offset: Relative = 0.0
    pivot: Annotated[float, Field(ge=0, le=1.0)] = 0.0
    pivot_zero: Annotated[float, Field(ge=0, le=0.5)] = 0.0
