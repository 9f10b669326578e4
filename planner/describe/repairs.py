"""Repairs of a model: units, inertias, couplings that cannot hold, overlaps."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from planner.bridge import compile_spec, couplings_from_mujoco
from planner.bridge.load import compile_balanced
from planner.bridge.numbers import (
    LEAST_INERTIA,
    LEAST_MASS,
    check_numbers,
    check_sizes,
    impossible_inertias,
    with_least_inertias,
    worst_inertia,
)
from planner.bridge.pinocchio_model import pinocchio_from_mujoco
from planner.bridge.prepare import name_parts, prepare_spec, with_world_body
from planner.bridge.structure import structure_of
from planner.describe.drive import impossible_couplings
from planner.describe.overlaps import TOUCHING, placed_geometries, separate_pairs
from planner.describe.proposal import Notes
from planner.describe.tree import find_base, fingers_in_world
from planner.hands.build import build_from_spec
from planner.hands.hand import Hand
from planner.joints.description import HandDescription, RepairDescription
from planner.shapes.convex_pairs import DistancePair

NARROW_HINGE, WIDE_HINGE = 0.1, 20.0
"""Widest range (rad) of all hinges below which a file was written in radians and read in degrees,
and above which the reverse."""

WORLD_BODY = "world_body"
"""Name of the body that stands for the world, where fingers start from that."""

OVERLAP_SAMPLES = 60
"""Random configurations at which parts are looked at that always overlap."""

ALWAYS, OFTEN, MOSTLY = 0.8, 0.4, 0.6
"""Share of configurations in which two links must overlap to do so by construction; if they do at
rest, where fingers are stretched and nothing folds; and if they are no neighbours but do so."""

NEIGHBOURS = 2
"""Joints between two links up to which they count as neighbours; further ones fold, and overlap by
construction only if they do at rest and mostly, or always."""


def repair_and_base(
    spec: Any, base_body: str | None, what: str, notes: Notes
) -> tuple[RepairDescription, str]:
    """Repairs that the file needs, and the root of the hand in it."""
    raw = spec.copy()
    name_parts(raw)
    check_sizes(raw, what)
    model, balanced = compile_balanced(raw, what)
    structure = structure_of(model)
    angle: Literal["radian", "degree"] | None = None
    ranges = [j.limits[1] - j.limits[0] for j in structure.joints if j.kind == "hinge" and j.limits]
    if ranges and max(ranges) < NARROW_HINGE and raw.compiler.degree:
        angle = "radian"
        notes.because(
            "repair.angle",
            "radian",
            f"read in degrees, no hinge turns more than {np.rad2deg(max(ranges)):.1f} degrees: "
            "the file is written in radians and does not say so",
        )
    elif ranges and max(ranges) > WIDE_HINGE and not raw.compiler.degree:
        angle = "degree"
        notes.because(
            "repair.angle",
            "degree",
            f"read in radians, a hinge turns {max(ranges):.0f} rad: the file is in degrees",
        )
    if balanced:
        notes.because(
            "repair.balance_inertia",
            "true",
            "MuJoCo refuses inertias of this model that no body can have (A + B < C)",
        )
    completed = with_least_inertias(spec)
    if completed:
        notes.ask(
            f"the model gives the links {', '.join(completed)} no mass, or an inertia that no body "
            f"has: {1e6 * LEAST_MASS:g} mg and {LEAST_INERTIA:g} kg m2 stand in for them; give the "
            "true ones in the model"
        )
    world = ""
    if base_body is None and fingers_in_world(structure):
        world = WORLD_BODY
        raw = with_world_body(raw, world)
        structure = structure_of(compile_spec(raw, what))
        notes.because(
            "repair.world_body",
            world,
            "the chains of joints start from the world: all parts fixed to it become their palm",
        )
    base, why, questions = find_base(structure, base_body, what)
    notes.because("base_body", base, why)
    for question in questions:
        notes.ask(question)
    return RepairDescription(angle=angle, balance_inertia=balanced, world_body=world), base


def with_possible_inertias(
    model: Any, description: HandDescription, notes: Notes
) -> HandDescription:
    """A description in which inertias that no link can have are those of the links' geometry."""
    impossible = impossible_inertias(model)
    if not impossible:
        return description
    wrong = tuple(one.body for one in impossible if one.has_solid)
    stay = [one.body for one in impossible if not one.has_solid]
    mended = "the inertia of its geometry stands in for it" if wrong else ""
    kept = f"{', '.join(stay)} without geometry stay as they are" if stay else ""
    notes.ask(
        f"{worst_inertia(impossible)}: {'; '.join(t for t in (mended, kept) if t)}; give the true "
        "ones in the model"
    )
    if not wrong:
        return description
    notes.because(
        "repair.inertia_from_geometry",
        ", ".join(wrong),
        "with the stated inertias these links would hardly move: their radii of gyration exceed "
        "their size",
    )
    return _with_repair(description, inertia_from_geometry=wrong)


