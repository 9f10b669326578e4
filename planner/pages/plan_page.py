"""The page of a ``GraspPlan``: approach and closing as a motion, contacts, forces, quality.

``with_alternatives``: other grasps of the same task as ghosts beside the one of a page.
"""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby

import numpy as np

from planner.files.plans import plan_to_dict
from planner.pages.blocks import (
    Block,
    Command,
    Facts,
    Folded,
    Heading,
    Sentence,
    Table,
    Verdict,
    resisted_forces,
)
from planner.pages.page import Page, own_scripts, without_folder
from planner.pages.plan_scene import Stage, planned_contacts, stage_of
from planner.pages.scene import Actor, Band, Model, Motion, Scene, pose_row, pose_rows
from planner.plan import GraspPlan, JointTrajectory
from planner.shapes.mesh import Mesh
from planner.shapes.meshes.triangles import simplified
from planner.system.package import written_by
from planner.task import GraspTask

RATE = 30.0
"""Samples of a motion per second in a page."""


def plan_page(plan: GraspPlan) -> Page:
    """The page of a plan; its numbers are the plan file, which ``read_page_data`` gives back."""
    task, stage = plan.task, stage_of(plan)
    return Page(
        title=f"{task.hand.name} grasps {without_folder(task.object.shape.spec)}",
        subtitle=f"Grasp plan, seed {plan.record.seed}, {len(task.finger_names)} fingers",
        verdict=_verdict(plan),
        summary=_summary(plan, stage.shown.note),
        scene=_scene(plan, stage),
        data=plan_to_dict(plan),
        kind="plan",
    )


def _scene(plan: GraspPlan, stage: Stage) -> Scene:
    trajectory = plan.joint_trajectory(rate_hz=RATE)
    return Scene(
        models=stage.models,
        actors=tuple(stage.actors),
        focus=stage.focus,
        radius=stage.radius,
        time=trajectory.times,
        motions=(hand_motion(trajectory),),
        contacts=(planned_contacts([plan.contacts]),),
        bands=bands_of(trajectory),
        start=float(trajectory.times[-1]),
        views=stage.views(plan.contacts),
    )


def hand_motion(trajectory: JointTrajectory) -> Motion:
    """A trajectory as the motion of the actor "hand"."""
    return Motion(
        actor="hand", pose=pose_rows(trajectory.T_world_base), q=np.array(trajectory.positions)
    )


def bands_of(trajectory: JointTrajectory) -> tuple[Band, ...]:
    """The phases of a trajectory, each from the last sample of the one before."""
    out, end = [], -1
    for name, members in groupby(trajectory.phases):
        begin, end = max(0, end), end + len(list(members))
        first, last = (float(trajectory.times[k]) for k in (begin, end))
        out.append(Band(name=name, begin=first, end=last))
    return tuple(out)


def _verdict(plan: GraspPlan) -> Verdict:
    closure = plan.quality.closure
    if closure.closed and plan.verification.ok and plan.forces.found:
        return Verdict(
            good=True,
            text="Verified",
            reason="Force closure holds, no geometry collides, and contact forces balance the "
            "object's weight.",
        )
    failure = plan.verification.failure
    reason = closure.reason if failure is None else failure.text
    return Verdict(good=False, text="Not verified", reason=reason)


