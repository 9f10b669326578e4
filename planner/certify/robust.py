"""Does closure survive every error of contact positions and normals up to given sizes? A proof.

Closure is that of inscribed pyramids with k edges, whatever their phase: who decides with as many
or more, or with the true cones, finds it.

Contact i may be anywhere within r_i of its place and its normal anywhere within a_i of its
direction, each contact on its own. Let H_i(u) be the least support that contact i keeps along a
motion u = (v, w) of the object (m, rad), over its errors. Since errors are independent,

    closure survives  <=>  for every u except 0:  max_i H_i(u) > 0.

A force f (3,) and a torsion s that are inside the friction cone for *every* tilt up to a_i give

    H_i(u) >= f . (v + w x p_i) + s n_i . w - r_i |w x f| - 2 sin(a_i / 2) |s| |w|,

because f . (w x d) >= -r_i |w x f| for |d| <= r_i, and |n' - n| <= 2 sin(a_i / 2). They are a
convex cone (``_robust_forces``). Forces that balance, sum f_i = 0, make v drop out of the sum, and
leave

    M(w) = sum_i w . (p_i x f_i + s_i n_i) - r_i |w x f_i| - 2 sin(a_i / 2) |s_i| |w|.

M is concave and homogeneous in w. So a single set of balanced forces with M > 0 at the three
corners of a spherical triangle has M > 0 on all of it: no motion with such a rotation w, whatever
v, escapes. Triangles that fill the sphere, each with its forces, and the same question without a
rotation (a ball in the hull of the f_i) prove closure under all errors. Only directions of rotation
need to be searched, a sphere in space instead of one in six dimensions.

Forces are weights of generators inside the cones, found by a linear programme for the three corners
at once; M is evaluated without the programme. "Yes" is a proof, up to ``MARGIN``; "no" means that
none was found, and comes with the motion where the least is left.

The unit sphere of directions cut into spherical triangles, each into four smaller ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from planner.contacts import ContactSet
from planner.contacts.friction import check_edges
from planner.errors import ContactError, shown
from planner.numerics.lp import LpSolution, solve_lp
from planner.quality import measure_hull
from planner.spatial import FloatArray, IntArray


@cache
def icosphere(halvings: int) -> tuple[FloatArray, IntArray]:
    """Vertices (m, 3), unit, and triangles (k, 3) of an icosahedron, halved a number of times.

    The cones over the triangles fill space. 0 halvings: 12 and 20; 1: 42 and 80; 2: 162 and 320.
    """
    if halvings:
        vertices, triangles = icosphere(halvings - 1)
        found: dict[tuple[int, int], int] = {}
        fresh: list[FloatArray] = [*vertices]
        cells = []
        for a, b, c in triangles:
            middles = []
            for i, j in ((a, b), (b, c), (c, a)):
                key = (int(min(i, j)), int(max(i, j)))
                if key not in found:
                    found[key] = len(fresh)
                    middle = vertices[i] + vertices[j]
                    fresh.append(middle / np.linalg.norm(middle))
                middles.append(found[key])
            d, e, f = middles
            cells += [(a, d, f), (b, e, d), (c, f, e), (d, e, f)]
        return np.array(fresh), np.array(cells, dtype=np.int64)
    g = (1 + np.sqrt(5)) / 2
    corners = np.array(
        [(s, t * g, 0.0) for s in (-1, 1) for t in (-1, 1)]
        + [(0.0, s, t * g) for s in (-1, 1) for t in (-1, 1)]
        + [(t * g, 0.0, s) for s in (-1, 1) for t in (-1, 1)]
    )
    corners = corners / np.linalg.norm(corners[0])
    # Corners are neighbours where they are nearest; a face is three neighbours of each other.
    near = corners @ corners.T > 0.4
    faces = [
        (i, j, k)
        for i in range(12)
        for j in range(i + 1, 12)
        for k in range(j + 1, 12)
        if near[i, j] and near[j, k] and near[i, k]
    ]
    return corners, np.array(faces, dtype=np.int64)


def halved(triangle: FloatArray) -> FloatArray:
    """Four triangles (4, 3, 3) of unit corners that fill the cone over one (3, 3)."""
    a, b, c = triangle
    d, e, f = ((p + q) / np.linalg.norm(p + q) for p, q in ((a, b), (b, c), (c, a)))
    return np.array([(a, d, f), (b, e, d), (c, f, e), (d, e, f)])


MARGIN = 1e-6
"""M and the ball of forces must exceed this share of the lever arm or of the force (-): a thousand
times what the programme may leave unbalanced."""

HALVINGS = 1
"""Of the first cover: 80 triangles of about 36 degrees."""

FINEST = 4
"""Times that a triangle may be halved further (-): 2 degrees."""

FINE_EDGES = 64
"""Edges where the true cones are meant and nothing has to be proven (-): within 0.1 %."""

MAX_PROGRAMMES = 100
"""Linear programmes for one question (-), then the answer is "no"."""

REFINED = (0.2, 0.2, 0.1, 0.1) * 3 + (0.03, 0.01) * 4
"""Steps (rad) beside the best rotation so far that are tried, one after the other."""

_RINGS = ((1.0, 24), (0.75, 16), (0.5, 12), (0.25, 6))
"""Rings of generators: share of the friction angle's tangent (-), and how many. The outer polygon
loses 0.9 % of the friction; the inner rings are for forces that errors of position move less."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Verdict:
    """Whether closure was proven to survive.

    Attributes:
        survives: Whether a proof was found.
        motion: (6,), a motion [v; w] (m, rad) of the object about ``contacts.center`` along which
            no support could be shown; None where it survives, or where nothing balances at all.
        programmes: Linear programmes solved.
    """

    survives: bool
    motion: FloatArray | None
    programmes: int