def without_impossible_couplings(
    model: Any, description: HandDescription, notes: Notes
) -> HandDescription:
    """A description that drops the couplings which the joint ranges forbid."""
    pin_model = pinocchio_from_mujoco(model)
    wrong = impossible_couplings(
        couplings_from_mujoco(model),
        np.array(pin_model.lowerPositionLimit),
        np.array(pin_model.upperPositionLimit),
    )
    if not wrong:
        return description
    notes.because(
        "repair.drop_couplings",
        ", ".join(wrong),
        "within the joint ranges these couplings cannot hold, or leave the joints that they "
        "tie no room to move",
    )
    notes.ask(
        f"the model's couplings {', '.join(wrong)} contradict its joint ranges and are left "
        'out: give the real ones as [[couplings]] with kind = "equality"'
    )
    return _with_repair(description, drop_couplings=wrong)


def without_overlaps(spec: Any, description: HandDescription, notes: Notes) -> HandDescription:
    """Exclude pairs of bodies that overlap nearly wherever the joints are."""
    hand = build_from_spec(spec, description)
    always = _overlapping(hand)
    if not always:
        return description
    listed = ", ".join(" - ".join(pair) for pair in always)
    notes.because(
        "repair.exclude",
        listed,
        f"they overlap in {100 * ALWAYS:.0f} % of all configurations, or at rest and in "
        f"{100 * OFTEN:.0f} %: neighbours by construction, or hulls of hollow parts",
    )
    return _with_repair(description, exclude=always)


def _with_repair(description: HandDescription, **lines: Any) -> HandDescription:
    """A description with lines of its ``[repair]`` replaced."""
    repair = description.repair.model_copy(update=lines)
    return description.model_copy(update={"repair": repair})


def prepared_model(spec: Any, description: HandDescription, what: str) -> Any:
    """The compiled hand alone, repaired and named as a description asks.

    Raises:
        NotFoundError: The base, or a part to be repaired, is not there.
        ModelError: MuJoCo refuses the hand, or a number in it is none of a hand's.
    """
    spec = prepare_spec(spec.copy(), description, what)
    model = compile_spec(spec, what)
    check_numbers(model, what)
    return model


def _overlapping(hand: Hand) -> tuple[tuple[str, str], ...]:
    """Pairs of bodies with geometries that overlap in nearly all configurations."""
    rng = np.random.default_rng(0)
    samples = rng.uniform(hand.q_lower, hand.q_upper, (OVERLAP_SAMPLES, hand.nq))
    matrix, value = hand.coupling_matrix
    if len(value):  # what follows other joints goes with them
        samples -= (samples @ matrix.T - value) @ np.linalg.pinv(matrix).T
        samples = np.clip(samples, hand.q_lower, hand.q_upper)
    placed = [placed_geometries(hand, q) for q in (hand.neutral, *samples)]
    out: list[tuple[str, str]] = []
    for i, j in separate_pairs(hand):
        a, b = hand.geometries[i], hand.geometries[j]
        pair = DistancePair(a.geometry, b.geometry)
        apart_at_rest = pair.distance(placed[0][i], placed[0][j]) >= TOUCHING
        share = ALWAYS if apart_at_rest else OFTEN
        if _joints_between(hand.pin_model, a.joint_id, b.joint_id) > NEIGHBOURS:
            share = 1.0 if apart_at_rest else MOSTLY
        apart, allowed = 0, int((1 - share) * OVERLAP_SAMPLES)
        for poses in placed[1:]:
            apart += pair.distance(poses[i], poses[j]) >= TOUCHING
            if apart > allowed:
                break
        if apart <= allowed and (a.body, b.body) not in out:
            out.append((a.body, b.body))
    return tuple(out)


def _joints_between(pin_model: Any, first: int, second: int) -> int:
    """Number of joints on the way from one link to another."""
    above = {}
    steps, joint = 0, first
    while True:
        above[joint] = steps
        if joint == 0:
            break
        joint, steps = int(pin_model.parents[joint]), steps + 1
    steps, joint = 0, second
    while joint not in above:
        joint, steps = int(pin_model.parents[joint]), steps + 1
    return steps + above[joint]
