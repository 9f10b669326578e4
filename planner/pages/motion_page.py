"""``motion_page``: a planned movement: in the hand, of a tool, or from one hand to another.

``object_motion``: where the object is, and what touches it, along a planned trajectory.

A trajectory has joints and poses of the base alone. The object stands until the hand closes, then
goes along with the base, moves in the hand as the knots say, and stays where the hand opens, or
where another one has taken it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from planner.contacts import ContactSet
from planner.files.movements import movement_to_dict
from planner.motion import Knot, MovementPlan
from planner.pages.blocks import Block, Facts, Heading, PlotsHere, Sentence, Table, Verdict
from planner.pages.page import Page, without_folder
from planner.pages.plan_page import bands_of, hand_motion, task_facts
from planner.pages.plan_scene import Stage, contact_rows, stage_of
from planner.pages.scene import Contacts, Line, Motion, Plot, Scene, pose_rows
from planner.plan import GraspPlan, JointTrajectory
from planner.spatial import SE3, FloatArray, minimum_jerk, signed_twist

BEGIN = ("turn", "stroke", "use", "reach")
"""Beginnings of the phases at which a page opens."""

RATE = 30.0
"""Samples of a motion per second in a page."""


def motion_page(plan: MovementPlan) -> Page:
    """The page of a motion; its numbers are the plan's file."""
    grasp, stage = plan.grasp, stage_of(plan.grasp)
    return Page(
        title=_title(plan),
        subtitle=f"Movement plan: {_path(plan)}",
        verdict=Verdict(
            good=True,
            text="Verified",
            reason="At every knot the pads touch, force closure holds (least normalised min-weight "
            f"{plan.margin:.3f}), forces bear the weight, and nothing else collides.{_also(plan)}",
        ),
        summary=_summary(plan, stage.shown.note),
        scene=_scene(plan, grasp, stage),
        data=movement_to_dict(plan),
        kind="motion",
    )


def _title(plan: MovementPlan) -> str:
    hand, item = plan.task.hand.name, without_folder(plan.task.object.shape.spec)
    if plan.tool is not None:
        return f"{hand} uses {plan.tool.name}"
    return f"{hand} hands over {item}" if plan.handover else f"{hand} moves {item} in the hand"


def _also(plan: MovementPlan) -> str:
    """What was verified beside the knots."""
    if plan.handover is not None:
        return " The other hand's grasp has its closure and forces, and the ways of both are free."
    if plan.tool is None:
        return ""
    way = " and the way of the use is free" if plan.tool_use is not None else ""
    return f" What the tool needs is produced with its margin{way}."


def _path(plan: MovementPlan) -> str:
    if plan.held_phase is not None:
        return str(plan.held_phase).partition(": ")[2]
    strokes = f"{plan.cycles} strokes of " if plan.cycles > 1 else ""
    if plan.ending is None:
        return f"{strokes}{plan.path}"
    strokes = f", in {plan.cycles} strokes" if plan.cycles > 1 else ""
    last = "and put down" if plan.tool is None else "in its fixture"
    return f"turn by {np.rad2deg(plan.angle):.1f} degrees{strokes}, {last}"


def _scene(plan: MovementPlan, grasp: GraspPlan, stage: Stage) -> Scene:
    trajectory = plan.joint_trajectory(rate_hz=RATE)
    found = object_motion(plan, trajectory)
    bands = bands_of(trajectory)
    start = next((b.begin for b in bands if b.name.startswith(BEGIN)), 0.0)
    fingers = (plan.handover.both if plan.handover else grasp).task.finger_names
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
                pose=pose_rows(found.poses),
                q=np.zeros((len(found.poses), 0)),
            ),
        ),
        contacts=(_contacts(fingers, found.contacts, float(grasp.task.mu)),),
        plots=_plots(fingers, found, plan.path.axis),
        bands=bands,
        start=start,
        views=stage.views(grasp.contacts),
        follow="object",
    )


def _contacts(fingers: Sequence[str], sets: Sequence[ContactSet | None], mu: float) -> Contacts:
    """Contacts over time; NaN for a finger that does not touch."""
    points, normals, forces = np.full((3, len(sets), len(fingers), 3), np.nan)
    rows: dict[int, tuple[list[int], tuple[FloatArray, FloatArray, FloatArray]]] = {}
    for i, one in enumerate(sets):
        if one is None:
            continue
        if id(one) not in rows:
            rows[id(one)] = [fingers.index(f) for f in one.fingers], contact_rows(one)
        at, values = rows[id(one)]
        points[i, at], normals[i, at], forces[i, at] = values
    return Contacts(
        name="planned",
        layer="planned contacts",
        fingers=tuple(fingers),
        points=points,
        normals=normals,
        forces=np.where(np.isnan(forces), 0.0, forces),
        mu=mu,
        actor="object",
    )


