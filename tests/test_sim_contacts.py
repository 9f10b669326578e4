"""MuJoCo's contacts as contact sets: signs, frames, friction, merging."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest

from planner.contacts import ContactSet
from planner.spatial import FloatArray
from sim.contacts import contacts_from_mujoco, merge_per_finger
from sim.contacts.reading import load_of

GRAVITY = 9.81
MASS = 0.2
PLATE = '<body name="plate" {pose}><geom name="plate" type="box" size=".1 .1 .01" {extra}/></body>'
BLOCK = (
    '<body name="object" pos="0 0 {z}"><freejoint/>'
    f'<geom name="object" type="{{kind}}" size="{{size}}" mass="{MASS}" priority="1" '
    'condim="{condim}" friction=".7 .02 .001" {more}/></body>'
)


def scene(
    bodies: list[str], *, option: str = "", steps: int = 500, twist: FloatArray | None = None
) -> tuple[Any, Any]:
    """Compile bodies in the given order and let them come to rest."""
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option cone="elliptic" impratio="10" noslip_iterations="10" timestep=".002" '
        f"{option}/><worldbody>{''.join(bodies)}</worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    if twist is not None:
        data.xfrc_applied[model.body("object").id] = twist
    for _ in range(steps):
        mujoco.mj_step(model, data)
    return model, data


def read(model: Any, data: Any, **options: Any) -> ContactSet:
    body = model.body("object").id
    fingers = {g: model.geom(g).name for g in range(model.ngeom) if model.geom_bodyid[g] != body}
    return contacts_from_mujoco(model, data, object_body=body, finger_of_geom=fingers, **options)


def block(kind: str = "box", size: str = ".02 .02 .02", z: float = 0.03, **more: Any) -> str:
    options = {"condim": 4, "more": ""} | more
    return BLOCK.format(kind=kind, size=size, z=z, **options)


def tilted(degrees: float) -> str:
    return f'euler="{degrees} 0 0"'


@pytest.mark.parametrize("object_first", [False, True])
def test_plate_carries_the_weight_with_normals_into_the_block(object_first: bool) -> None:
    plate = PLATE.format(pose="", extra="")
    model, data = scene([block(), plate] if object_first else [plate, block()])
    assert (model.geom_bodyid[data.contact.geom[0, 0]] == model.body("object").id) == object_first
    contacts = read(model, data)
    assert len(contacts) == 4
    np.testing.assert_allclose(contacts.normals, np.tile([0, 0, 1], (4, 1)), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(contacts.frames), 1.0)
    weight = MASS * GRAVITY
    np.testing.assert_allclose(contacts.wrench(), [0, 0, weight, 0, 0, 0], atol=1e-3 * weight)


@pytest.mark.parametrize("object_first", [False, True])
def test_friction_on_a_slope_has_the_right_sign(object_first: bool) -> None:
    plate, item = PLATE.format(pose=tilted(15), extra=""), block(z=0.033, more='euler="15 0 0"')
    item = item.replace('pos="0 0 0.033"', 'pos="0 -.0078 .029" euler="15 0 0"').replace(
        'euler="15 0 0"/>', "/>"
    )
    model, data = scene([item, plate] if object_first else [plate, item])
    contacts = read(model, data)
    weight = MASS * GRAVITY
    assert contacts.forces[:, 0].sum() == pytest.approx(weight * np.cos(np.deg2rad(15)), rel=1e-2)
    tangential = contacts.forces_in_axes() - contacts.forces[:, :1] * contacts.normals
    assert tangential.sum(axis=0)[2] == pytest.approx(
        weight * np.sin(np.deg2rad(15)) ** 2, rel=0.03
    )
    np.testing.assert_allclose(contacts.wrench(), [0, 0, weight, 0, 0, 0], atol=0.01 * weight)


def test_wrench_is_what_accelerates_the_object_however_geoms_are_ordered() -> None:
    """Newton and Euler at one instant: G f = [m (a - g); I alpha + w x I w], both orders at once.

    MuJoCo puts the geom of the lower type first: balls come before the ellipsoid, and the
    ellipsoid before boxes, so that one object is geom 2 of some contacts and geom 1 of others.
    """
    rng = np.random.default_rng(3)
    around = [
        '<body pos="-.05 0 .01"><geom name="left" size=".022"/></body>',
        '<body pos=".055 .005 0"><geom name="right" type="box" size=".02 .03 .03"/></body>',
        '<body pos="0 .055 0" euler="10 20 30"><geom type="box" size=".03 .025 .03"/></body>',
        '<body pos="0 -.05 .005"><geom name="down" size=".022"/></body>',
    ]
    item = block("ellipsoid", ".034 .036 .03", 0.0)
    model, data = scene([*around, item], steps=0)
    body = model.body("object").id
    seen = set()
    for _ in range(20):
        mujoco.mj_resetData(model, data)
        data.qpos[3:7] = rng.normal(size=4)
        data.qvel[:] = 0.3 * rng.normal(size=6)
        mujoco.mj_forward(model, data)
        contacts = read(model, data)
        seen |= {bool(model.geom_bodyid[g] == body) for g in data.contact.geom[:, 0]}
        inertia = np.diag(model.body_inertia[body])
        turn = data.ximat[body].reshape(3, 3)
        in_own = turn.T @ data.xmat[body].reshape(3, 3)
        omega, alpha = in_own @ data.qvel[3:], in_own @ data.qacc[3:]
        torque = turn @ (inertia @ alpha + np.cross(omega, inertia @ omega))
        force = MASS * (data.qacc[:3] + np.array([0, 0, GRAVITY]))
        wrench = contacts.wrench()
        np.testing.assert_allclose(wrench[:3], force, atol=1e-6 * max(1, np.abs(force).max()))
        np.testing.assert_allclose(wrench[3:], torque, atol=1e-6 * max(1, np.abs(torque).max()))
        assert (contacts.normals * (contacts.center - contacts.positions)).sum(axis=1).min() > 0
    assert seen == {False, True}


@pytest.mark.parametrize("kind", ["sphere", "box"])
def test_torsional_torque_opposes_the_applied_one(kind: str) -> None:
    torque = 0.01  # N m, below mu_torsion times the weight
    twist = np.array([0, 0, 0, 0, 0, torque])
    item = block(kind, ".02 .02 .02" if kind == "box" else ".02", 0.03)
    finger = '<body><geom name="ball" size=".01"/></body>'
    if kind == "box":  # a ball under a box: the box is geom 2
        hinge = item.replace("<freejoint/>", '<joint type="slide" axis="0 0 1"/><joint/>')
        model, data = scene([finger, hinge], twist=twist, steps=200)
    else:
        model, data = scene([PLATE.format(pose="", extra=""), item], twist=twist, steps=200)
    contacts = read(model, data)
    assert contacts.wrench()[5] == pytest.approx(-torque, rel=0.02)


def test_friction_and_model_are_read_from_the_contact() -> None:
    plate = PLATE.format(pose="", extra='friction="2 .5 .1"')
    for condim, name, mu_torsion in (
        (1, "frictionless", 0.0),
        (3, "point", 0.0),
        (4, "soft", 0.02),
    ):
        contacts = read(*scene([plate, block(condim=condim)], steps=50))
        assert set(contacts.models) == {name}
        np.testing.assert_allclose(contacts.mu, 0.7 if condim > 1 else contacts.mu)
        np.testing.assert_allclose(contacts.mu_torsion, mu_torsion)


def test_contacts_inside_the_margin_count_only_on_request() -> None:
    plate = PLATE.format(pose="", extra="")
    model, data = scene([plate, block(z=0.035, more='margin="0" gap=".01"')], steps=0)
    mujoco.mj_forward(model, data)
    assert data.ncon > 0
    assert len(read(model, data)) == 0
    unloaded = read(model, data, with_unloaded=True)
    assert len(unloaded) == data.ncon
    assert (unloaded.forces == 0).all()


@pytest.mark.parametrize("condim", [1, 3, 4, 6])
def test_loads_of_all_contacts_are_those_that_mujoco_gives_one_by_one(condim: int) -> None:
    plate = PLATE.format(pose=tilted(10), extra='margin=".002"')
    model, data = scene([plate, block(condim=condim)], steps=60)
    assert data.ncon >= 4
    contact, pyramids = data.contact, model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL
    rows = zip(contact.efc_address, contact.dim, contact.friction, strict=True)
    force, loads = np.zeros(6), [load_of(data.efc_force, *row, pyramids) for row in rows]
    for i, load in enumerate(loads):
        mujoco.mj_contactForce(model, data, i, force)
        assert load == pytest.approx(force[:3], abs=1e-15)
    assert max(load[0] for load in loads) > 0.1


def test_no_contacts_make_an_empty_set() -> None:
    model, data = scene([PLATE.format(pose="", extra=""), block(z=0.5)], steps=1)
    contacts = read(model, data)
    assert len(contacts) == 0
    assert len(merge_per_finger(contacts)) == 0


def test_four_contacts_of_a_block_merge_to_its_weight_at_the_middle() -> None:
    model, data = scene([PLATE.format(pose="", extra=""), block()])
    merged = merge_per_finger(read(model, data))
    assert merged.fingers == ("plate",)
    weight = MASS * GRAVITY
    np.testing.assert_allclose(merged.forces[0], [weight, 0, 0, 0], atol=1e-3 * weight)
    np.testing.assert_allclose(merged.positions[0], [0, 0, 0.01], atol=1e-4)
    np.testing.assert_allclose(merged.mu, 0.7)


def test_merging_keeps_force_and_torque_about_the_normal() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        positions = np.c_[rng.uniform(-0.005, 0.005, (6, 2)), np.zeros(6)]
        forces = np.c_[
            rng.uniform(0.1, 2, 6), rng.uniform(-1, 1, (6, 2)), rng.uniform(-0.01, 0.01, 6)
        ]
        single = ContactSet.from_arrays(
            positions,
            np.tile([0, 0, 1.0], (6, 1)),
            model="soft",
            mu_torsion=0.01,
            forces=forces,
            fingers=("a", "b", "a", "b", "b", "a"),
            center=(0.01, 0.02, 0.03),
        )
        merged = merge_per_finger(single)
        assert merged.fingers == ("a", "b")
        np.testing.assert_allclose(merged.wrench(), single.wrench(), atol=1e-9)


def test_merged_normal_leans_to_the_stronger_contact() -> None:
    contacts = ContactSet.from_arrays(
        np.array([[0, 0, 0], [0, 0.01, 0]]),
        [[0, 0, 1], [0, 1, 1]],
        forces=[[3, 0, 0, 0], [1, 0, 0, 0]],
        fingers=("thumb", "thumb"),
    )
    merged = merge_per_finger(contacts)
    leaning = np.rad2deg(np.arccos(merged.normals[0] @ [0, 0, 1]))
    assert leaning == pytest.approx(np.rad2deg(np.arctan2(np.sqrt(0.5), 3 + np.sqrt(0.5))))
    np.testing.assert_allclose(merged.positions[0], [0, 0.0025, 0])
    np.testing.assert_allclose(merged.forces_in_axes()[0], contacts.forces_in_axes().sum(axis=0))
