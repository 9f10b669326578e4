"""The friction cone of one contact: edges, faces, support, utilisation; the grip that it asks for.

With f_n the normal force, f_t1, f_t2 the tangential forces and tau_n the torsion, the law is

    (f_t1^2 + f_t2^2)/mu^2 + (tau_n/mu_torsion)^2 <= f_n^2,

without the terms that the contact does not transmit; a friction of zero leaves no such force. The
section at f_n = 1 is the ellipsoid [1, mu a, mu b, mu_torsion c] with a^2 + b^2 + c^2 <= 1. Sliding
takes from torsion there (Howe, Cutkosky, "Practical force-motion models for sliding manipulation",
1996). Two polyhedra with k sides stand in for it:

inscribed
    The hull of k edges on the cone in the tangent plane and, where there is torsion, of the two
    edges n +- mu_torsion: a bipyramid. What it allows the cone allows.
circumscribed
    The k tangential edges pushed out by 1/cos(pi/k), each of them with torsion +mu_torsion and
    -mu_torsion where there is any: a prism. It holds the ellipsoid, since a k-gon of circumradius
    1/cos(pi/k) has inradius 1, and a^2 + b^2 + c^2 <= 1 implies a^2 + b^2 <= 1 and |c| <= 1. Pure
    sliding at the middle of a side and pure torsion touch it. What it forbids the cone forbids.

The edges lie at the angles 2 pi j/k from tangent1. The faces between them look along the angles
a_j = (2 j + 1) pi/k and read, with rho = mu cos(pi/k) (inscribed) or mu,

    sides         cos(a_j) f_t1 + sin(a_j) f_t2 - rho f_n <= 0
    bipyramid     cos(a_j) f_t1 + sin(a_j) f_t2 +- rho tau_n / mu_torsion - rho f_n <= 0
    prism         the sides, and  +-tau_n / mu_torsion - f_n <= 0.

CasADi's expressions of the same law are in ``planner.synthesis`` and ``planner.motion``.

``grip_for_load``: n fingers that press with g each bear, by friction alone, a force of mu n g along
their surfaces, and about the object a torque of that times a lever. So a weight W, a force F and a
torque T take

    g = LOAD_SAFETY (W + F + T / lever) / (mu n)

whatever their directions. It is a size to begin with, not a proof: along some directions normals
help, along others one finger stands alone. ``opposable test PLAN --protocol forces`` measures what
a plan bears, ``opposable certify PLAN`` proves what the best control could.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np

from planner.arrays import check_fields, checked_count
from planner.errors import ContactError, shown
from planner.spatial import FloatArray

Pyramid: TypeAlias = Literal["inscribed", "circumscribed"]
"""How a friction pyramid lies to its cone: edges on the cone, or faces."""
Cone: TypeAlias = Literal["inscribed", "circumscribed", "round"]
"""A friction pyramid of either kind, or the round cone itself."""

_PYRAMIDS = get_args(Pyramid)

MIN_EDGES = 3
"""Fewest edges of a polyhedral friction cone (-): two span no area."""

MOST_EDGES = 512
"""Most edges of a polyhedral friction cone (-): its polygon is then within 2e-5 of the circle."""

OUTLINE_SIDES = 64
"""Directions of an outline without torsion, or of torsion alone (-): inner and outer are 0.12 %
apart."""

OUTLINE_RINGS = 12
"""Rings of directions of an outline with torsion (-), 24 directions each: 1.7 % apart at most."""


def cone_edges(
    mu: float, mu_torsion: float, edges: int = 8, *, cone: Pyramid = "inscribed", phase: float = 0.0
) -> FloatArray:
    """Edges of one polyhedral friction cone in the contact frame, unit normal component.

    A friction of zero leaves no copies behind: a contact without any friction has one edge, its
    normal, and one with torsional friction only has two, n +- mu_torsion.

    Args:
        mu: Sliding friction (-); 0 for a frictionless contact.
        mu_torsion: Torsional friction (m); 0 for all but a soft contact.
        edges: Number k of edges in the tangent plane, at least 3.
        cone: "inscribed" or "circumscribed", see the module.
        phase: Angle of the first edge from tangent1 towards tangent2, rad.

    Returns:
        (4, m), rows f_n = 1, f_t1, f_t2 (-) and tau_n (m); m is 1, 2, k, k + 2 or 2 k.

    Raises:
        ContactError: ``edges`` is not 3 to 512, or ``cone`` is unknown.
    """
    check_edges(edges, cone)
    angle = phase + 2 * np.pi * np.arange(edges) / edges
    reach = mu if cone == "inscribed" else mu / np.cos(np.pi / edges)
    one, zero = np.ones(edges), np.zeros(edges)
    sliding = np.array([one, reach * np.cos(angle), reach * np.sin(angle), zero])  # (4, k)
    twist = np.array([[1, 1], [0, 0], [0, 0], [mu_torsion, -mu_torsion]], dtype=np.float64)
    if mu == 0.0:
        return twist if mu_torsion > 0.0 else twist[:, :1]
    if mu_torsion == 0.0:
        return sliding
    if cone == "inscribed":
        return np.hstack([sliding, twist])
    lift = np.zeros_like(sliding)
    lift[3] = mu_torsion
    return np.hstack([sliding + lift, sliding - lift])


def pyramid_faces(mu: float, mu_torsion: float, edges: int, cone: Pyramid) -> FloatArray:
    """Rows D (m, 4) of D [f_n, f_t1, f_t2, tau_n] <= 0 in N: the faces between ``cone_edges``.

    A component without friction has no rows: whoever uses them sets it to zero.

    Args:
        mu: Sliding friction (-).
        mu_torsion: Torsional friction (m).
        edges: Number of sides k, at least 3.
        cone: "inscribed" or "circumscribed".

    Returns:
        m = k rows, 2 k (inscribed with torsion), k + 2 (circumscribed with torsion), 2 (torsion
        only) or 0.

    Raises:
        ContactError: ``edges`` is not 3 to 512, or ``cone`` is unknown.
    """
    check_edges(edges, cone)
    angle = (2 * np.arange(edges) + 1) * np.pi / edges
    reach = mu * np.cos(np.pi / edges) if cone == "inscribed" else mu
    sides = np.stack(
        [np.full(edges, -reach), np.cos(angle), np.sin(angle), np.zeros(edges)], axis=1
    )
    if mu_torsion == 0.0:
        return sides if mu > 0.0 else np.zeros((0, 4))
    twist = np.array([[-1, 0, 0, 1 / mu_torsion], [-1, 0, 0, -1 / mu_torsion]])
    if mu == 0.0:
        return twist
    if cone == "circumscribed":
        return np.vstack([sides, twist])
    lift = np.zeros_like(sides)
    lift[:, 3] = reach / mu_torsion
    return np.vstack([sides + lift, sides - lift])


def round_cone(mu: float, mu_torsion: float) -> FloatArray:
    """Rows (m, 4) that turn [f_n, f_t1, f_t2, tau_n] into [head, tail ...], head >= |tail|, in N.

    Args:
        mu: Sliding friction (-).
        mu_torsion: Torsional friction (m).

    Returns:
        m = 4, 3 (sliding alone), 2 (torsion alone) or 0.
    """
    rows = [[1.0, 0.0, 0.0, 0.0]]
    if mu > 0.0:
        rows += [[0.0, 1 / mu, 0.0, 0.0], [0.0, 0.0, 1 / mu, 0.0]]
    if mu_torsion > 0.0:
        rows.append([0.0, 0.0, 0.0, 1 / mu_torsion])
    return np.array(rows) if len(rows) > 1 else np.zeros((0, 4))


def outline_faces(size: int, *, inner: bool) -> FloatArray:
    """Faces (m, size) on [head, tail ...] of a fine pyramid around or inside a round cone, <= 0.

    With unit directions d of the tails, no direction further than an angle a from one of them,

        outer    d . tail <= head          wherever |tail| <= head
        inner    d . tail <= cos(a) head   only where |tail| <= head

    Unlike ``pyramid_faces`` it is as fine in torsion as in sliding.

    Args:
        size: Rows of the cone's block, 2 to 4 (``round_cone``).
        inner: Whether inside.
    """
    if size == 2:
        directions, reach = np.array([[1.0], [-1.0]]), 1.0
    elif size == 3:
        angle = 2 * np.pi * np.arange(OUTLINE_SIDES) / OUTLINE_SIDES
        directions = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        reach = float(np.cos(np.pi / OUTLINE_SIDES))
    else:
        half = np.pi / (2 * OUTLINE_RINGS)  # half a cell of the grid, in latitude and longitude
        latitude = -np.pi / 2 + half * (2 * np.arange(OUTLINE_RINGS) + 1)
        longitude = half * np.arange(0, 4 * OUTLINE_RINGS, 2)
        up, around = (grid.ravel() for grid in np.meshgrid(latitude, longitude, indexing="ij"))
        points = np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)
        directions, reach = np.stack(points, axis=1), float(np.cos(half) ** 2)
    head = np.full((len(directions), 1), -reach if inner else -1.0)
    return np.hstack([head, directions])


def cone_support(pulled: FloatArray, semi_axes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Support function of the sections f_n = 1 of round cones, in closed form.

    Args:
        pulled: (..., 4), directions g in [f_n, f_t1, f_t2, tau_n].
        semi_axes: (..., 3), mu (-), mu (-), mu_torsion (m) as far as the contact has them.

    Returns:
        g_n + |(mu g_t1, mu g_t2, mu_torsion g_tau)| (...), and the forces (..., 4) where it is
        reached.
    """
    stretched = pulled[..., 1:] * semi_axes
    norm = np.linalg.norm(stretched, axis=-1, keepdims=True)
    ball = np.divide(stretched, norm, out=np.zeros_like(stretched), where=norm > 0)
    force = np.concatenate([np.ones_like(norm), ball * semi_axes], axis=-1)
    return pulled[..., 0] + norm[..., 0], force