def _plots(fingers: Sequence[str], found: ObjectMotion, axis: FloatArray) -> tuple[Plot, ...]:
    normal, used = np.full((2, len(fingers), len(found.contacts)), np.nan)
    for i, one in enumerate(found.contacts):
        if one is not None:
            at = [fingers.index(f) for f in one.fingers]
            normal[at, i] = one.forces[:, 0]
            used[at, i] = 100.0 * one.friction_utilisation()
    turn = Line(name="turn", values=_turned(found.poses, axis))
    plots = (
        Plot(title="Turn of the object", unit="degrees", lines=(turn,)),
        Plot(title="Planned normal force", unit="N", lines=_by_finger(fingers, normal)),
        Plot(title="Planned use of the friction cone", unit="%", lines=_by_finger(fingers, used)),
    )
    if all(knot is None for knot in found.knots):  # the object stays in the fingers
        return plots
    return (
        *plots,
        _of_knots(
            "Normalised min-weight (closure above 0)",
            "",
            found,
            lambda k: k.closure.normalised_min_weight,
        ),
        _of_knots("Smallest clearance", "mm", found, lambda k: 1e3 * k.clearance),
        _of_knots("Object off its path", "mm", found, lambda k: 1e3 * k.off_path),
    )


def _by_finger(fingers: Sequence[str], values: FloatArray) -> tuple[Line, ...]:
    return tuple(
        Line(name=name, values=row, group=name) for name, row in zip(fingers, values, strict=True)
    )


def _turned(poses: Sequence[SE3], axis: FloatArray) -> FloatArray:
    """Turn about an axis (3,), world, since the first pose (m,), degrees."""
    turn = [0.0]
    for pose in poses[1:]:
        turned = pose.rotation @ poses[0].rotation.T
        turn.append(signed_twist(turned, axis, near=turn[-1]))
    degrees: FloatArray = np.rad2deg(np.array(turn))
    return degrees


def _of_knots(title: str, unit: str, found: ObjectMotion, value: Callable[[Knot], float]) -> Plot:
    values = np.array([np.nan if k is None else value(k) for k in found.knots])
    return Plot(title=title, unit=unit, lines=(Line(name="knots", values=values),))


def _summary(plan: MovementPlan, note: str) -> tuple[Block, ...]:
    joint, room, where = plan.joint_room
    rows = [
        ("path", str(plan.path)),
        ("knots", str(len(plan.knots))),
        ("least normalised min-weight", f"{plan.margin:.3f} of at most 1"),
        ("least clearance", f"{1e3 * plan.clearance:.2f} mm"),
        (
            "off the path",
            f"by up to {1e3 * max(k.off_path for k in plan.knots):.2f} mm of "
            f"{1e3 * plan.path_tolerance:.1f} mm",
        ),
        (
            "joint nearest to a limit",
            f"{joint}, {100 * room:.0f} % of its range away, at {100 * where:.0f} % of the path",
        ),
    ]
    rows.append(("most loaded actuator", f"keeps {100 * plan.reserve:.0f} % of its limit"))
    if plan.ending is not None and plan.tool is None and plan.handover is None:
        target = ", ".join(f"{v:.3f}" for v in plan.ending.T_world_target.translation)
        held = plan.ending.release is None
        rows.append(("held at last at" if held else "put down at", f"({target}) m"))
        if plan.then is not None:
            rows.append(("movements that follow", str(len(plan.then.chain))))
        if plan.ending.back:
            rows.append(("turned back before", plan.ending.back))
    blocks: list[Block] = [PlotsHere(), Heading(text="Motion"), Facts(rows=tuple(rows))]
    blocks.append(Heading(text="Pads"))
    blocks.append(_pads(plan))
    if plan.cycles > 1:
        blocks += [Heading(text="Strokes and relocations"), _phases(plan)]
    if plan.limits:
        blocks.append(Heading(text="Longer if these gave way"))
        blocks += [Sentence(text=str(limit)) for limit in plan.limits]
    blocks += [Heading(text="Task"), Facts(rows=task_facts(plan.grasp.task))]
    if note:
        blocks.append(Sentence(text=note))
    return tuple(blocks)


def _pads(motion: MovementPlan) -> Table:
    fingers = motion.grasp.task.finger_names
    rows = tuple(
        (name, f"{1e3 * slid:.2f}", f"{np.rad2deg(turned):.1f}")
        for name, slid, turned in zip(fingers, motion.slipped, motion.pivoted, strict=True)
    )
    return Table(columns=("finger", "slides (mm)", "pivots (degrees)"), rows=rows, fingers=True)


