"""MuJoCo's contacts as a ``ContactSet``, so that execution is judged by the code that planned it.

MuJoCo's conventions and what becomes of them:

  - ``contact.frame`` holds [normal, t1, t2] in its ROWS, the normal points from geom 1 to geom 2.
    Where the object is geom 1 the normal is turned round, and t1 with it, so that the frame stays
    right-handed and the normal points into the object.
  - ``mj_contactForce`` gives the force on geom 2 in that frame. On geom 1 it is the opposite: in
    the turned frame its normal and t1 components and its torsional torque keep their values, and
    its t2 component changes sign.
  - condim 1, 3, 4 are "frictionless", "point" and "soft"; condim 6 is read as "soft", its rolling
    part left out.

Forces belong to the positions of the same step: after ``mj_step`` both are those at its beginning.
"""

from __future__ import annotations

from sim.contacts.history import (
    ContactHistory,
    ContactRows,
    contacts_from_mujoco,
    hand_contacts,
    merge_per_finger,
    with_planned_friction,
)
from sim.contacts.reading import (
    NO_FORCE,
    Touch,
    normal_forces,
    object_contacts,
    other_touches,
)

__all__ = [
    "NO_FORCE",
    "ContactHistory",
    "ContactRows",
    "Touch",
    "contacts_from_mujoco",
    "hand_contacts",
    "merge_per_finger",
    "normal_forces",
    "object_contacts",
    "other_touches",
    "with_planned_friction",
]