def _summary(plan: GraspPlan, note: str) -> tuple[Block, ...]:
    quality, closure = plan.quality, plan.quality.closure
    resisted = resisted_forces(plan.contacts, plan.task.object.shape.bounding_radius)
    nearest = plan.verification.closest[0] if plan.verification.closest else None
    blocks: list[Block] = [
        Heading(text="Quality"),
        Facts(
            rows=(
                ("epsilon (L1, discretised cones)", f"{quality.epsilon:.4f}"),
                ("epsilon (L1, true cones)", str(quality.epsilon_round)),
                ("normalised min-weight", f"{closure.normalised_min_weight:.3f} of at most 1"),
                ("nearest pair", "none" if nearest is None else str(nearest)),
                ("largest pad gap", f"{1e6 * np.abs(plan.verification.pad_gaps).max():.1f} µm"),
            )
        ),
        *([] if resisted is None else [resisted]),
        Heading(text="Contacts"),
        _contact_table(plan),
        Heading(text="Task"),
        Facts(rows=task_facts(plan.task)),
        *_origin(plan),
        Folded(title="Joints at pre-grasp and grasp", blocks=(_joint_table(plan),)),
    ]
    if note:
        blocks.append(Sentence(text=note))
    return tuple(blocks)


def _contact_table(plan: GraspPlan) -> Table:
    at, used = plan.contacts_in_object.positions, plan.contacts.friction_utilisation()
    rows = tuple(
        (
            name,
            ", ".join(f"{1e3 * v:.1f}" for v in at[i]),
            f"{plan.contacts.forces[i, 0]:.2f}",
            f"{np.linalg.norm(plan.contacts.forces[i, 1:3]):.2f}",
            f"{100 * used[i]:.0f} %",
            f"{1e6 * plan.verification.pad_gaps[i]:z.1f}",
        )
        for i, name in enumerate(plan.task.finger_names)
    )
    columns = (
        "finger",
        "in the object (mm)",
        "normal force (N)",
        "tangential (N)",
        "cone used",
        "pad gap (µm)",
    )
    return Table(columns=columns, rows=rows, fingers=True)


def _joint_table(plan: GraspPlan) -> Table:
    hand = plan.task.hand
    torques = plan.forces.joint_torques
    rows = tuple(
        (
            name,
            f"{plan.q_pregrasp[i]:.3f}",
            f"{plan.q[i]:.3f}",
            f"{hand.q_lower[i]:.3f} to {hand.q_upper[i]:.3f}",
            f"{torques[i]:.3f}" if len(torques) == hand.nq else "",
        )
        for i, name in enumerate(hand.joint_names)
    )
    columns = ("joint", "pre-grasp (rad, m)", "grasp", "range", "torque (N m, N)")
    return Table(columns=columns, rows=rows)


def task_facts(task: GraspTask) -> tuple[tuple[str, str], ...]:
    """What was asked, for the summary of any page."""
    gravity = float(np.linalg.norm(task.gravity))
    table = "none" if task.table_height is None else f"top at z = {task.table_height:.3f} m"
    rows = [
        ("hand", f"{task.hand.name}, fingers {', '.join(task.finger_names)}"),
        ("object", f"{task.object.shape.spec}, {1e3 * task.object.mass:.0f} g"),
        *([("mended", task.object.mended)] if task.object.mended else []),
        ("table", table),
        (
            "friction",
            f"mu {task.mu:g}, torsional {1e3 * task.mu_torsion:g} mm, "
            f"{task.contact_model} contacts",
        ),
        ("gravity", f"{gravity:.2f} m/s²"),
        ("grip force", f"{task.grip_force:.2f} N per finger"),
    ]
    if task.obstacles:
        rows.append(("obstacles", ", ".join(o.name for o in task.obstacles)))
    return tuple(rows)


def _origin(plan: GraspPlan) -> tuple[Block, ...]:
    record = plan.record
    blocks: list[Block] = [
        Heading(text="Where it comes from"),
        Facts(
            rows=(
                ("found", f"at attempt {record.attempt + 1} of seed {record.seed}"),
                ("CPU time", f"{record.cpu_s:.2f} s, building the problem {record.build_s:.2f} s"),
                ("objective", record.objective),
                ("written by", written_by()),
                ("hand's SHA-256", plan.task.hand.digest),
            )
        ),
    ]
    command = plan_command(plan)
    if command:
        blocks += [Sentence(text="The same plan again:"), Command(text=command)]
    else:
        blocks.append(
            Sentence(
                text="The task was made in Python; the numbers of this page are its plan file, "
                "which planner.read_plan reads."
            )
        )
    return tuple(blocks)


