"""Mesh objects in MuJoCo: mass, contacts with the true surface, resting poses, what collides."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np
import pytest

from planner.bridge.load import HIDDEN_GROUP
from planner.hands.hand import Hand
from planner.objects import GraspObject
from planner.shapes import Mesh
from planner.shapes.made import LBracket, Torus
from planner.shapes.pieces import convex_pieces
from planner.shapes.solid import solid_deviation, solid_geoms
from planner.spatial import SE3
from planner.system.disk_cache import CACHE_VARIABLE
from planner.task import GraspTask
from sim.contacts import other_touches
from sim.scene.build import WORLD_BIT, Scene, build_scene

AWAY = SE3(np.eye(3), np.array([0.6, 0.0, 0.4]))
MADE = (LBracket(), Torus())


@pytest.fixture(autouse=True, scope="module")
def _cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(CACHE_VARIABLE, str(tmp_path_factory.mktemp("cache")))
        convex_pieces.cache_clear()
        yield


def scene_of(hand: Hand, mesh: Mesh, pose: SE3 | None = None, *, table: bool = True) -> Scene:
    item = GraspObject(name=mesh.kind, shape=mesh, mass=0.1)
    height = 0.0 if table else None
    task = GraspTask.create(hand, item, T_world_object=pose, table_height=height)
    return build_scene(task, T_world_base=AWAY)


def rest(scene: Scene, seconds: float) -> Any:
    """Simulate with the hand held away."""
    data = scene.start(scene.task.hand.posture("open"), AWAY)
    gantry = scene.gantry
    assert gantry is not None
    for _ in range(round(seconds / scene.physics.timestep)):
        data.ctrl[gantry.ctrl] = gantry.command(data, np.zeros(6), np.zeros(6))
        mujoco.mj_step(scene.model, data)
    return data


@pytest.mark.slow
@pytest.mark.parametrize("mesh", MADE, ids=lambda m: m.kind)
def test_object_stays_where_it_stands_in_its_stable_poses(allegro: Hand, mesh: Mesh) -> None:
    poses = [p for p in mesh.resting_poses() if (p.margin_deg or 0.0) > 10][:2]
    assert poses
    for pose in poses:
        height = mesh.support(-pose.rotation[2])
        placed = SE3(pose.rotation, np.array([0.0, 0.0, height]))
        scene = scene_of(allegro, mesh, placed)
        data = rest(scene, 0.6)
        now = scene.body_pose(data, scene.object_body)
        moved = np.linalg.norm(now.translation - placed.translation)
        turned = np.arccos(np.clip((np.trace(now.rotation.T @ placed.rotation) - 1) / 2, -1, 1))
        assert moved < 5e-4
        assert np.rad2deg(turned) < 0.6
        touches = other_touches(scene, data)
        assert {(t.first, t.second) for t in touches} == {("object", "table")}
        assert sum(t.normal_force for t in touches) == pytest.approx(0.1 * 9.81, rel=0.05)


@pytest.mark.parametrize("mesh", MADE, ids=lambda m: m.kind)
def test_mass_and_inertia_are_those_of_the_mesh_whatever_the_pieces(
    allegro: Hand, mesh: Mesh
) -> None:
    body = scene_of(allegro, mesh).model.body("object")
    assert body.mass[0] == pytest.approx(0.1)
    np.testing.assert_allclose(
        np.sort(body.inertia), np.linalg.eigvalsh(mesh.inertia(0.1)), rtol=1e-6
    )
    np.testing.assert_allclose(body.ipos, 0.0, atol=1e-12)


@pytest.mark.parametrize("mesh", MADE, ids=lambda m: m.kind)
def test_a_ball_on_the_true_surface_touches_as_it_should(mesh: Mesh) -> None:
    """Contact depth and normal against the exact mesh, where a ball of 8 mm fits."""
    radius, depth = 0.008, 1e-4
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="object")
    body.add_freejoint()
    for k, part in enumerate(solid_geoms(mesh)):
        asset = spec.add_mesh(name=f"piece{k}")
        assert part.vertices is not None
        assert part.faces is not None
        asset.uservert, asset.userface = part.vertices.ravel(), part.faces.ravel()
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"piece{k}")
    probe = spec.worldbody.add_body(name="probe", mocap=True)
    probe.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(radius, 0, 0))
    model = spec.compile()
    data = mujoco.MjData(model)
    points, normals = mesh.surface_samples(150, np.random.default_rng(4))
    centers = points + (radius - depth) * normals
    fits = np.abs(mesh.signed_distance(centers) - (radius - depth)) < 1e-6
    assert fits.sum() > 50
    angles = []
    for center, normal in zip(centers[fits], normals[fits], strict=True):
        data.mocap_pos[0] = center
        mujoco.mj_forward(model, data)
        assert data.ncon > 0
        k = int(np.argmin(data.contact.dist))
        # never less deep than on the true surface, deeper by no more than what pieces reach out
        assert -depth - solid_deviation(mesh) - 1e-5 < data.contact.dist[k] < -depth + 1e-5
        sign = 1.0 if data.contact.geom[k, 0] < model.ngeom - 1 else -1.0
        cosine = abs(sign * data.contact.frame[k][:3] @ normal)
        angles.append(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0))))
    assert np.median(angles) < 2.0
    assert np.quantile(angles, 0.95) < 20.0


def test_pieces_collide_unseen_and_the_true_mesh_is_seen_only(allegro: Hand) -> None:
    scene = scene_of(allegro, LBracket())
    model = scene.model
    of_object = np.flatnonzero(model.geom_bodyid == scene.object_body)
    colliding = [g for g in of_object if model.geom_contype[g] or model.geom_conaffinity[g]]
    assert len(colliding) == 2
    assert {int(model.geom_group[g]) for g in colliding} == {HIDDEN_GROUP}
    (seen,) = set(of_object) - set(colliding)
    shown = int(model.geom_dataid[seen])
    assert model.mesh_facenum[shown] == len(LBracket().faces)
    option = mujoco.MjvOption()
    assert option.geomgroup[model.geom_group[seen]]
    assert not option.geomgroup[HIDDEN_GROUP]
    assert scene.deviation == pytest.approx(0.0, abs=1e-6)


def test_a_mesh_held_out_stays_until_it_is_released(allegro: Hand) -> None:
    pose = SE3(np.eye(3), np.array([0.0, 0.0, 0.5]))
    scene = scene_of(allegro, Torus(), pose, table=False)
    held = rest(scene, 0.3)
    assert held.xpos[scene.object_body, 2] == pytest.approx(0.5, abs=1e-3)
    scene.release(held)
    for _ in range(100):
        mujoco.mj_step(scene.model, held)
    assert held.xpos[scene.object_body, 2] < 0.4


@pytest.mark.parametrize(("contype", "conaffinity"), [(1, 0), (0, 1), (2, 1), (WORLD_BIT, 0)])
def test_links_meet_the_world_and_each_other_as_the_model_says(
    allegro: Hand, contype: int, conaffinity: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    original = Hand.new_spec

    def foreign(self: Hand) -> object:
        spec = original(self)
        for geom in spec.geoms:
            geom.contype, geom.conaffinity = contype, conaffinity
            geom.margin = 0.01
        return spec

    monkeypatch.setattr(Hand, "new_spec", foreign)
    model = scene_of(allegro, LBracket()).model

    def meet(a: int, b: int) -> bool:
        one = model.geom_contype[a] & model.geom_conaffinity[b]
        return bool(one | (model.geom_contype[b] & model.geom_conaffinity[a]))

    links = [model.geom(f"hand/{link.name}").id for link in allegro.geometries]
    looks = {g for g in range(model.ngeom) if model.geom(g).name.startswith("hand/")} - {*links}
    world = [model.geom(n).id for n in ("object", "object/1", "table")]
    assert all(meet(g, w) for g in links for w in world)
    assert all(meet(a, b) for a in world for b in world[2:] if a != b)
    assert {meet(a, b) for a in links[:5] for b in links[5:]} == {bool(contype & conaffinity)}
    assert looks and not any(meet(a, b) for a in looks for b in range(model.ngeom))
    assert (model.geom_margin[links] == 0).all()


def test_options_of_the_hand_model_do_not_matter_and_do_not_warn(
    allegro: Hand, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Warnings are errors in tests; MuJoCo warns where parent and child differ."""
    original = Hand.new_spec

    def foreign(self: Hand) -> object:
        spec = original(self)
        spec.option.iterations, spec.option.timestep, spec.option.tolerance = 20, 0.01, 1e-3
        spec.option.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
        spec.njmax, spec.nconmax, spec.nuser_jnt = 500, 100, 1
        return spec

    monkeypatch.setattr(Hand, "new_spec", foreign)
    scene = scene_of(allegro, LBracket())
    option = scene.model.opt
    assert (option.iterations, option.timestep) == (scene.physics.iterations, 0.002)
    assert option.tolerance == mujoco.MjOption().tolerance
    assert int(option.cone) == int(mujoco.mjtCone.mjCONE_ELLIPTIC)
