"""``distribute_forces`` and ``ForceLoop`` accept the same problems, with the same forces."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from planner.contacts import ContactSet
from planner.forces import ForceLoop, distribute_forces
from planner.forces.problem import RESIDUAL_TOL
from planner.hand_loading import load_hand
from planner.joints.actuation import Actuation
from planner.spatial import FloatArray

MODELS = ("frictionless", "point", "soft")
NEAR = (1e-2, 1e-3, 1e-4, 1e-5)
"""Shares of the wrench (-) by which problems are this side and that of what can be held."""


CLEAR = 1e-3
"""Share (-) from which what is left over exceeds the tolerance."""


def drawn_contacts(rng: np.random.Generator) -> ContactSet:
    """Two to five contacts on a ball, of any model, some without friction."""
    n = int(rng.integers(2, 6))
    p = rng.normal(size=(n, 3))
    p /= np.linalg.norm(p, axis=1, keepdims=True)
    model: Any = [str(rng.choice(MODELS, p=[0.1, 0.5, 0.4])) for _ in range(n)]
    return ContactSet.from_arrays(
        0.03 * p,
        -p + 0.2 * rng.normal(size=(n, 3)),
        mu=rng.uniform(0.3, 1.0, n) * (rng.random(n) < 0.95),
        mu_torsion=rng.uniform(0.002, 0.01, n),
        model=model,
    )


def drawn_actuation(rng: np.random.Generator, nv: int) -> Actuation:
    """Tendons over any joints, that may repeat each other, with stops that may be active."""
    nu, ns = int(rng.integers(1, nv + 2)), int(rng.integers(0, nv + 3))
    moment = rng.choice([0.0, 0.0, 1.0, 0.5], (nu, nv))
    moment[np.arange(nu), rng.integers(0, nv, nu)] = 1.0
    stops = rng.choice([0.0, 0.0, 1.0, -1.0], (ns, nv))
    stops[np.arange(ns), rng.integers(0, nv, ns)] = 1.0
    limit = rng.uniform(0.02, 0.3, nu)
    return Actuation(
        names=tuple(f"M{i}" for i in range(nu)),
        joint_names=tuple(f"j{i}" for i in range(nv)),
        moment=moment,
        length0=np.zeros(nu),
        gain=np.ones(nu),
        bias=np.zeros((nu, 3)),
        force_range=np.stack([-limit, limit], axis=1),
        ctrl_range=np.tile([-np.inf, np.inf], (nu, 1)),
        stop_rows=stops,
        stop_values=rng.choice([0.0, -1.0, np.inf], ns),
        stop_names=tuple(f"stop {i}" for i in range(ns)),
    )


def drawn_problem(seed: int) -> tuple[ContactSet, dict[str, Any], dict[str, Any]]:
    """Contacts, what a loop is made with, and what both are given at a step."""
    rng = np.random.default_rng(seed)
    contacts = drawn_contacts(rng)
    made: dict[str, Any] = {
        "edges": int(rng.integers(3, 10)),
        "cone": str(rng.choice(["inscribed", "circumscribed"])),
        "friction_scale": float(rng.choice([1.0, 0.8])),
        "edge_cost": float(rng.choice([0.0, 3.0])),
        "min_normal": float(rng.choice([0.0, 0.2])),
        "max_normal": float(rng.choice([5.0, np.inf])),
    }
    state: dict[str, Any] = {}
    if rng.random() < 0.7:
        nv = int(rng.integers(2, 7))
        made["actuation"] = drawn_actuation(rng, nv)
        state = {
            "jacobians": 0.05 * rng.normal(size=(len(contacts), 6, nv)),
            "q": np.zeros(nv),
            "gravity_torque": 0.005 * rng.normal(size=nv),
        }
        state["jacobians"] *= rng.random((len(contacts), 1, nv)) < 0.6
    return contacts, made, state


def both(
    contacts: ContactSet,
    wrench: FloatArray,
    made: dict[str, Any],
    state: dict[str, Any],
    tolerance: float = RESIDUAL_TOL,
) -> tuple[bool, bool]:
    """What the loop and the single programme say; forces are compared where both hold."""
    step = ForceLoop(contacts, tolerance=tolerance, **made).step(wrench, **state)
    anew = distribute_forces(contacts, wrench=wrench, **made, **state)
    if step.balanced and anew.found:
        size = max(1.0, float(np.abs(anew.forces).max()))
        np.testing.assert_allclose(step.forces, anew.forces, atol=1e-5 * size)
    return step.balanced, anew.found


@pytest.mark.slow
@settings(max_examples=150, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**31))
def test_both_accept_and_refuse_the_same_problems(seed: int) -> None:
    contacts, made, state = drawn_problem(seed)
    rng = np.random.default_rng([seed, 1])
    wrench = rng.normal(size=6) * [1, 1, 1, 0.01, 0.01, 0.01] * rng.choice([1.0, 4.0])
    looped, once = both(contacts, wrench, made, state)
    assert looped == once


@pytest.mark.slow
@settings(max_examples=60, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**31))
def test_both_agree_next_to_the_largest_wrench_that_can_be_held(seed: int) -> None:
    contacts, made, state = drawn_problem(seed)
    wrench = np.random.default_rng([seed, 1]).normal(size=6) * [1, 1, 1, 0.01, 0.01, 0.01]
    wrench /= np.abs(wrench[:3]).max()
    fraction = distribute_forces(contacts, wrench=30.0 * wrench, **made, **state).fraction
    assume(1e-2 < fraction < 1.0)
    tolerance = RESIDUAL_TOL * min(1.0, 30.0 * fraction)  # below 1 N that of a loop is absolute
    for share in NEAR:
        for sign, held in ((-1, True), (1, False)):
            edge = 30.0 * fraction * (1.0 + sign * share) * wrench
            looped, once = both(contacts, edge, made, state, tolerance)
            assert looped == once, (share, sign)
            # what is left over of a hair too much can be within the tolerance
            assert once == held or (share < CLEAR and not held), (share, sign)


@pytest.mark.parametrize("name", ["shadow_hand", "allegro_hand"])
def test_a_loop_follows_a_real_hand_from_stop_to_stop(name: str) -> None:
    """One loop through postures at joint limits, where stops repeat each other now and then."""
    hand, rng = load_hand(name), np.random.default_rng(0)
    contacts = drawn_contacts(np.random.default_rng(3))
    loop = ForceLoop(contacts, actuation=hand.actuation)
    most = 0
    for _ in range(40):
        share = rng.choice([0.0, 0.5, 1.0], hand.nq)
        state: dict[str, Any] = {
            "q": hand.q_lower + share * (hand.q_upper - hand.q_lower),
            "jacobians": 0.03 * rng.normal(size=(len(contacts), 6, hand.nq)),
            "gravity_torque": 0.01 * rng.normal(size=hand.nq),
        }
        state["jacobians"] *= rng.random((len(contacts), 1, hand.nq)) < 0.2
        wrench = rng.normal(size=6) * [1, 1, 1, 0.01, 0.01, 0.01] * rng.choice([0.3, 3.0])
        step = loop.step(wrench, **state)
        anew = distribute_forces(contacts, wrench=wrench, actuation=hand.actuation, **state)
        assert step.balanced == anew.found
        most = max(most, anew.problem.n_extra)
        if anew.found:
            a = hand.actuation
            made = anew.actuator_forces @ a.moment + anew.stop_forces @ a.stop_rows
            made += a.passive_torque(state["q"])
            joints = anew.problem.joints
            np.testing.assert_allclose(made[joints], anew.joint_torques[joints], atol=1e-6)
            low, high = a.force_limits(state["q"]).T
            moved = (a.moment[:, joints] != 0).any(axis=1)
            assert (anew.actuator_forces >= low - 1e-6)[moved].all()
            assert (anew.actuator_forces <= high + 1e-6)[moved].all()
            assert (anew.stop_forces[(a.stop_rows[:, joints] != 0).any(axis=1)] >= -1e-6).all()
    assert (most > 0) == (name == "shadow_hand")
