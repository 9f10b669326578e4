"""Starts on a mesh: the hand's opposition axis through a pair of opposed surface points.

A start draws pairs, near the centre of mass by preference, and postures whose pads leave a slightly
wider gap. Of a few turns of the hand about each axis those are kept at which pads are near the
surface and the rest of the hand is clear of it and of the table. Of these the start is the one
whose nearest surface points have the greatest resistance in their weakest direction of wrench.

Pairs are found along rays through the body, from points spread over the surface: at the first exit,
of a wall, a handle or a rim, and at the last one, across a hollow. Where the other side faces back,
within the friction cone or nearly, the two points can be pressed against each other.

On a solid, rays run against the normals through the smooth distance, whose normals are even where a
scan is rough. It has no walls thinner than its grid: on those, rays pass through the triangles. A
second ray of each point is tilted there, since the sides of bowls and cups lean.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np

from planner.errors import TaskError
from planner.shapes import Mesh
from planner.spatial import SE3, FloatArray
from planner.synthesis.link_spheres import link_spheres
from planner.synthesis.seeds.draw import STEEPEST, Seeder
from planner.synthesis.seeds.opposition import Postures, measure_postures, opposition
from planner.synthesis.terms.resistance import least_resisted
from planner.tolerances import EDGE_RADIUS, EDGE_SPREAD

SAMPLES = 600
"""Surface points from which rays go through the body."""

STEP = 0.001
"""Step (m) along a ray through the smooth distance."""

FACING = float(np.cos(np.deg2rad(35.0)))
"""Smallest cosine between the line through both points and each normal: a little more than a
friction cone of 0.5 (27 degrees), since the solver moves contacts."""

TILT = 0.45
"""Sine of the largest angle (27 degrees) between a normal and the second ray of its point. On a
bowl that lies upside down, 100 mm wide, the Allegro-type hand found 18.6 grasps per CPU second with
it and 0.2 without. On solids it does not help: of 20 attempts at a hammer 5 found a grasp, not 10.
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class OpposedPairs:
    """Pairs of opposed surface points, in the object's frame.

    Attributes:
        centers: (n, 3), half-way between, m.
        directions: (n, 3), unit, from one point to the other.
        widths: (n,), distance of the two, m.
    """

    centers: FloatArray
    directions: FloatArray
    widths: FloatArray


@lru_cache(maxsize=16)
def opposed_pairs(mesh: Mesh) -> OpposedPairs:
    """Opposed pairs of a mesh; always the same ones."""
    rng = np.random.default_rng(0)
    points, normals = mesh.surface_samples(SAMPLES, rng)
    if not mesh.thin_walled:
        return _through_field(mesh, points, normals)
    tilt = rng.normal(size=normals.shape)
    tilt *= TILT / np.linalg.norm(tilt, axis=1, keepdims=True)
    tilted = tilt - normals
    tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
    return _through_triangles(mesh, np.vstack([points, points]), np.vstack([-normals, tilted]))


def _through_triangles(mesh: Mesh, points: FloatArray, directions: FloatArray) -> OpposedPairs:
    """Pairs along rays from surface points (n, 3), m, in unit directions (n, 3)."""
    ray, depth, across = mesh.pierced(points, directions)
    facing = np.einsum("ij,ij->i", across, directions[ray])
    ray, depth, facing = (v[facing > 0.0] for v in (ray, depth, facing))  # where rays leave
    first = np.flatnonzero(np.diff(ray, prepend=-1))
    last = np.flatnonzero(np.diff(ray, append=-1))
    exits = np.concatenate([first, last[last > first]])
    exits = exits[facing[exits] >= FACING]
    return _pairs(points[ray[exits]], directions[ray[exits]], depth[exits])