def closure_survives(
    contacts: ContactSet,
    shifts: FloatArray,
    tilts: FloatArray,
    *,
    edges: int = 8,
    suspects: tuple[FloatArray, ...] = (),
) -> Verdict:
    """Whether closure provably survives all errors up to given sizes.

    Args:
        contacts: n contacts.
        shifts: (n,), largest error of each position, m.
        tilts: (n,), largest error of each normal, rad.
        edges: Edges k of the pyramids by which closure is understood, at least 3.
        suspects: Rotations (3,), unit, that are asked first: where an earlier question failed.

    Raises:
        ContactError: A size is negative or not finite, there are not n of them, or ``edges`` is
            below 3.
    """
    check_edges(edges)
    for name, value in (("shifts", shifts), ("tilts", tilts)):
        if np.shape(value) != (len(contacts),) or not (np.asarray(value) >= 0).all():
            raise ContactError(f"{name} is {shown(value)}; give {len(contacts)} numbers >= 0")
    proof = _Proof(contacts, np.asarray(shifts), np.asarray(tilts), edges)
    if not proof.translations_are_held():
        return Verdict(survives=False, motion=None, programmes=0)
    for suspect in suspects:
        support, motion = proof.weakest(suspect)
        if support <= MARGIN:
            return Verdict(survives=False, motion=motion, programmes=proof.programmes)
    return proof.cover()


def weakest_motion(
    contacts: ContactSet, shifts: FloatArray, tilts: FloatArray, near: FloatArray | None = None
) -> FloatArray:
    """The motion (6,) of least support, of those with the rotations of a net, refined at random.

    Args:
        contacts: n contacts.
        shifts: (n,), m, as for ``closure_survives``.
        tilts: (n,), rad.
        near: A motion (6,) to start from instead of the net.

    Returns:
        [v; w] about ``contacts.center``, m and rad; the best found, nothing is proven.
    """
    proof = _Proof(contacts, shifts, tilts, FINE_EDGES)
    starts = icosphere(HALVINGS)[0] if near is None else near[None, 3:]
    best = min((proof.weakest(start) for start in starts), key=lambda pair: pair[0])
    rng = np.random.default_rng(0)
    for step in REFINED:
        beside = best[1][3:] + step * rng.normal(size=3)
        other = proof.weakest(beside / np.linalg.norm(beside))
        best = min(best, other, key=lambda pair: pair[0])
    return best[1]