def cone_utilisation(forces: FloatArray, mu: FloatArray, mu_torsion: FloatArray) -> FloatArray:
    """Share of the friction cone in use, (n,): 0 on the normal, 1 on the cone, above 1 outside.

    Infinite where a tangential force meets no friction or no normal force; NaN for unknown forces.

    Args:
        forces: (n, 4), f_n, f_t1, f_t2 (N) and tau_n (N m).
        mu: (n,), sliding friction (-).
        mu_torsion: (n,), torsional friction (m), NaN where torsion does not count.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        tangential, twist = np.hypot(forces[:, 1], forces[:, 2]), np.abs(forces[:, 3])
        ratio = np.where(tangential > 0, tangential / mu, 0.0)
        torsion = np.where(~np.isnan(mu_torsion) & (twist != 0), twist / mu_torsion, 0.0)
        load = np.hypot(ratio, torsion)
        used = np.where(load > 0, load / np.maximum(forces[:, 0], 0.0), 0.0)
    return np.where(np.isnan(forces).any(axis=1), np.nan, used)


def check_edges(edges: int, cone: str = "inscribed") -> None:
    """Refuse a number of edges, or the name of a pyramid, that is not usable.

    Raises:
        ContactError: ``edges`` is not 3 to 512, or ``cone`` is unknown.
    """
    what = "the number of edges per friction cone"
    checked_count(what, edges, least=MIN_EDGES, most=MOST_EDGES)
    if cone not in _PYRAMIDS:
        raise ContactError(f"cone is {shown(cone)}; use 'inscribed' or 'circumscribed'")


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