def plan_command(plan: GraspPlan) -> str:
    """The command line that gives the plan again; "" where the command line cannot say the task.

    Margins and weights of the search are taken to be the default ones: a plan does not keep them.
    """
    task, record, shape = plan.task, plan.record, plan.task.object.shape
    if task.hand.reference is None or task.hand.rolls or record.objective == "task":
        return ""
    # it may be one of the sets of a type, found in turns
    if task.hand.pair or not task.is_of_fingertips:
        return ""
    if isinstance(shape, Mesh) and shape.source is None:
        return ""
    again = GraspTask.create(task.hand, task.object, mu=task.mu, fingers=task.finger_names)
    same = (
        again.table_height == task.table_height
        and not task.obstacles
        and np.allclose(again.T_world_object.homogeneous, task.T_world_object.homogeneous)
        and np.allclose(again.gravity, task.gravity)
        and again.mu_torsion == task.mu_torsion
        and again.contact_model == task.contact_model
        and np.isclose(again.grip_force, task.grip_force)
        and (again.T_world_base is None) == (task.T_world_base is None)
        and not task.wrist_free
        and task.object.touch is None
    )
    if not same:
        return ""
    words = ["opposable", "plan", task.hand.reference, task.object.shape.spec]
    words += ["--seed", str(record.seed)]
    if not task.may_spare_fingers:
        words += ["--fingers", ",".join(task.finger_names)]
    words += ["--mu", f"{task.mu!r}", "--mass", f"{task.object.mass!r}"]
    if record.objective != "epsilon":
        words += ["--objective", record.objective]
    return shlex.join(words)


OPACITY, COLOUR = 0.17, (0.45, 0.60, 0.80, 1.0)
"""Of a ghost: alike for all its parts, whose own colours would hide the hand of the plan."""

MOST_TRIANGLES = 300
"""Of each part of a ghost."""


def with_alternatives(page: Page, plans: Sequence[GraspPlan], failed: Sequence[str] = ()) -> Page:
    """A plan's page with other plans of its task: hands at their grasps, and a list of them.

    Args:
        page: The page of a plan.
        plans: The others.
        failed: A sentence for each seed that gave none.
    """
    assert page.scene is not None
    actors = [
        Actor(
            name=f"seed {plan.record.seed}",
            model=GHOST,
            pose=pose_row(plan.T_world_base),
            q=plan.q,
            layer="alternatives",
            opacity=OPACITY,
        )
        for plan in plans
    ]
    ghost = _ghost(page.scene.models["hand"])
    scene = replace(
        page.scene,
        models={**page.scene.models, GHOST: ghost},
        actors=(*page.scene.actors, *actors),
        off=page.scene.off - {"alternatives"},
    )
    listed = [
        {
            "actor": actor.name,
            "epsilon": plan.quality.epsilon,
            "min_weight": plan.quality.closure.normalised_min_weight,
            "strongest_N": float(plan.contacts.forces[:, 0].max()),
            "fingers": list(plan.task.finger_names),
        }
        for actor, plan in zip(actors, plans, strict=True)
    ]
    return replace(
        page,
        scene=scene,
        scripts=(*page.scripts, *own_scripts("side.js", "alternatives.js")),
        extra={**page.extra, "alternatives": {"plans": listed, "failed": list(failed)}},
    )


GHOST = "ghost of the hand"


def _ghost(hand: Model) -> Model:
    """A hand in one colour, without pads, and with fewer triangles."""
    parts = []
    for part in hand.parts:
        if part.layer == "hand":
            vertices, triangles, _ = simplified(part.vertices, part.triangles, MOST_TRIANGLES)
            parts.append(replace(part, vertices=vertices, triangles=triangles, colour=COLOUR))
    return Model(joints=hand.joints, parts=tuple(parts))