class _Proof:
    """Generators of the robust cones, and the programmes over them; lengths by the lever arm."""

    def __init__(
        self, contacts: ContactSet, shifts: FloatArray, tilts: FloatArray, edges: int
    ) -> None:
        """Lay the generators out, contact by contact."""
        arms = contacts.positions - contacts.center
        arm = float(np.linalg.norm(arms, axis=1).max(initial=0.0))
        self.length = arm if arm > 0 else 1.0
        self.programmes = 0
        forces, torques, slack, owner = [], [], [], []
        for i, (mu, mu_torsion) in enumerate(contacts.friction.tolist()):
            local = _robust_forces(mu, mu_torsion, float(tilts[i]), edges)
            force = local[:, :3] @ contacts.frames[i].T
            forces.append(force)
            torque = np.cross(arms[i], force) + local[:, 3:] * contacts.frames[i, :, 0]
            torques.append(torque / self.length)
            slack.append(2 * np.sin(min(tilts[i], np.pi) / 2) * np.abs(local[:, 3]) / self.length)
            owner.append(np.full(len(local), i))
        self.forces = np.vstack([np.zeros((0, 3)), *forces])  # (m, 3)
        self.torques = np.vstack([np.zeros((0, 3)), *torques])
        self.slack = np.concatenate([np.zeros(0), *slack])
        self.owner: IntArray = np.concatenate([np.zeros(0, dtype=np.int64), *owner])
        self.shifts = shifts / self.length
        self.share = (self.owner[:, None] == np.arange(len(contacts))).astype(float)  # (m, n)

    def translations_are_held(self) -> bool:
        """Whether the forces alone have a ball about 0 in their hull."""
        return measure_hull(self.forces.T).epsilon > MARGIN

    def cover(self) -> Verdict:
        """Forces for each triangle of a cover of the sphere, until all have some or one cannot."""
        vertices, faces = icosphere(HALVINGS)
        corners = vertices[faces]  # (k, 3 corners, 3)
        depth = np.zeros(len(corners), dtype=np.int64)
        known: list[FloatArray] = []
        while len(corners):
            first = corners[0]
            weights = self._balanced(first)
            center = first.sum(axis=0) / np.linalg.norm(first.sum(axis=0))
            if weights is None or self.programmes >= MAX_PROGRAMMES:
                return self._no(self.weakest(center)[1])
            known.append(weights)
            # One set of forces often serves many triangles.
            done = self._served(weights[None], corners)
            if not done[0]:
                support, motion = self.weakest(center)
                if support <= MARGIN or depth[0] == FINEST:
                    return self._no(motion)
                parts = halved(first)
                parts = parts[~self._served(np.array(known), parts)]
                # The parts come next, so that a size that is too large is seen soon.
                corners, done = np.concatenate([parts, corners[1:]]), done[1:]
                done = np.concatenate([np.zeros(len(parts), dtype=bool), done])
                depth = np.concatenate([np.full(len(parts), depth[0] + 1), depth[1:]])
            corners, depth = corners[~done], depth[~done]
        return Verdict(survives=True, motion=None, programmes=self.programmes)

    def weakest(self, rotation: FloatArray) -> tuple[float, FloatArray]:
        """The least support (-) of motions with a rotation (3,), unit, and the motion (6,).

        -inf, and no velocity, where no forces balance.
        """
        gain = self._gains(rotation[None])[0]
        found = self._programme(-gain, np.zeros((0, len(gain))))
        if found is None:
            return -np.inf, np.append(np.zeros(3), rotation)
        return -found.value, np.append(found.row_duals[:3] * self.length, rotation)

    def _no(self, motion: FloatArray | None) -> Verdict:
        return Verdict(survives=False, motion=motion, programmes=self.programmes)

    def _gains(self, rotations: FloatArray) -> FloatArray:
        """M of each single generator at rotations (q, 3), (q, m)."""
        squares = (self.forces**2).sum(axis=1) - (rotations @ self.forces.T) ** 2
        moved = self.shifts[self.owner] * np.sqrt(np.maximum(squares, 0.0))
        return np.asarray(rotations @ self.torques.T - moved - self.slack)

    def _balanced(self, corners: FloatArray) -> FloatArray | None:
        """Weights (m,) of balanced forces whose least gain at the corners is greatest."""
        m = len(self.forces)
        cost = np.append(np.zeros(m), -1.0)
        found = self._programme(cost, np.column_stack([self._gains(corners), -np.ones(3)]))
        return None if found is None else found.x[:m]

    def _served(self, weights: FloatArray, corners: FloatArray) -> NDArray[np.bool_]:
        """Whether one of k sets of forces (k, m) has M > 0 at all corners (q, 3, 3), (q,)."""
        flat = corners.reshape(-1, 3)
        # (k, n, 3): force of each contact; |w x f|^2 = |f|^2 - (w . f)^2 for unit w
        forces = np.einsum("km,mn,md->knd", weights, self.share, self.forces, optimize=True)
        along = forces @ flat.T  # (k, n, 3 q)
        across = np.sqrt(np.maximum((forces**2).sum(axis=2)[:, :, None] - along**2, 0.0))
        margin = weights @ self.torques @ flat.T - (weights @ self.slack)[:, None]
        margin -= np.einsum("n,knq->kq", self.shifts, across)
        good = (margin > MARGIN).reshape(len(weights), -1, 3)
        return np.asarray(good.all(axis=2).any(axis=0))

    def _programme(self, cost: FloatArray, rows: FloatArray) -> LpSolution | None:
        """Least cost over balanced weights of sum 1, and more unknowns, with rows @ x >= 0."""
        self.programmes += 1
        m, extra = len(self.forces), len(cost) - len(self.forces)
        balance = np.hstack([np.vstack([self.forces.T, np.ones(m)]), np.zeros((4, extra))])
        limits = np.vstack([np.tile([0.0, np.inf], (len(rows), 1)), np.zeros((4, 2))])
        limits[-1] = 1.0
        bounds = np.vstack([np.tile([0.0, np.inf], (m, 1)), np.tile([-np.inf, np.inf], (extra, 1))])
        found = solve_lp(cost, np.vstack([rows, balance]), limits, bounds)
        # Cones next to nothing bring numerical trouble: no forces, no proof.
        return found if isinstance(found, LpSolution) else None


