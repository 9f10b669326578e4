"""The pad of a fingertip: the inscribed sphere that best stands for its surface where it touches.

A pad faces between the way the finger closes and the way its bone points. For a direction d of its
cone the hull of the distal link reaches h(d), the sphere about c with radius r reaches c . d + r;
the difference is how far a flat object would be inside the true link when it touches the sphere.
The sphere lies in one geom and touches that geom's surface from inside: r = depth(c). The centre
makes the mean difference over the cone least; the cone is then as wide as the difference stays
small. Spheres and capsules are their own ends, exactly. Other geoms of the link may stand out
further than the sphere where the planner's clearance sees them, but not by much.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from planner.describe.fingertips import ConvexLink, Fingertip, cone_directions
from planner.spatial import FloatArray

FIT_TOL = 2e-3
"""Difference (m) between geom and sphere up to which a direction belongs to the pad's cone."""

OTHERS_TOL = 4e-3
"""How far (m) other geoms of the link may stand out there: the edges of a box beside a ball."""

NARROWEST, WIDEST = np.deg2rad(20.0), np.deg2rad(45.0)
"""Half angles (rad) of a pad's cone: below, grasps are hardly found; above, it would face backwards
or sideways past the nail."""

WIDE_ENOUGH = np.deg2rad(30.0)
"""Half angle (rad) of a cone for whose sake no other axis is tried."""

TILTS = np.deg2rad([45.0, 30.0, 15.0, 0.0])
"""Angles (rad) from the closing direction towards the bone that a pad's axis may have, the first
one first."""

SMALLEST_RADIUS = 1e-3
"""Least radius (m) of an inscribed sphere that approximates the surface: sheets are no pads."""

STEEPEST_FACE = np.deg2rad(40.0)
"""Angle (rad) between closing direction and a flat face up to which the face is the pad."""

FLATTEST = np.deg2rad(8.0)
"""Angle (rad) between facets of a hull that count as one face."""

TANGENT_TOL = 2e-4
"""How far (m) a ball may reach out of a face that is slightly curved; pads may by 0.5 mm."""

BISECTIONS = 30
"""Halvings of a radius: to a billionth of the body's thickness."""

FACE_SHARE = 0.5
"""Where on a flat face the pad is: this share of the way from its middle to its end at the tip."""

SHEET = 1.5e-3
"""How far (m) a geom may stand out before a thicker one that it covers: a friction pad, a skin."""

NEARLY_AS_WIDE = np.deg2rad(5.0)
"""Gain in width (rad) of a cone below which the more favoured axis or geom is kept."""


@dataclass(frozen=True, kw_only=True)
class PadFit:
    """A pad in the frame of the finger's last joint.

    Attributes:
        geom: Name of the geom whose surface it is part of.
        center: (3,), m.
        radius: m.
        axis: (3,), unit.
        half_angle: rad.
        tilt: Angle from the closing direction to the axis, rad.
        error: Largest difference between geom and sphere within the cone, m.
        exact: Whether the sphere is a part of the geom, not an approximation of it.
        flat: Whether the pad is a flat face, which a sphere stands for only near its middle.
        sheets: Thin geoms that cover the pad's geom there and must not collide.
    """

    geom: str
    center: FloatArray
    radius: float
    axis: FloatArray
    half_angle: float
    tilt: float
    error: float
    exact: bool
    flat: bool = False
    sheets: tuple[str, ...] = ()


def fit_pad(tip: Fingertip, solids: Sequence[ConvexLink]) -> PadFit | None:
    """The pad of a fingertip whose link consists of ``solids``; None if nothing fits one."""
    fits = [fit for solid in solids if (fit := _fit_geom(tip, solid, solids)) is not None]
    round_fits = [fit for fit in fits if fit.error <= FIT_TOL]
    if not round_fits:
        edge = min(fits, key=lambda fit: fit.error, default=None)
        face = _fit_face(tip, solids)
        if face is None:
            hulls = [_fit_hull_face(tip, solid) for solid in solids if solid.kind == "mesh"]
            face = max((f for f in hulls if f), key=lambda fit: fit.radius, default=None)
            # the ball in a rounded edge is a pad only where no face has room for a larger one
            if face is not None and edge is not None and face.radius <= edge.radius:
                face = None
            sides = [_fit_side(tip, solid) for solid in solids if solid.kind == "cylinder"]
            face = face or max((s for s in sides if s), key=lambda fit: fit.radius, default=None)
        return face or edge
    widest = max(fit.half_angle for fit in round_fits)
    good = [fit for fit in round_fits if fit.half_angle > widest - NEARLY_AS_WIDE]
    return min(good, key=lambda fit: fit.error)


