"""Contacts between a hand and an object, and the friction law of one contact.

A ``ContactSet`` is what planning and simulation have in common; ``planner.contacts.friction`` is
the one place where the friction cone is written in numbers.
"""

from __future__ import annotations

from planner.contacts.contact_set import (
    CONTACT_DIM,
    MOST_FRICTION,
    Contact,
    ContactModel,
    ContactSet,
    check_contacts,
    check_frames,
)
from planner.contacts.friction import (
    MIN_EDGES,
    MOST_EDGES,
    Cone,
    Pyramid,
    cone_edges,
    pyramid_faces,
    round_cone,
)

__all__ = [
    "CONTACT_DIM",
    "MIN_EDGES",
    "MOST_EDGES",
    "MOST_FRICTION",
    "Cone",
    "Contact",
    "ContactModel",
    "ContactSet",
    "Pyramid",
    "check_contacts",
    "check_frames",
    "cone_edges",
    "pyramid_faces",
    "round_cone",
]