def _robust_forces(mu: float, mu_torsion: float, tilt: float, edges: int) -> FloatArray:
    """Generators (m, 4), f_n = 1, f_t1, f_t2, torsion (m), of what every tilt leaves in the cone.

    The inscribed pyramid of k edges holds |f_t| / (mu cos(pi / k)) + |s| / mu_torsion <= f_n at any
    phase. A force at the angle b from the nominal normal is at most b + tilt from a tilted one.
    With c and d the cosine and sine of that, none may leave the cone, and torsion may be up to
    mu_torsion |f| (c - d / (mu cos(pi / k))). As a function of f the bound is the least of the
    concave bounds of all tilts: concave, so the forces are a convex cone. Empty where the tilt
    exceeds the friction angle.
    """
    sliding = mu * np.cos(np.pi / edges)
    widest = np.arctan(sliding) - tilt
    if widest < 0:
        return np.zeros((0, 4))
    rings = [np.array([[1.0, 0.0, 0.0]])]
    for share, count in _RINGS if widest > 0 else ():
        angle = 2 * np.pi * np.arange(count) / count
        radius = share * np.tan(widest)
        rings.append(
            np.column_stack([np.ones(count), radius * np.cos(angle), radius * np.sin(angle)])
        )
    forces = np.vstack(rings)
    plain = np.column_stack([forces, np.zeros(len(forces))])
    if mu_torsion == 0.0:
        return plain
    size = np.linalg.norm(forces, axis=1)
    off = np.arccos(np.clip(1.0 / size, -1.0, 1.0)) + tilt
    used = np.sin(off) / sliding if sliding > 0 else np.zeros(len(forces))
    room = mu_torsion * size * np.maximum(np.cos(off) - used, 0.0)
    lift = np.column_stack([np.zeros((len(forces), 3)), room])
    return np.vstack([plain, plain + lift, plain - lift])