def _fit_face(tip: Fingertip, solids: Sequence[ConvexLink]) -> PadFit | None:
    """A pad on the flat face of a box that faces the closing side: the ball under its middle."""
    faces = [
        (float(sign * solid.rotation[:, k] @ tip.flexion), sign, k, solid)
        for solid in solids
        if solid.kind == "box"
        for k in range(3)
        for sign in (1.0, -1.0)
    ]
    if not faces:
        return None
    facing, sign, k, first = max(faces, key=lambda face: face[0])
    if facing < np.cos(STEEPEST_FACE):
        return None
    normal = sign * first.rotation[:, k]
    reach = {s.name: float(s.support(normal[None])[0]) for s in solids}
    outermost = max(reach.values())
    boxes = [s for s in solids if s.kind == "box" and reach[s.name] > outermost - SHEET]
    solid = max(boxes, key=lambda s: s.depth(s.center))
    along = np.delete(solid.rotation, k, axis=1)
    size = np.delete(solid.size, k)
    main = int(np.argmax(np.abs(tip.bone @ along)))
    radius = solid.depth(solid.center)
    share = max(size[main] * FACE_SHARE, 0.0)
    shift = np.sign(tip.bone @ along[:, main]) * min(share, max(size[main] - radius, 0.0))
    center = solid.center + shift * along[:, main]
    # a ball in the middle of a thick box does not touch the face
    center = center + normal * (float(solid.size[k]) - radius)
    sheets = tuple(
        s.name
        for s in boxes
        if reach[s.name] > reach[solid.name] + 1e-5 and s.depth(s.center) < SHEET
    )
    return replace(_flat(tip, solid, center, radius, normal), sheets=sheets)


def _fit_side(tip: Fingertip, solid: ConvexLink) -> PadFit | None:
    """A pad on the side of a cylinder along the finger, as on a flat face; None if it lies across.

    Inscribed balls all along the axis fit alike, so that the best fit has no reason to be near the
    tip.
    """
    along = solid.rotation[:, 2]
    across = tip.flexion - along * (along @ tip.flexion)
    if np.linalg.norm(across) < np.cos(STEEPEST_FACE):
        return None
    normal = across / np.linalg.norm(across)
    radius, half = (float(v) for v in solid.size[:2])
    shift = np.sign(along @ tip.bone) * min(FACE_SHARE * half, max(half - radius, 0.0))
    center = solid.center + shift * along
    return _flat(tip, solid, center, min(radius, half), normal)


def _flat(
    tip: Fingertip, solid: ConvexLink, center: FloatArray, radius: float, normal: FloatArray
) -> PadFit:
    """The pad of a ball below a flat face."""
    directions = cone_directions(normal, NARROWEST)
    return PadFit(
        geom=solid.name,
        center=center,
        radius=solid.depth(center),
        axis=normal,
        half_angle=float(NARROWEST),
        tilt=float(np.arccos(np.clip(normal @ tip.flexion, -1, 1))),
        error=float((solid.support(directions) - directions @ center).max()) - radius,
        exact=False,
        flat=True,
    )


def _fit_hull_face(tip: Fingertip, solid: ConvexLink) -> PadFit | None:
    """A pad on the largest flat face of a hull that faces the closing side; None if none does.

    The ball is the largest one that touches the face from inside at a point half-way from the
    face's middle to its end at the tip.
    """
    corners = solid.points[solid.triangles]  # (n, 3, 3)
    spans = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(spans, axis=1) / 2
    normals = solid.facets[:, :3] @ solid.rotation.T
    facing = normals @ tip.flexion >= np.cos(STEEPEST_FACE)
    if not facing.any():
        return None
    together = normals[facing] @ normals.T >= np.cos(FLATTEST)  # (n_facing, n)
    face = together[int(np.argmax(together @ area))]
    weight = area[face]
    normal = weight @ normals[face]
    normal /= np.linalg.norm(normal)
    middles = corners[face].mean(axis=1) @ solid.rotation.T + solid.center
    point = weight @ middles / weight.sum()
    along = tip.bone - normal * (normal @ tip.bone)
    reach = corners[face].reshape(-1, 3) @ solid.rotation.T + solid.center - point
    length = float(np.linalg.norm(along))
    if length > FLATTEST:
        along /= length
        point = point + FACE_SHARE * max(float((reach @ along).max()), 0.0) * along
    # a flat face is met at the support plane, which the facets' mean lies a little below
    point = point + normal * (float(solid.support(normal[None])[0]) - normal @ point)
    radius = _tangent_ball(solid, point, normal)
    if radius < SMALLEST_RADIUS:
        return None
    return _flat(tip, solid, point - radius * normal, radius, normal)