def _through_field(mesh: Mesh, points: FloatArray, normals: FloatArray) -> OpposedPairs:
    """Pairs along rays from surface points (n, 3), m, against their normals (n, 3)."""
    field = mesh.field()
    depths = np.arange(STEP, 2 * mesh.bounding_radius, STEP)
    first, last = np.zeros(len(points)), np.zeros(len(points))
    before = np.full(len(points), -STEP)
    for depth in depths:
        value = field.taylor(points - depth * normals, 0)[:, 0]
        out = (before < 0.0) & (value >= 0.0) & (depth > STEP)
        share = value / np.where(out, value - before, 1.0)
        last[out] = (depth - STEP * np.clip(share, 0.0, 1.0))[out]
        first[out & (first == 0.0)] = last[out & (first == 0.0)]
        before = value
    through = last > first
    points = np.vstack([points, points[through]])
    directions = -np.vstack([normals, normals[through]])
    width = np.concatenate([first, last[through]])
    found = width > 0.0
    points, directions, width = points[found], directions[found], width[found]
    gradients = field.taylor(points + width[:, None] * directions, 1)[:, 1:4]
    gradients /= np.maximum(np.linalg.norm(gradients, axis=1, keepdims=True), 1e-9)
    back = np.einsum("ij,ij->i", gradients, directions) >= FACING
    return _pairs(points[back], directions[back], width[back])


def _pairs(points: FloatArray, directions: FloatArray, widths: FloatArray) -> OpposedPairs:
    centers = points + widths[:, None] / 2 * directions
    return OpposedPairs(centers=centers, directions=directions, widths=widths)


POSTURES, NOISES = 128, (0.03, 0.1)
"""Postures of the starts, and least and largest standard deviation of their joints, in shares of
their range."""

PLACES, TURNS = 12, 4
"""Pairs tried for one start, and turns of the hand about the axis of each."""

LOOKED_AT = 16
"""Number of poses, those with most room and nearest pads, that are compared by resistance."""

RESISTANCE_WORTH = 0.3
"""Room (m) that counts like one unit of resistance (normal forces sum to 1): a grasp that is
stronger by 0.05 may start 15 mm worse."""

TURN_NOISE = 0.8
"""Standard deviation (rad) of these turns about straight from above; any turn without a table."""

SPARE = 0.02
"""Fingers are opened by up to this much (m) wider than the pair."""

POSITION_NOISE = 0.004
"""Standard deviation (m) of the hand's position about the pair's middle."""

NEAR_CENTER = 0.6
"""Distance from the centre of mass, in bounding radii, at which a pair is taken 1/e as often."""

ROOM = 0.004
"""Clearance (m) of links beyond which more is no better."""

SAMPLES, FLATTEST = 600, 0.1
"""Surface points among which places for pads are looked for, and the flattest share of them that
counts as flat on a solid that is edges all over."""

FACING_WORTH = 0.03
"""Distance (m) that counts like a cosine of 1 by which a pad faces beside a place."""

MISS_WORTH = 1.0
"""How much (-) the mean miss of a start's pads counts."""

ABOVE_TABLE = 0.004
"""Height (m) over the table, on top of a pad's radius, that a pair's middle needs."""


