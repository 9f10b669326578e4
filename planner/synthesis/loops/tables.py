"""What the loops of a run of least squares read and write, as arrays.

numba handles small tuples of arrays far faster than large ones, so loops get the parts they need.
Points that move with the hand are fixed in joints' frames; joint 0 is the base, or an arm's root.
What a program computes is found at ``*_at`` in its work array.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.numerics.tape import Program
from planner.spatial import FloatArray, IntArray
from planner.synthesis.field_points import COEFFICIENTS
from planner.synthesis.loops.field import SplineTables
from planner.synthesis.terms.clearance import FINGERS, OBJECT, OBSTACLE, TABLE
from planner.synthesis.terms.link_distance import LINKS

SOURCES = (OBJECT, TABLE, OBSTACLE, FINGERS, LINKS)
"""Terms that must hold and whose rows come in numbers; each has its place in ``Rows.least``."""

OBJECT_PLACE, TABLE_PLACE, OBSTACLE_PLACE, FINGERS_PLACE, LINKS_PLACE = range(len(SOURCES))

TAYLOR_ROW = 3 + COEFFICIENTS
"""Numbers of a contact's Taylor row on a mesh: its point, then the coefficients there."""


class Written(NamedTuple):
    """The terms that are written as expressions; rows that must hold come first.

    Attributes:
        values_at: Of each row its value (m,).
        entries_at: Entries of their Jacobian, by rows (e,).
        entry_columns: The unknown of each entry (e,).
        entry_ends: Where each row's entries end (m,).
        both: Whether a row counts on both sides of zero (m,).
        n_required: So many of the rows must hold.
    """

    values_at: IntArray
    entries_at: IntArray
    entry_columns: IntArray
    entry_ends: IntArray
    both: NDArray[np.bool_]
    n_required: int


class Joints(NamedTuple):
    """How the hand moves.

    Attributes:
        twists_at: Of each joint linear and angular rate (nq, 6), in the frame of its placement.
        rotation_at: R0 M(s) (3, 3).
        joints_at: Of each joint its rotation by rows, then its origin (nq + 1, 12).
        chains: Joints (places in q) that move what is fixed to each joint, all in one array.
        chain_ends: Those of joint j are from ``chain_ends[j]`` to ``chain_ends[j + 1]`` (nq + 2,).
        carried: Whether s and t move what is fixed to a joint: 1 or 0 (nq + 1,).
    """

    twists_at: IntArray
    rotation_at: IntArray
    joints_at: IntArray
    chains: IntArray
    chain_ends: IntArray
    carried: IntArray


class Contacts(NamedTuple):
    """The contact points.

    Attributes:
        normals_at: Outward normals (n, 3).
        slopes_at: Their Jacobians by the contacts, by rows (n, 9).
        first: First unknown of the contact points.
        taylor: Where the Taylor rows of a mesh begin in the work array; -1 without a mesh.
    """

    normals_at: IntArray
    slopes_at: IntArray
    first: int
    taylor: int


class Points(NamedTuple):
    """Points (k, 3), m, each fixed in the frame of a joint (k,)."""

    joint: IntArray
    at: FloatArray


class Capsules(NamedTuple):
    """Capsules of the fingers: joint (k,), ends (k, 3), and pairs (p, 2) that can meet."""

    joint: IntArray
    inner: FloatArray
    outer: FloatArray
    pairs: IntArray


class Clearance(NamedTuple):
    """A clearance as a program of a point, which is at ``point`` in its work array.

    ``results`` (4,) are the places of value and gradient.
    """

    program: Program
    results: IntArray
    point: int


class ProblemTables(NamedTuple):
    """What is the same for all runs of a problem.

    Attributes:
        program: Written terms and kinematics; of unknowns, parameters, and Taylor rows of a mesh.
        written, joints, contacts, capsules: See there.
        spheres: Spheres that avoid object and obstacles.
        hull: Spheres that avoid the table.
        object: Clearance from the object; of a mesh it is not used.
        obstacle: Clearance from an obstacle.
    """

    program: Program
    written: Written
    joints: Joints
    contacts: Contacts
    spheres: Points
    hull: Points
    capsules: Capsules
    object: Clearance
    obstacle: Clearance


class ObjectRoom(NamedTuple):
    """Spheres and the object.

    Attributes:
        reach: What each sphere's clearance from the object must be, m; -inf where it need not be.
        known: On a mesh: last known clearance of each sphere less ``reach``, m.
        seen: On a mesh: where each sphere was when it was last looked up (k, 3), m.
        lanes: Work array of the clearance's program, a column for each sphere.
        field: Distance field of a mesh.
    """

    reach: FloatArray
    known: FloatArray
    seen: FloatArray
    lanes: FloatArray
    field: SplineTables


class Surroundings(NamedTuple):
    """Obstacles, table, other fingers, and the root of an arm.

    Attributes:
        lanes: Work array of the clearance from each obstacle, a column for each sphere (o, w, k).
        reach: What each sphere's clearance from obstacles must be (k,), m.
        normal: Of the table (3,).
        height: What each hull sphere's height along the normal must be (k,), m.
        apart: Of each pair of capsules the squared distance asked for, m2.
        root: Rotation of an arm's root in the object's frame (3, 3); unused without an arm.
        root_origin: Its origin (3,), m.
    """

    lanes: FloatArray
    reach: FloatArray
    normal: FloatArray
    height: FloatArray
    apart: FloatArray
    root: FloatArray
    root_origin: FloatArray


class Rows(NamedTuple):
    """The weighted rows of the last evaluation.

    Attributes:
        values: (r,).
        ends: Where the entries of each row end (r,).
        columns, entries: Unknown and value of each entry.
        least: Least value of each term of ``SOURCES`` (5,); 0 where none is violated.
    """

    values: FloatArray
    ends: IntArray
    columns: IntArray
    entries: FloatArray
    least: FloatArray


class Kept(NamedTuple):
    """Which rows depend on the unknowns alone, and stay while these do.

    Attributes:
        x: Unknowns at the last evaluation (n,).
        counts: Those rows, or -1 if none are known; their entries (2,).
        worst: Largest of them that must hold (1,).
    """

    x: FloatArray
    counts: IntArray
    worst: FloatArray


class RunTables(NamedTuple):
    """Numbers of one task, and the rows of the last evaluation.

    Attributes:
        work: Work array of the program, with parameters and constants.
        object, around, rows, kept: See there.
        mu: Friction (-).
        length: Characteristic length, m.
    """

    work: FloatArray
    object: ObjectRoom
    around: Surroundings
    rows: Rows
    kept: Kept
    mu: float
    length: float


class Sources(NamedTuple):
    """Rows that change from run to run.

    Attributes:
        link_values: Distances of true links less those asked for (k,), m.
        link_rows: Their derivatives by the unknowns (k, n).
        link_x: Where they were measured (n,).
        directions: Directions of wrench (d, 6).
        target: Resistance to reach in each (-).
    """

    link_values: FloatArray
    link_rows: FloatArray
    link_x: FloatArray
    directions: FloatArray
    target: float
