"""What the loops of a run of least squares read and write, as arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.numerics.tape import Program
from planner.spatial import FloatArray, IntArray
from planner.synthesis.loops.field import SplineTables

__all__ = ["ProblemTables", "RunTables", "Sources"]


class ProblemTables(NamedTuple):
    """What is the same for all runs of a problem.

    Rows of the written terms come by rows, those that must hold first. Points that move with the
    hand are fixed in joints' frames; joint 0 is the base, or an arm's root. What a program computes
    is found at ``*_at`` in its work array.

    Attributes:
        program: Written terms and kinematics. Its arguments: unknowns, parameters, Taylor rows.
        taylor_begin: Where the Taylor rows of a mesh begin in its work array; -1 without a mesh.
        values_at: Of each written row its value (m,).
        entries_at: Entries of their Jacobian, by rows (e,).
        entry_columns: The unknown of each entry (e,).
        entry_ends: Where each row's entries end (m,).
        both: Whether a row counts on both sides of zero (m,).
        n_required: So many of the written rows must hold.
        twists_at: Of each joint linear and angular rate (nq, 6), in the frame of its placement.
        rotation_at: R0 M(s) by rows (9,).
        joints_at: Of each joint its rotation by rows, then its origin (nq + 1, 12).
        normals_at: Outward normals at the contacts (n, 3).
        slopes_at: Their Jacobians by the contacts (n, 3, 3).
        point_begin: First unknown of the contact points.
        chains: Joints (places in q) that move what is fixed to each joint, all in one array.
        chain_ends: Where those of each joint end (nq + 1,).
        carried: Whether s and t move what is fixed to a joint (nq + 1,).
        sphere_joint, sphere_point: Spheres that avoid object and obstacles (k,), (k, 3).
        hull_joint, hull_point: Spheres that avoid the table.
        capsule_joint, capsule_inner, capsule_outer: Capsules of the fingers.
        pairs: Capsules (k, 2) that can meet.
        clearance: Clearance from an object that is an expression, and its gradient.
        clearance_at: Value, gradient (4,).
        clearance_point: Where its argument, the point, begins.
        box: The same of an obstacle.
        box_at, box_point: See ``clearance``.
    """

    program: Program
    taylor_begin: int
    values_at: IntArray
    entries_at: IntArray
    entry_columns: IntArray
    entry_ends: IntArray
    both: NDArray[np.bool_]
    n_required: int
    twists_at: IntArray
    rotation_at: IntArray
    joints_at: IntArray
    normals_at: IntArray
    slopes_at: IntArray
    point_begin: int
    chains: IntArray
    chain_ends: IntArray
    carried: NDArray[np.bool_]
    sphere_joint: IntArray
    sphere_point: FloatArray
    hull_joint: IntArray
    hull_point: FloatArray
    capsule_joint: IntArray
    capsule_inner: FloatArray
    capsule_outer: FloatArray
    pairs: IntArray
    clearance: Program
    clearance_at: IntArray
    clearance_point: int
    box: Program
    box_at: IntArray
    box_point: int


class RunTables(NamedTuple):
    """Numbers of one task, and the rows of the last evaluation.

    Attributes:
        work: Work array of ``program``, with parameters and constants.
        reach: What each sphere's clearance from the object must be, m; -inf where it need not be.
        gaps: On a mesh: last known clearance of each sphere less ``reach``, m.
        seen: On a mesh: where each sphere was when it was last looked up (k, 3), m.
        lanes: Work array of ``clearance``, a column for each sphere.
        box_lanes: The same of each obstacle (o, w, k).
        obstacle_reach: What each sphere's clearance from obstacles must be (k,), m.
        root: Rotation of an arm's root in the object's frame (3, 3); unused without an arm.
        root_origin: Its origin (3,), m.
        normal: Of the table (3,).
        height: What each hull sphere's height along the normal must be (k,), m.
        apart: Of each pair of capsules the squared distance asked for, m2.
        field: Distance field of a mesh.
        mu: Friction (-).
        length: Characteristic length, m.
        residuals: Weighted rows (r,).
        row_ends: Where the entries of each row end (r,).
        columns, entries: Unknown and value of each entry.
        least: Least value of clearances from object, table, obstacles, fingers, true links, (5,);
            0 where none is violated.
        kept: What is known at ``kept_x``: rows that depend on the unknowns alone, or -1 if none;
            their entries.
        kept_x: Unknowns at the last evaluation (n,).
        kept_worst: Largest of those rows that must hold (1,).
    """

    work: FloatArray
    reach: FloatArray
    gaps: FloatArray
    seen: FloatArray
    lanes: FloatArray
    box_lanes: FloatArray
    obstacle_reach: FloatArray
    root: FloatArray
    root_origin: FloatArray
    normal: FloatArray
    height: FloatArray
    apart: FloatArray
    field: SplineTables
    mu: float
    length: float
    residuals: FloatArray
    row_ends: IntArray
    columns: IntArray
    entries: FloatArray
    least: FloatArray
    kept: IntArray
    kept_x: FloatArray
    kept_worst: FloatArray


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