def _phases(gait: MovementPlan) -> Table:
    rows = tuple(str(phase).partition(": ")[::2] for phase in gait.phases)
    return Table(columns=("phase", "what happens"), rows=rows)


@dataclass(frozen=True, kw_only=True, eq=False)
class ObjectMotion:
    """The object along a trajectory of m samples.

    Attributes:
        poses: T_world_object, m poses.
        contacts: In the object's frame; None while the hand does not hold it.
        knots: The nearest knot of a stroke; None elsewhere.
    """

    poses: tuple[SE3, ...]
    contacts: tuple[ContactSet | None, ...]
    knots: tuple[Knot | None, ...]


def object_motion(plan: MovementPlan, trajectory: JointTrajectory) -> ObjectMotion:
    """Follow the object along ``plan.joint_trajectory(...)``."""
    follower = _Follower(plan)
    first = 0
    for phase, members in groupby(trajectory.phases):
        count = len(list(members))
        follower.phase(phase, trajectory.T_world_base[first : first + count])
        first += count
    return ObjectMotion(
        poses=tuple(follower.poses),
        contacts=tuple(follower.contacts),
        knots=tuple(follower.knots),
    )


class _Follower:
    def __init__(self, plan: MovementPlan) -> None:
        self.motion, self.strokes = plan, plan.strokes
        self.relocations = list(plan.relocations)
        self.end = plan.final_parameter
        self.taken: ContactSet | None = None  # once another hand has it
        self.T_base_world = self.motion.T_world_base.inverse()
        self.held = self.motion.grasp.contacts_in_object
        self.T_base_object = self.T_base_world * self.motion.grasp.task.T_world_object
        self.poses: list[SE3] = []
        self.contacts: list[ContactSet | None] = []
        self.knots: list[Knot | None] = []

    def phase(self, name: str, bases: Sequence[SE3]) -> None:
        """Append the samples of a phase."""
        kind, _, which = name.partition(" ")
        if kind in ("turn", "back", "stroke"):
            cycle = int(which) - 1 if kind == "stroke" else 0
            self._stroke(bases, cycle, backwards=kind == "back")
        elif kind == "regrasp":
            relocation = self.relocations.pop(0)
            self.T_base_object = self.T_base_world * relocation.T_world_object
            to_object = relocation.T_world_object.inverse()
            self._carried(bases, relocation.during.transformed(to_object))
            self.held = relocation.after.transformed(to_object)
        elif kind in ("approach", "close"):
            self._standing(self.motion.grasp.task.T_world_object, len(bases))
        elif kind in ("open", "retreat") and self.taken is None:
            self._standing(self.poses[-1], len(bases))
        else:  # lift, carry, lower, the use of a tool, what two hands do
            self._carried(bases, self.held)
            if kind == "take" and self.motion.handover is not None:
                self.held = self.taken = self.motion.handover.take.contacts_in_object

    def _standing(self, pose: SE3, count: int) -> None:
        self.poses += [pose] * count
        self.contacts += [None] * count
        self.knots += [None] * count

    def _carried(self, bases: Sequence[SE3], contacts: ContactSet) -> None:
        self.poses += [base * self.T_base_object for base in bases]
        self.contacts += [contacts] * len(bases)
        self.knots += [None] * len(bases)

    def _stroke(self, bases: Sequence[SE3], cycle: int, *, backwards: bool) -> None:
        knots = self.strokes[cycle].knots
        is_last = cycle + 1 == len(self.strokes)
        shares = minimum_jerk(np.linspace(0.0, 1.0, len(bases) + 1)[1:])
        shares = (1.0 - shares if backwards else shares) * (self.end if is_last else 1.0)
        for base, share in zip(bases, shares.tolist(), strict=True):
            pose, knot = _between(knots, share)
            self.T_base_object = self.T_base_world * pose
            self.held = knot.contacts_in_object
            self.poses.append(base * self.T_base_object)
            self.contacts.append(self.held)
            self.knots.append(knot)


def _between(knots: Sequence[Knot], share: float) -> tuple[SE3, Knot]:
    """The object at a path parameter, along the screw between knots, and the nearest knot."""
    at = np.array([k.path_parameter for k in knots])
    i = int(np.clip(np.searchsorted(at, share, side="right") - 1, 0, len(at) - 2))
    part = float(np.clip((share - at[i]) / (at[i + 1] - at[i]), 0.0, 1.0))
    pose = SE3.Interpolate(knots[i].T_world_object, knots[i + 1].T_world_object, part)
    return pose, knots[i + (part > 0.5)]
