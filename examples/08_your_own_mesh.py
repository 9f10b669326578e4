"""Grasp a concave object from a mesh file, only where it may be touched.

A mug is written to mug.stl in the current folder, in millimetres, and read back with its scale. It
stands on the table in its most stable pose. Fingers may touch it above its middle and not at its
handle. Prints what the mesh is, how far the smooth field of the NLP is from it, and the contacts:
every one of them above the middle, within 0.5 mm of the true triangles.
"""

from __future__ import annotations

import numpy as np
import trimesh

from planner import GraspTask, parse_object, plan_grasp
from planner.objects import TouchRegion, parse_region
from planner.shapes import Mesh, Mug

HAND = "allegro_hand"
RADIUS, HEIGHT = 0.035, 0.09  # m
ABOVE = parse_region("z>-0.005")  # m from the centre of mass, in the mug's axes
HANDLE = parse_region("x>0.037")
SEED = 0

mug = Mug(RADIUS, HEIGHT)
trimesh.Trimesh(1e3 * mug.vertices, mug.faces, process=False).export("mug.stl")

touch = TouchRegion(allowed=(ABOVE,), forbidden=(HANDLE,))
item = parse_object("mug.stl*0.001", mass=0.2, touch=touch)
mesh = item.shape
assert isinstance(mesh, Mesh)
hull = trimesh.convex.convex_hull(mesh.vertices).volume
share = mesh.volume / hull
print(f"{len(mesh.faces)} triangles, {1e6 * mesh.volume:.0f} cm3, {share:.2f} of its hull")
for k, pose in enumerate(mesh.resting_poses()):
    print(f"stable pose {k}: tips over at {pose.margin_deg:.0f} degrees")

points, _ = mesh.surface_samples(200, np.random.default_rng(0))
off = 1e3 * np.abs(mesh.field().value(points))
print(f"the NLP's smooth surface is {np.median(off):.2f} mm off in the median")

plan = plan_grasp(GraspTask.create(HAND, item), seed=SEED)
print(f"found at attempt {plan.record.attempts}")
gaps = plan.verification.pad_gaps
for name, point, gap in zip(
    plan.contacts.fingers, plan.contacts_in_object.positions, gaps, strict=True
):
    x, y, z = 1e3 * point
    print(f"{name:7} at {x:6.1f} {y:6.1f} {z:6.1f} mm, {1e6 * gap:6.2f} um from the triangles")
allowed = touch.permits(plan.contacts_in_object.positions)
print(f"allowed: {int(allowed.sum())} of {len(allowed)}; {plan.quality.closure.reason}")
