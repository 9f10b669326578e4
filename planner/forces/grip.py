"""``grip_for_load``: how hard fingers must press where a load is to be expected.

n fingers that press with g each bear, by friction alone, a force of mu n g along their surfaces,
and about the object a torque of that times a lever. So a weight W, a force F and a torque T take

    g = LOAD_SAFETY (W + F + T / lever) / (mu n)

whatever their directions. It is a size to begin with, not a proof: along some directions normals
help, along others one finger stands alone. ``opposable test PLAN --protocol forces`` measures what
a plan bears, ``opposable certify PLAN`` proves what the best control could.
"""

from __future__ import annotations

from dataclasses import dataclass

from planner.arrays import check_fields

LOAD_SAFETY = 1.5
"""Factor on the grip for an expected load (-). What a plan then bears along each axis of the world:
``opposable test PLAN --protocol forces``."""

LEAST_MU = 1e-3
"""Friction (-) below which a grip does not grow any more."""


@dataclass(frozen=True, kw_only=True)
class ExpectedLoad:
    """The largest disturbance that a held object is to bear, in any direction.

    Attributes:
        force: At the centre of mass, N.
        torque: About it, N m; on top of the force.
    """

    force: float = 0.0
    torque: float = 0.0

    def __post_init__(self) -> None:
        """Check both numbers.

        Raises:
            TaskError: One is negative or not finite.
        """
        for name, unit in (("force", "N"), ("torque", "N m")):
            check_fields(self, (name,), what="the expected ", least=0.0, unit=unit)

    def __bool__(self) -> bool:
        """Whether anything is expected."""
        return self.force > 0 or self.torque > 0


def grip_for_load(
    load: ExpectedLoad, *, weight: float, lever: float, mu: float, n_contacts: int
) -> float:
    """Least normal force of each finger for a load on top of a weight, N.

    Args:
        load: What is to be borne.
        weight: Of the object, N.
        lever: What turns a torque into a force at the contacts, m; the radius of the object's
            bounding sphere serves.
        mu: Friction that may be relied on (-).
        n_contacts: Fingers that press, at least 1.
    """
    total = weight + load.force + load.torque / lever
    return LOAD_SAFETY * total / (max(mu, LEAST_MU) * n_contacts)
