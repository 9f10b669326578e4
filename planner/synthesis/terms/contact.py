"""Terms of contact: pads touch the surface off its edges, around the centre of mass."""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca
import numpy as np

from planner.synthesis.symbols import GraspSymbols
from planner.synthesis.terms.term import Role, Rows, Term

PER_METRE = 1e3
"""Weight of a length: a millimetre is one unit of residual."""

COST_WEIGHT = 0.2
"""Weight of the root of a cost, which ranks grasps but must not outweigh contact. With half of it
forces are infeasible more often, with twice of it least squares take more iterations."""

EDGE_WEIGHT = 20.0
"""Weight of the shortfall of the smooth distance's slope at a contact: 0.2 at an edge."""


def _touch(g: GraspSymbols) -> Iterator[Rows]:
    for finger, center, point, normal in zip(
        g.fingers, g.centers, g.points, g.outward, strict=True
    ):
        apart = finger.pad.radius - g.surface.skin(g.size)
        gap = g.rotation @ center + g.shift - point - apart * normal
        yield Rows(expression=gap, about=(finger.name,))


def _surface(g: GraspSymbols) -> Iterator[Rows]:
    for finger, code, point in zip(g.fingers, g.codes, g.points, strict=True):
        error = g.surface.surface_error(g.size, code, point)
        if error is not None:
            yield Rows(expression=error, about=(finger.name,))


def _facing(g: GraspSymbols) -> Iterator[Rows]:
    for finger, normal in zip(g.fingers, g.outward, strict=True):
        axis = g.rotation @ g.symbolic.direction(finger.pad.joint_id, finger.pad.axis)
        rim = max(finger.pad.half_angle - g.surface.normal_error, 0.0)
        yield Rows(expression=-ca.dot(axis, normal) - float(np.cos(rim)), about=(finger.name,))


def _along(g: GraspSymbols) -> Iterator[Rows]:
    """Both ends of a line that touches are outside of the plane that is tangent at its contact.

    The end at share 1 is (1 - s) a . n above it where the contact is at share s of the way a.
    """
    for finger, center, normal in zip(g.fingers, g.centers, g.outward, strict=True):
        middle = g.symbolic.point(finger.pad.joint_id, finger.pad.center)
        shares = g.shares(finger, center - middle)
        for share, way in zip(shares, g.reach(finger), strict=True):
            slope = ca.dot(g.rotation @ way, normal)
            rows = ca.vertcat((1 - share) * slope, -(1 + share) * slope)
            yield Rows(expression=rows, about=(finger.name,))


def _edge(g: GraspSymbols) -> Iterator[Rows]:
    for finger, point in zip(g.fingers, g.points, strict=True):
        flatness = g.surface.flatness(g.size, point)
        if flatness is not None:
            yield Rows(expression=flatness, about=(finger.name,))


def _center(g: GraspSymbols) -> Iterator[Rows]:
    middle = sum(g.points[1:], g.points[0]) / len(g.points)
    yield Rows(expression=ca.sqrt(g.option["weight_center"]) * middle / g.length)


TOUCH = Term(
    name="touch",
    meaning="pad centre c_i(q) - (p_i + r_i n_i): one radius off the surface",
    role=Role.EQUALITY,
    unit="m",
    weight=PER_METRE,
    write=_touch,
    judged="pad within 0.5 mm of the true surface",
    lacking=(
        "the fingers do not reach the surface as it lies; raise or turn the object, or take "
        "other fingers or another size"
    ),
)

SURFACE = Term(
    name="surface",
    meaning="g(p_i): contact point on its patch",
    role=Role.EQUALITY,
    unit="m",
    weight=PER_METRE,
    write=_surface,
    judged="contacts are computed on the true surface",
    lacking=(
        "contacts would have to lie beside the faces; the faces are too small or do not oppose "
        "each other within reach: another pose, other fingers, a larger object"
    ),
)

FACING = Term(
    name="facing",
    meaning="pad axis . -n_i - cos(half angle): the pad touches, not the nail",
    role=Role.INEQUALITY,
    unit="-",
    weight=20.0,
    margin=0.02,
    write=_facing,
    wording="{} at the rim of its pad",
    judged="pad angle to the true normal",
    lacking=(
        "the fingers reach the object with nail or side, not with their pads; another pose or "
        "size, or other fingers"
    ),
)

ALONG = Term(
    name="along",
    meaning="height of both ends of a link or face over the tangent plane at its contact",
    role=Role.INEQUALITY,
    unit="m",
    weight=PER_METRE,
    write=_along,
    wording="{} beside its contact",
    judged="whole link within 0.5 mm of the true surface",
    lacking="links meet the object with an edge or an end; a rounder or smaller object",
)

EDGE = Term(
    name="edge",
    meaning="slope of a mesh's smooth distance at a contact, short of flat",
    role=Role.COST_BELOW_ZERO,
    unit="-",
    weight=EDGE_WEIGHT,
    write=_edge,
    judged="spread of the true normals around a contact",
)

CENTER = Term(
    name="center",
    meaning="mean contact point over the characteristic length, times the root of weight_center",
    role=Role.COST,
    unit="-",
    weight=COST_WEIGHT,
    write=_center,
)