def _tangent_ball(solid: ConvexLink, point: FloatArray, normal: FloatArray) -> float:
    """Radius (m) of the largest ball inside a body that touches it at a point with a normal."""
    low, high = 0.0, float(np.ptp(solid.support(np.stack([normal, -normal])) * [1.0, -1.0])) / 2
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        inside = solid.depth(point - middle * normal) >= middle - TANGENT_TOL
        low, high = (middle, high) if inside else (low, middle)
    return low


def _fit_geom(tip: Fingertip, solid: ConvexLink, solids: Sequence[ConvexLink]) -> PadFit | None:
    best: PadFit | None = None
    for tilt in TILTS:
        axis = np.cos(tilt) * tip.flexion + np.sin(tilt) * tip.bone
        directions = cone_directions(axis, WIDEST, rings=9)
        reach = solid.support(directions)
        others = np.max([s.support(directions) for s in solids], axis=0)
        exact = solid.kind in ("sphere", "capsule")
        center = _end_of(solid, tip) if exact else _best_center(tip, solid, directions, others)
        radius = solid.depth(center)
        if radius < SMALLEST_RADIUS:
            continue
        error = reach - directions @ center - radius
        over = others - directions @ center - radius
        angle = np.arccos(np.clip(directions @ axis, -1, 1))
        bad = angle[(error > FIT_TOL) | (over > OTHERS_TOL)]
        within = max(float(bad.min(initial=np.inf)) - WIDEST / 9, NARROWEST)
        half_angle = min(within, float(WIDEST))
        fit = PadFit(
            geom=solid.name,
            center=center,
            radius=radius,
            axis=axis,
            half_angle=half_angle,
            tilt=float(tilt),
            error=float(error[angle <= half_angle + 1e-9].max()),
            exact=exact,
        )
        if best is None or fit.half_angle > best.half_angle + NEARLY_AS_WIDE:
            best = fit
        if best.half_angle >= WIDE_ENOUGH:
            break
    return best


def _end_of(solid: ConvexLink, tip: Fingertip) -> FloatArray:
    """Centre (3,) of a sphere, or of that end of a capsule which is nearer to the tip."""
    if solid.kind == "sphere":
        return solid.center
    along = solid.rotation[:, 2]
    side = 1.0 if along @ tip.bone >= 0 else -1.0
    return np.asarray(solid.center + side * solid.size[1] * along)


def _best_center(
    tip: Fingertip, solid: ConvexLink, directions: FloatArray, reach: FloatArray
) -> FloatArray:
    """Centre of the inscribed sphere with the least mean difference over the directions."""
    from scipy.optimize import minimize  # here, since SciPy loads slowly

    def difference(center: FloatArray) -> float:
        radius = solid.depth(center)
        # outside the geom the radius is negative: the further out, the worse
        return float((reach - directions @ center).mean()) - radius - 10 * min(radius, 0.0)

    middle = solid.support_points(np.vstack([np.eye(3), -np.eye(3)])).mean(axis=0)
    span = tip.bone * (tip.bone @ (tip.end - middle))
    starts = [middle + share * span for share in (0.0, 0.5, 0.8)]
    found = [
        minimize(
            difference,
            start,
            method="Nelder-Mead",
            options={
                "xatol": 1e-6,
                "fatol": 1e-8,
                "maxiter": 600,
                "initial_simplex": start + 3e-3 * np.vstack([np.zeros(3), np.eye(3)]),
            },
        )
        for start in starts
    ]
    return np.asarray(min(found, key=lambda r: float(r.fun)).x)