class MeshSeeder(Seeder):
    """Draws starts for a task with a mesh.

    Attributes:
        near_center: See ``NEAR_CENTER``.
        turn_noise: See ``TURN_NOISE``.
        steepest: Largest cosine between a pair's line and the vertical, for an object on a table.
    """

    near_center = NEAR_CENTER
    turn_noise = TURN_NOISE
    steepest = STEEPEST

    def _prepare(self) -> None:
        """Find the pairs that the hand can close on.

        Raises:
            TaskError: There is none.
        """
        task = self.task
        mesh = task.object.shape
        if not isinstance(mesh, Mesh):
            raise TaskError(f"{task.object.name} is not a mesh; use seeder_for(task)")
        self._mesh = mesh
        pairs = opposed_pairs(mesh)
        T = task.T_world_object
        able = pairs.widths < self.widest
        half = pairs.widths[:, None] / 2 * pairs.directions
        able &= task.object.permits(pairs.centers + half)
        able &= task.object.permits(pairs.centers - half)
        if task.table_height is not None:
            level = np.abs(pairs.directions @ T.rotation[2]) < self.steepest
            height = pairs.centers @ T.rotation[2] + T.translation[2] - task.table_height
            pad = max(f.pad.radius for f in task.fingers)
            high = height > pad + ABOVE_TABLE
            # of a plate no faces stand level: then any of them, and the verdict decides
            able &= level if (able & level).any() else True
            # a flat object has none that high: then any of them
            able &= high if (able & high).any() else True
        if not able.any():
            least = float(pairs.widths.min(initial=np.inf))
            places = (
                f"{len(pairs.widths)} places with opposed faces, the narrowest {1e3 * least:.0f} "
                "mm wide, none of them within reach and where it may be touched"
                if len(pairs.widths)
                else "no places with opposed faces"
            )
            raise TaskError(
                f"{task.hand.name} finds nowhere to close on {task.object.name}: its pads open "
                f"{1e3 * self.widest:.0f} mm; the object has {places}; try another pose, other "
                "fingers or a larger hand"
            )
        far = np.linalg.norm(pairs.centers, axis=1) / (self.near_center * mesh.bounding_radius)
        weight = np.where(able, np.exp(-(far**2)), 0.0)
        self._pairs, self._chance = pairs, weight / weight.sum()
        arm = task.hand.arm.geometries if task.hand.arm is not None else frozenset()
        self._spheres = [b for b in link_spheres(task.hand) if b.geometry not in arm]
        self._radii = np.array([b.radius for b in self._spheres])
        self._touching = np.array(
            [b.is_pad and b.finger in task.finger_names for b in self._spheres]
        )
        self._widest_stretch = float(self.stretches[np.argmax(self.gaps)])
        self._postures = self._drawn_postures()

    def _place(self, rng: np.random.Generator) -> tuple[SE3, FloatArray]:
        """Of some poses the one with room for the hand and the greatest resistance of its pads."""
        task, postures, mesh = self.task, self._postures, self._mesh
        numbers = rng.choice(len(self._chance), size=PLACES, p=self._chance)
        gaps = self._pairs.widths[numbers] + rng.uniform(0.0, SPARE, PLACES)
        which = np.array([postures.draw(float(gap), rng) for gap in gaps])
        if task.T_world_base is not None and task.hand.arm is None:
            return task.T_world_base, self._with_noise(postures.q[which[0]], rng)
        axes = self._pairs.directions[numbers] * rng.choice([-1.0, 1.0], (PLACES, 1))
        centers = self._pairs.centers[numbers] + rng.normal(0, POSITION_NOISE, (PLACES, 3))
        axes, centers, which = (np.repeat(v, TURNS, axis=0) for v in (axes, centers, which))
        turns = _frames(axes, self._sides(axes, rng)) @ postures.frames[which].transpose(0, 2, 1)
        shifts = centers - (turns @ postures.centers[which][:, :, None])[:, :, 0]
        merits = self._merits(turns, shifts, postures.spheres[which])
        best = np.argsort(-merits, kind="stable")[:LOOKED_AT]
        back = turns[best].transpose(0, 2, 1)
        pads = postures.pads[which[best]] @ back + shifts[best, None]
        points, outward, miss = self._places_of(pads, postures.facing[which[best]] @ back)
        resisted = least_resisted(points, outward, mu=task.mu, length=mesh.bounding_radius)
        worth = RESISTANCE_WORTH * resisted - MISS_WORTH * miss.mean(axis=1)
        k = best[int(np.argmax(merits[best] + worth))]
        return task.T_world_object * SE3(turns[k], shifts[k]), postures.q[which[k]]

    def _places_of(
        self, pads: FloatArray, facing: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Places of k hands' pads: points, normals (k, n, 3), and by how much they miss (k, n), m.

        Args:
            pads: Centres of the pads (k, n, 3), m, object frame.
            facing: Their axes (k, n, 3), unit.
        """
        found = self._mesh.field().taylor(pads.reshape(-1, 3), 1)
        outward = found[:, 1:4] / np.maximum(np.linalg.norm(found[:, 1:4], axis=1), TINY)[:, None]
        points = pads.reshape(-1, 3) - found[:, :1] * outward
        return points.reshape(pads.shape), outward.reshape(pads.shape), np.zeros(pads.shape[:2])

    def _drawn_postures(self) -> Postures:
        """Postures of the hand; the same for every seed."""
        task, rng = self.task, np.random.default_rng(0)
        span = task.hand.q_upper - task.hand.q_lower
        drawn = []
        for stretch in np.linspace(0.0, self._widest_stretch, POSTURES):
            q = self._stretched(stretch) + rng.normal(0, rng.uniform(*NOISES), len(span)) * span
            q = np.clip(q, task.hand.q_lower, task.hand.q_upper)
            drawn.append(self._with_wrist(q))
        opposed = partial(opposition, task)
        return measure_postures(task.hand, task.fingers, self._spheres, drawn, opposed)

    def _sides(self, axes: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Directions across axes (n, 3) for the palm: from above, with much noise, over a table."""
        up = rng.normal(size=axes.shape)
        if self.task.table_height is not None:
            up = np.tile(self.task.T_world_object.rotation[2], (len(axes), 1))
        up -= axes * np.einsum("ij,ij->i", axes, up)[:, None]
        upright = np.linalg.norm(up, axis=1) < TINY
        up[upright] = np.cross(axes[upright], np.roll(axes[upright], 1, axis=1))
        up /= np.linalg.norm(up, axis=1, keepdims=True)
        turn = rng.normal(0, self.turn_noise, (len(axes), 1))
        return np.cos(turn) * up + np.sin(turn) * np.cross(axes, up)

    def _merits(self, turns: FloatArray, shifts: FloatArray, spheres: FloatArray) -> FloatArray:
        """How well bases at (n, 3, 3), (n, 3) in the object suit, (n,), m: room less pads' gaps."""
        task = self.task
        points = spheres @ turns.transpose(0, 2, 1) + shifts[:, None]
        gaps = self._mesh.field().rough_value(points.reshape(-1, 3)).reshape(points.shape[:2])
        gaps -= self._radii
        room = np.where(self._touching, ROOM, gaps)
        if task.table_height is not None:
            T = task.T_world_object
            heights = points @ T.rotation[2] + T.translation[2] - task.table_height
            room = np.minimum(room, heights - self._radii)
        off = np.abs(gaps[:, self._touching]).mean(axis=1)
        merit: FloatArray = np.minimum(room.min(axis=1), ROOM) - off
        return merit


class NarrowSeeder(MeshSeeder):
    """Draws starts on a mesh whose faces are as narrow as pads: flat places, which pads face.

    The nearest point is on an edge there as often as not.
    """

    def _prepare(self) -> None:
        super()._prepare()
        self._places = _flat_places(self._mesh)

    def _places_of(
        self, pads: FloatArray, facing: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        at, normals = self._places
        radii = np.array([f.pad.radius for f in self.task.fingers])
        rims = np.array([f.pad.half_angle for f in self.task.fingers])[:, None]
        ahead = pads[:, :, None] - at - radii[:, None, None] * normals
        miss = np.sqrt(np.einsum("knpi,knpi->knp", ahead, ahead))
        miss += FACING_WORTH * np.maximum(np.cos(rims) + facing @ normals.T, 0.0)
        best = miss.argmin(axis=2)
        return at[best], normals[best], np.take_along_axis(miss, best[:, :, None], 2)[:, :, 0]

    def _first_contacts(
        self, pads: FloatArray, facing: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        points, outward, _ = self._places_of(pads[None], facing[None])
        return points[0], outward[0]


@lru_cache(maxsize=16)
def _flat_places(mesh: Mesh) -> tuple[FloatArray, FloatArray]:
    """Points (k, 3), m, all over a mesh where the verdict sees no edge, and outward normals."""
    points, normals = mesh.surface_samples(SAMPLES, np.random.default_rng(0))
    spread = mesh.normal_dispersion(points, EDGE_RADIUS, facing=normals)
    # where nothing is flat: anywhere, and the verdict decides
    flat = spread < max(EDGE_SPREAD, float(np.quantile(spread, FLATTEST)))
    return points[flat], normals[flat]


def _frames(axes: FloatArray, sides: FloatArray) -> FloatArray:
    """Rotations (n, 3, 3): columns axis, side, and their product."""
    return np.stack([axes, sides, np.cross(axes, sides)], axis=2)


class TurningSeeder(MeshSeeder):
    """Draws starts from which a mesh is turned: level, near its centre, from above.

    An object pinched beside its centre of mass hangs on one side of the fingers, and moves on a
    circle as it turns; one pinched askew makes tips pivot.
    """

    near_center = 0.45
    turn_noise = 0.6
    steepest = 0.3

    def _prepare(self) -> None:
        super()._prepare()
        self.skin = 0.0  # motions are planned on the surface itself


TINY = 1e-9
"""A gradient shorter than this has no direction."""
