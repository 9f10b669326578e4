"""The pages of a motion, a gait and a manipulation plan: the planned movement over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from planner.files.gaits import gait_to_dict
from planner.files.manipulations import manipulation_to_dict
from planner.files.motions import motion_to_dict
from planner.motion.gait import GaitPlan
from planner.motion.manipulation import ManipulationPlan
from planner.motion.plan import MotionPlan, MotionRecord
from planner.pages.blocks import Block, Facts, Folded, Heading, PlotsHere, Sentence, Table, Verdict
from planner.pages.object_track import Held, MotionKind, object_track
from planner.pages.page import Page
from planner.pages.plan_page import RATE, bands_of, hand_motion, task_facts
from planner.pages.plan_scene import Stage, contact_rows, stage_of, views_of
from planner.pages.rows import pose_rows
from planner.pages.scene import Contacts, Line, Motion, Plot, Scene
from planner.spatial import FloatArray, signed_twist
from planner.version import written_by

__all__ = ["gait_page", "manipulation_page", "motion_page", "motion_scene"]


def motion_page(plan: MotionPlan) -> Page:
    """The page of a motion on one set of contacts."""
    return _page(plan, plan, "motion", motion_to_dict(plan))


def gait_page(plan: GaitPlan) -> Page:
    """The page of strokes with relocations between them."""
    return _page(plan, plan.motion, "gait", gait_to_dict(plan))


def manipulation_page(plan: ManipulationPlan) -> Page:
    """The page of a whole manipulation: pick up, turn or move, put down."""
    return _page(plan, plan.motion, "manipulation", manipulation_to_dict(plan))


def _page(plan: MotionKind, motion: MotionPlan, kind: str, data: Mapping[str, Any]) -> Page:
    task, stage = motion.grasp.task, stage_of(motion.grasp)
    return Page(
        title=f"{task.hand.name} {_what(plan)} {task.object.shape.spec} in the hand",
        subtitle=f"Planned {kind}, seed {_record(plan).seed}, {len(task.finger_names)} fingers",
        verdict=Verdict(
            good=True,
            text="Verified",
            reason=f"At every knot of the plan the pads touch, force closure holds (least "
            f"normalised min-weight {_margin(plan):.3f}) and nothing else collides.",
        ),
        summary=_summary(plan, motion, stage.shown.note),
        scene=_scene(plan, motion, stage),
        data=data,
        kind=kind,
    )


def motion_scene(plan: MotionKind) -> Scene:
    """The scene of a motion, a gait or a manipulation plan, from the approach to its end."""
    motion = plan if isinstance(plan, MotionPlan) else plan.motion
    return _scene(plan, motion, stage_of(motion.grasp))


def _scene(plan: MotionKind, motion: MotionPlan, stage: Stage) -> Scene:
    trajectory = plan.joint_trajectory(rate_hz=RATE)
    track = object_track(plan, trajectory)
    grasp = motion.grasp
    return Scene(
        models=stage.models,
        actors=tuple(stage.actors),
        focus=stage.focus,
        radius=stage.radius,
        time=trajectory.times,
        motions=(
            hand_motion(trajectory),
            Motion(
                actor="object",
                pose=pose_rows(h.T_world_object for h in track),
                q=np.zeros((len(track), 0)),
            ),
        ),
        contacts=(_contacts(track, grasp.task.finger_names, grasp.task.mu),),
        plots=_plots(track, grasp.task.finger_names, motion.path.axis),
        bands=bands_of(trajectory),
        views=views_of(grasp.task.hand, grasp.T_world_palm, grasp.contacts),
        follow="object",
    )


def _contacts(track: Sequence[Held], fingers: tuple[str, ...], mu: float) -> Contacts:
    rows = np.full((3, len(track), len(fingers), 3), np.nan)
    for k, held in enumerate(track):
        if held.contacts is None:
            continue
        at = [fingers.index(f) for f in held.contacts.fingers]
        for part, values in zip(rows, contact_rows(held.contacts), strict=True):
            part[k, at] = values
    return Contacts(
        name="planned",
        layer="planned contacts",
        fingers=fingers,
        points=rows[0],
        normals=rows[1],
        forces=rows[2],
        mu=mu,
        actor="object",
    )


def _plots(track: Sequence[Held], fingers: tuple[str, ...], axis: FloatArray) -> tuple[Plot, ...]:
    force = np.full((len(fingers), len(track)), np.nan)
    used = force.copy()
    closure, off = np.full(len(track), np.nan), np.full(len(track), np.nan)
    for k, held in enumerate(track):
        if held.contacts is None:
            continue
        at = [fingers.index(f) for f in held.contacts.fingers]
        force[at, k] = held.contacts.forces[:, 0]
        used[at, k] = 100.0 * held.contacts.friction_utilisation()
        if held.knot is not None:
            closure[k] = held.knot.closure.normalised_min_weight
            off[k] = 1e3 * held.knot.off_path
    turn = _turned(track, axis)
    return (
        Plot(
            title="turn of the object from its start", unit="degrees", lines=(_line("turn", turn),)
        ),
        Plot(title="planned normal force", unit="N", lines=_by_finger(fingers, force)),
        Plot(title="planned use of the friction cone", unit="%", lines=_by_finger(fingers, used)),
        Plot(
            title="closure: normalised min-weight",
            unit="",
            lines=(_line("min-weight", closure),),
        ),
        Plot(title="object off its path", unit="mm", lines=(_line("distance", off),)),
    )


def _turned(track: Sequence[Held], axis: FloatArray) -> FloatArray:
    """Turn of the object about an axis (3,), world, since the beginning (m,), degrees."""
    first, turn = track[0].T_world_object.rotation, [0.0]
    for held in track[1:]:
        turned = held.T_world_object.rotation @ first.T
        turn.append(signed_twist(turned, axis, near=turn[-1]))
    degrees: FloatArray = np.rad2deg(np.array(turn))
    return degrees


def _line(name: str, values: FloatArray) -> Line:
    return Line(name=name, values=np.asarray(values), group=name)


def _by_finger(fingers: tuple[str, ...], values: FloatArray) -> tuple[Line, ...]:
    return tuple(
        Line(name=name, values=row, group=name) for name, row in zip(fingers, values, strict=True)
    )


def _what(plan: MotionKind) -> str:
    angle = plan.path.angle if isinstance(plan, MotionPlan) else plan.angle
    return f"turns by {np.rad2deg(angle):.0f} degrees" if abs(angle) > 1e-6 else "moves"


def _record(plan: MotionKind) -> MotionRecord:
    if isinstance(plan, ManipulationPlan):
        return plan.motion.record if plan.gait is None else plan.gait.record
    return plan.record


def _margin(plan: MotionKind) -> float:
    if isinstance(plan, ManipulationPlan):
        return plan.motion.margin if plan.gait is None else plan.gait.margin
    return plan.margin


def _summary(plan: MotionKind, motion: MotionPlan, note: str) -> tuple[Block, ...]:
    joint, room, where = motion.joint_room
    blocks: list[Block] = [
        PlotsHere(),
        Heading(text="Motion"),
        Facts(
            rows=(
                ("path of a stroke", str(motion.path)),
                ("knots of a stroke", str(len(motion.knots))),
                (
                    "off the path",
                    f"at most {1e3 * max(k.off_path for k in motion.knots):.2f} mm, tolerance "
                    f"{1e3 * motion.path_tolerance:.1f} mm",
                ),
                ("least clearance", f"{1e3 * motion.clearance:.2f} mm"),
                (
                    "nearest joint limit",
                    f"{joint}, {100 * room:.1f} % of its range away, at {100 * where:.0f} % of "
                    "the path",
                ),
                *_more_facts(plan),
            )
        ),
        Table(
            columns=("finger", "slides (mm)", "turns on its pad (degrees)"),
            rows=tuple(
                (name, f"{1e3 * s:.2f}", f"{np.rad2deg(t):.1f}")
                for name, s, t in zip(
                    motion.grasp.task.finger_names, motion.slipped, motion.pivoted, strict=True
                )
            ),
            fingers=True,
        ),
        Heading(text="Task"),
        Facts(rows=task_facts(motion.grasp.task)),
        Heading(text="Where it comes from"),
        Facts(
            rows=(
                ("found", f"at attempt {_record(plan).attempt + 1} of seed {_record(plan).seed}"),
                ("written by", written_by()),
                ("hand's SHA-256", motion.grasp.task.hand.digest),
            )
        ),
    ]
    if motion.limits:
        lines = tuple(Sentence(text=str(limit)) for limit in motion.limits)
        blocks.append(Folded(title="What keeps the path from being longer", blocks=lines))
    if note:
        blocks.append(Sentence(text=note))
    return tuple(blocks)


def _more_facts(plan: MotionKind) -> tuple[tuple[str, str], ...]:
    """What a gait or a manipulation has beyond its motion."""
    if isinstance(plan, MotionPlan):
        return ()
    if isinstance(plan, GaitPlan):
        return (
            ("strokes", str(plan.cycles)),
            ("fingers move on", ", ".join(plan.order)),
        )
    target = ", ".join(f"{v:.3f}" for v in plan.ending.T_world_target.translation)
    rows = [("put down at", f"({target}) m")]
    rows.append(("most loaded actuator", f"keeps {100 * plan.reserve:.0f} % of its limit"))
    if plan.ending.back:
        rows.append(("reversed before", plan.ending.back))
    return (*(_more_facts(plan.gait) if plan.gait is not None else ()), *rows)
