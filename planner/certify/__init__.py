"""Certificates: what is proven of a grasp, apart from planning it."""

from __future__ import annotations

from planner.certify.breaking import Breaking, breaking_along, smallest_breaking
from planner.certify.certificate import (
    Certificate,
    CertifyOptions,
    certify,
    certify_contacts,
)
from planner.certify.nearby import NEAR, NearBound, Neighbourhood, bound_nearby
from planner.certify.robust import Verdict, closure_survives
from planner.certify.tolerance import (
    PoseErrors,
    Tolerance,
    contact_tolerances,
    pose_tolerances,
    sampled,
)

__all__ = [
    "NEAR",
    "Breaking",
    "Certificate",
    "CertifyOptions",
    "NearBound",
    "Neighbourhood",
    "PoseErrors",
    "Tolerance",
    "Verdict",
    "bound_nearby",
    "breaking_along",
    "certify",
    "certify_contacts",
    "closure_survives",
    "contact_tolerances",
    "pose_tolerances",
    "sampled",
    "smallest_breaking",
]
