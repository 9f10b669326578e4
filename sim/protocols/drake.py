"""``drake``: the exported scene held in another physics engine, by position commands alone.

The plan is exported (``sim.scene_export``) and begins in Drake at the grasp with the squeeze
commanded (``sim.second_engine``): for 2 s under the plan's gravity; then six times more, with a
force of half of the object's weight from another side in the second half. Commands do not react to
anything. Contact model, solver, modulus and dissipation are Drake's defaults; friction is
that of ``--physics``. An object is lost that moves more than 10 mm or 15 degrees.

What happens before the grasp is left out: it is a second opinion on the grasp, not on its way.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from planner.exchange.dexgraspbench.export import without_servos
from planner.hands.hand import Hand
from planner.plan import GraspPlan
from planner.quality import closure_and_epsilon, force_closure
from planner.spatial import contact_frames
from planner.tolerances import CLOSURE_EDGES
from sim.contacts import ContactRows
from sim.protocols.cases import AXES, Conditions, axis_of
from sim.protocols.outcome import Outcome
from sim.recording import Samples
from sim.scene import HAND_PREFIX
from sim.scene_export import export_scene
from sim.second_engine import INSTALL, TIME_STEP, Held, hold_in_drake
from sim.verdict import Fault

PUSH_SHARE = 0.5
"""Push over the object's weight under 9.81 m/s2 (-): the planned forces carry the weight with a
margin of 20 % in friction, and nothing closes the fingers further."""

STANDARD_GRAVITY = 9.81
"""m/s2."""


@dataclass(frozen=True, kw_only=True)
class DrakeCase:
    """A hold, or a hold with a push.

    Attributes:
        index: 0 for the hold; else one more than the number of the direction in ``AXES``.
    """

    index: int

    @property
    def name(self) -> str:
        """What it is called."""
        return f"push {AXES[self.index - 1]}" if self.index else "hold"

    def run(self, plan: GraspPlan, conditions: Conditions) -> Outcome:
        """Export and hold it; the controller is left out."""
        weight = plan.task.object.mass * STANDARD_GRAVITY
        force = PUSH_SHARE * weight * axis_of(self.index - 1) if self.index else np.zeros(3)
        with tempfile.TemporaryDirectory() as made:
            folder = Path(made) / "scene"
            export_scene(plan, folder, physics=conditions.physics)
            wrench = np.append(force, np.zeros(3))
            seen = hold_in_drake(folder, wrench=wrench if self.index else None)
        size = float(np.linalg.norm(force))
        pushed = seen.time > seen.pushed_from
        return Outcome(
            index=self.index,
            name=self.name,
            held=seen.held,
            fault=None if seen.held else _fault(seen),
            fingers=plan.task.finger_names,
            samples=_samples(plan, seen, conditions.physics.mu),
            load=np.where(pushed, size, 0.0),
            unit="N" if self.index else "",
            wrench=wrench / size if self.index else np.zeros(6),
        )


def drake_cases() -> tuple[DrakeCase, ...]:
    """The hold and six pushes."""
    return tuple(DrakeCase(index=i) for i in range(1 + len(AXES)))


def unsuitable_for_drake(hand: Hand) -> str:
    """Why a hand cannot be tested by this protocol; "" if it can."""
    if reason := without_servos(hand):
        return f"protocol drake commands positions, and {reason}; use the protocol forces"
    return ""


def drake_physics(mu: float) -> dict[str, Any]:
    """How Drake computes, as a report states it."""
    return {
        "name": "Drake's defaults",
        "engine": "Drake",
        "timestep_s": TIME_STEP,
        "friction": mu,
        "contacts": "compliant hydroelastic patches",
        "servos": "implicit",
        "install": INSTALL,
    }


def _fault(seen: Held) -> Fault:
    last = len(seen.time) - 1
    touching = bool((seen.touches.moment == last).any())
    return Fault(
        reason="slipped" if touching else "dropped",
        detail=f"in Drake, {seen.detail}",
        time=float(seen.time[-1]),
    )


def _samples(plan: GraspPlan, seen: Held, mu: float) -> Samples:
    """What Drake did, judged by the code that judges every trial."""
    task = plan.task
    rows = _rows(plan, seen, mu)
    counts, merged = rows.counts(), rows.merged
    m, n = len(seen.time), len(task.finger_names)
    own = [rows.names.index(finger) for finger in task.finger_names]
    where = merged.moment, merged.finger
    normal, used = np.zeros((m, len(rows.names))), np.full((m, len(rows.names)), np.nan)
    normal[where] = merged.forces[:, 0]
    used[where] = merged.friction_utilisation()
    length = task.object.shape.bounding_radius
    both = [closure_and_epsilon(merged.at(k), length=length) for k in range(m)]
    columns: dict[str, Any] = {
        "time": seen.time,
        "phase": ["hold"] * m,
        "contacts": counts[:, own],
        "palm_contacts": np.delete(counts, own, axis=1).sum(axis=1),
        "normal_force": normal[:, own],
        "friction_utilisation": used[:, own],
        "closed": [closed for closed, _ in both],
        "closed_unmerged": [force_closure(rows.at(k), CLOSURE_EDGES).closed for k in range(m)],
        "epsilon": [epsilon for _, epsilon in both],
        # the hand's base stands still: movement in the world is movement in the hand
        "slip_mm": seen.moved_mm,
        "slip_deg": seen.turned_deg,
        "moved_mm": seen.moved_mm,
        "turned_deg": seen.turned_deg,
        "lift_mm": seen.rise_mm,
        "collision_N": np.full(m, np.nan),
        "collision": [""] * m,
        "saturated": [()] * m,
    }
    return Samples.of(columns, n)


def _rows(plan: GraspPlan, seen: Held, mu: float) -> ContactRows:
    """Drake's patches as point contacts at their centroids."""
    hand, touches = plan.task.hand, seen.touches
    names = (*hand.fingers, "")
    finger_of: dict[str, str] = dict(hand.finger_of_body)
    bodies = [body.removeprefix(HAND_PREFIX) for body in touches.bodies]
    frames = contact_frames(touches.normals)
    forces = np.zeros((len(bodies), 4))
    forces[:, :3] = np.einsum("nji,nj->ni", frames, touches.forces)
    return ContactRows(
        names=names,
        centers=seen.centers,
        moment=touches.moment,
        finger=np.array([names.index(finger_of.get(b, "")) for b in bodies], dtype=np.int64),
        positions=touches.positions,
        frames=frames,
        dims=np.full(len(bodies), 3),
        friction=np.tile([mu, 0.0], (len(bodies), 1)),
        forces=forces,
    )
