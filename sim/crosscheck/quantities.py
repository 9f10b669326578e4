"""The quantities of a cross-check, with units and tolerances, and what is measured of each."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from planner.arrays import check_fields
from planner.spatial import FloatArray


@dataclass(frozen=True, kw_only=True)
class Tolerances:
    """What counts as equal.

    Attributes:
        kinematics: Poses, Jacobians, axes and centres of mass, m and rad.
        dynamics: Mass matrix, forces and accelerations, relative.
        parameters: Masses, inertias, limits and the like, relative.
        distance: Distances of geometries that are apart, and what geometries span, m.
        normal: Angle between the directions of these distances, rad. Where the distance is exact
            to e, a surface of radius r gives its direction to sqrt(2 e / r) only.
    """

    kinematics: float = 1e-10
    dynamics: float = 1e-9
    parameters: float = 1e-9
    distance: float = 2e-6
    normal: float = 1e-3

    def __post_init__(self) -> None:
        """Refuse what cannot be a tolerance."""
        check_fields(self, what="tolerance ", least=0.0)


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """One row of the table.

    Attributes:
        title: Its name.
        unit: "m", "rad", "m/s2" or "relative"; "" for what is there or is not.
        group: "structure", "parameters", "kinematics", "dynamics", "couplings" or "geometry".
        tolerance: Which of ``Tolerances`` judges it; None if every difference counts.
        parts: Kind of part that it belongs to.
    """

    title: str
    unit: str
    group: str
    tolerance: str | None
    parts: str


def _rows() -> tuple[Quantity, ...]:
    table = """
        joints present | | structure | | joint
        bodies present | | structure | | body
        sites present | | structure | | site
        joint kind | | structure | | joint
        geometries present | | structure | | geom
        geometry kind | | structure | | geom
        body offset | m | parameters | kinematics | body
        body turn | rad | parameters | kinematics | body
        joint axis | rad | parameters | kinematics | joint
        joint anchor | m | parameters | kinematics | joint
        site offset | m | parameters | kinematics | site
        site turn | rad | parameters | kinematics | site
        gravity | m/s2 | parameters | kinematics | model
        joint range | relative | parameters | parameters | joint
        armature | relative | parameters | parameters | joint
        damping | relative | parameters | parameters | joint
        dry friction | relative | parameters | parameters | joint
        effort limit | relative | parameters | parameters | joint
        velocity limit | relative | parameters | parameters | joint
        mass | relative | parameters | parameters | body
        link centre | m | parameters | kinematics | body
        inertia | relative | parameters | parameters | body
        geometry | m | parameters | distance | geom
        geometry size | m | parameters | distance | geom
        geometry offset | m | parameters | kinematics | geom
        geometry turn | rad | parameters | kinematics | geom
        body position | m | kinematics | kinematics | body
        body orientation | rad | kinematics | kinematics | body
        site position | m | kinematics | kinematics | site
        site orientation | rad | kinematics | kinematics | site
        body Jacobian | m, rad | kinematics | kinematics | body
        site Jacobian | m, rad | kinematics | kinematics | site
        centre of mass | m | kinematics | kinematics | body
        mass matrix | relative | dynamics | dynamics | joint
        Coriolis force | relative | dynamics | dynamics | joint
        gravity force | relative | dynamics | dynamics | joint
        forward dynamics | relative | dynamics | dynamics | joint
        equality rows | relative | couplings | parameters | equality
        distance | m | geometry | distance | pair
        normal | rad | geometry | normal | pair
        distance in overlap | m | overlap | distance | pair
    """
    out = []
    for line in table.strip().splitlines():
        title, unit, group, tolerance, parts = (cell.strip() for cell in line.split("|"))
        out.append(
            Quantity(title=title, unit=unit, group=group, tolerance=tolerance or None, parts=parts)
        )
    return tuple(out)


QUANTITIES = {quantity.title: quantity for quantity in _rows()}
"""Title -> quantity, in the order of the table."""


@dataclass(frozen=True, kw_only=True)
class Difference:
    """One quantity of one part that is not equal.

    Attributes:
        quantity: Title of the quantity.
        part: Name of the part (joint, body, site, pair).
        error: In the quantity's unit; infinite where one side has no value.
        tolerance: What was allowed.
        state: Number of the configuration; -1 where it does not matter.
        reference: The reference's value, for people.
        value: The other side's value, for people.
        cause: Key of a known cause, or "".
        reason: The cause in words, or "".
    """

    quantity: str
    part: str
    error: float
    tolerance: float
    state: int = -1
    reference: str = ""
    value: str = ""
    cause: str = ""
    reason: str = ""

    def __str__(self) -> str:
        """For people."""
        unit = QUANTITIES[self.quantity].unit
        size = f" by {self.error:.2g} {unit}".rstrip() if np.isfinite(self.error) and unit else ""
        values = f": {self.reference} here, {self.value} there" if self.reference else ""
        reason = f" ({self.reason})" if self.reason else ""
        return f"{self.quantity} of {self.part} differs{size}{values}{reason}"


@dataclass(kw_only=True)
class Tally:
    """What has been measured so far between the reference and one other side.

    Attributes:
        tolerances: What counts as equal.
        count: Quantity -> comparisons made.
        worst: Quantity -> largest error, its part and its configuration.
        differences: (quantity, part) -> worst difference beyond tolerance.
    """

    tolerances: Tolerances
    count: dict[str, int] = field(default_factory=dict)
    worst: dict[str, tuple[float, str, int]] = field(default_factory=dict)
    differences: dict[tuple[str, str], Difference] = field(default_factory=dict)

    def allowed(self, quantity: str) -> float:
        """Tolerance of a quantity."""
        name = QUANTITIES[quantity].tolerance
        return 0.0 if name is None else float(getattr(self.tolerances, name))

    def add(
        self,
        quantity: str,
        part: str,
        error: float,
        *,
        state: int = -1,
        values: tuple[FloatArray | str, FloatArray | str] = ("", ""),
    ) -> None:
        """Take note of one comparison.

        Args:
            quantity: Title of the quantity.
            part: Name of the part.
            error: In the quantity's unit; NaN counts as infinite.
            state: Number of the configuration.
            values: Both values, to show them to people.
        """
        error = float("inf") if np.isnan(error) else float(error)
        self.count[quantity] = self.count.get(quantity, 0) + 1
        if quantity not in self.worst or error > self.worst[quantity][0]:
            self.worst[quantity] = (error, part, state)
        known = self.differences.get((quantity, part))
        if error > self.allowed(quantity) and (known is None or error > known.error):
            reference, value = (_text(v) for v in values)
            self.differences[quantity, part] = Difference(
                quantity=quantity,
                part=part,
                error=error,
                tolerance=self.allowed(quantity),
                state=state,
                reference=reference,
                value=value,
            )


def _text(value: FloatArray | str) -> str:
    if isinstance(value, str):
        return value
    flat = np.ravel(value)
    words = " ".join(f"{v:.6g}" for v in flat)
    return words if len(flat) == 1 else f"({words})"
