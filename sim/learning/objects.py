"""``ObjectRange``: an object of which dimensions are drawn: ``cylinder:0.025..0.035x0.08``."""

from __future__ import annotations

import re
from dataclasses import dataclass

from planner.errors import ObjectError, shown
from planner.objects import GraspObject, parse_object

_RANGE = re.compile(r"(-?\d*\.?\d+)\.\.(-?\d*\.?\d+)")
"""Two numbers with two dots between them; a sign is read so that the object can refuse it."""

STEP = 5e-5
"""Sizes are rounded to this, m: a tenth of a millimetre in diameter."""


@dataclass(frozen=True)
class ObjectRange:
    """An object as ``parse_object`` takes it; a dimension may be a range ``a..b``, m.

    All ranges are drawn together, so a block that is square stays square.

    Attributes:
        text: As it was given.
    """

    text: str

    def __post_init__(self) -> None:
        """Check both ends.

        Raises:
            PlannerError: An end is no object, or a range whose end is below its beginning.
        """
        for low, high in _RANGE.findall(self.text):
            if float(low) > float(high):
                raise ObjectError(
                    f"the range {low}..{high} of {shown(self.text)} ends below its beginning; give "
                    f"{high}..{low}"
                )
        for share in (0.0, 1.0):
            parse_object(self.at(share))

    def at(self, share: float) -> str:
        """The object at a share of all ranges, 0 to 1."""

        def drawn(found: re.Match[str]) -> str:
            low, high = (float(v) for v in found.groups())
            return f"{STEP * round((low + share * (high - low)) / STEP):.6g}"

        return _RANGE.sub(drawn, self.text)

    def holds(self, item: GraspObject) -> bool:
        """Whether an object is of this kind, and its extents between those of both ends."""
        low, high = (parse_object(self.at(share)).shape for share in (0.0, 1.0))
        shape = item.shape
        return type(shape) is type(low) and bool(
            (shape.half_extents >= low.half_extents - STEP).all()
            and (shape.half_extents <= high.half_extents + STEP).all()
        )
