"""MuJoCo's own tactile sensors beside the integration of contacts (``sim.sensing.touch``).

A round pad is pressed on a flat and on a round object with the contacts of our scenes. Looked at by

    tactile     MuJoCo's ``mjSENS_TACTILE``: how deep vertices of a mesh are in the other geom; with
                taxels on the pad's surface, and on a skin 0.5 mm above
    touch_grid  MuJoCo's plugin: contact forces in angular bins
    contacts    ``sim.sensing.touch``, without noise

Pad, spacing and estimate of the place, the centroid of what is read, are the same. Source of what
the first two compute: google-deepmind/mujoco, a7255075, src/engine/engine_sensor.c and
plugin/sensor/touch_grid.cc.
"""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np
import pytest

from planner.joints.description import FingerDescription, PadDescription, TaxelDescription
from planner.spatial import FloatArray
from sim.scene.physics import PhysicsOptions
from sim.sensing.touch import ContactEstimator, PadContact, TaxelLayout, contact_image

RADIUS, SPACING, COUNT = 0.012, 0.002, 13
"""Of the pad, of its taxels (m), and of rows and columns."""

SKIN = 0.0005
"""How far (m) the second mesh of the tactile sensor lies above the pad."""

FORCES = (0.5, 1.0, 2.0, 4.0)
"""N."""

PRESSES, STEPS = 5, 400
"""Random directions per force and object; time steps until the pad rests."""

GRID_FIELD = (120.0, 90.0)
"""Field of view (degrees) of the touch grid, across and up: about that of the array; up, 90 is the
largest there is."""


@pytest.mark.parametrize("other", ["flat", "round"])
def test_contacts_say_where_and_how_hard_and_depths_where_alone(other: str) -> None:
    layout, rng = _layout(), np.random.default_rng(0)
    found: dict[str, list[tuple[float, float]]] = {}
    for force in FORCES:
        for _ in range(PRESSES):
            tilt = rng.uniform(-math.radians(35), math.radians(35), 2)
            for name, (off, read, _) in _press(layout, other, force, tilt).items():
                found.setdefault(name, []).append((off, abs(read / force - 1.0)))
    places = {name: np.array(pairs)[:, 0] for name, pairs in found.items()}
    forces = {name: float(np.median([f for _, f in pairs])) for name, pairs in found.items()}
    # all that is pressed is felt, and to a fraction of a taxel's 2 mm
    assert np.isfinite(places["contacts"]).all()
    assert np.median(places["contacts"]) < 0.1
    assert forces["contacts"] < 0.02
    # depths say nothing of the force, and mostly reach one taxel
    assert math.isnan(forces["tactile"])
    assert np.nanmedian(places["tactile"]) > 0.3
    # the grid's bins are wider than the error of the image's centroid
    assert np.median(places["touch_grid"]) > 2.0 * np.median(places["contacts"])


def _layout() -> TaxelLayout:
    pad = PadDescription(
        geom="pad",
        center=(0.0, 0.0, 0.0),
        radius=RADIUS,
        axis=(0.0, 0.0, -1.0),
        half_angle_deg=60.0,
        taxels=TaxelDescription(rows=COUNT, columns=COUNT, spacing=SPACING, noise=0.0),
    )
    finger = FingerDescription(name="pad", joints=("z",), tip_site="tip", pad=pad)
    return TaxelLayout.of(finger)


def _press(
    layout: TaxelLayout, other: str, force: float, tilt: FloatArray
) -> dict[str, tuple[float, float, int]]:
    """Distance of the place (mm), force (N) and loaded taxels by sensor, at rest."""
    model = _model(layout, other, tilt, force, sensors=("tactile", "skin", "grid"))
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, STEPS)
    mujoco.mj_forward(model, data)
    body = model.body("finger").id
    turn = data.xmat[body].reshape(3, 3)
    if not data.ncon:
        return {}
    load = np.zeros(6)
    mujoco.mj_contactForce(model, data, 0, load)
    contact = data.contact[0]
    sign = 1.0 if contact.geom1 == model.geom("pad").id else -1.0
    true = turn.T @ (contact.pos - data.xpos[body])
    normal = sign * turn.T @ contact.frame[:3]
    out: dict[str, tuple[float, float, int]] = {}
    for name in ("tactile", "skin"):
        depth = data.sensor(name).data[: COUNT * COUNT]
        points = np.array(_vertices(layout, 0.0))
        out[f"tactile, {name}" if name == "skin" else "tactile"] = (
            _off(depth @ points / depth.sum(), true) if depth.sum() > 0 else math.nan,
            math.nan,
            int((depth > 0).sum()),
        )
    grids = data.sensor("grid").data.reshape(-1, COUNT, COUNT)
    total, grid = float(np.linalg.norm(grids.sum(axis=(1, 2)))), grids[0]
    if total > 0:
        middles = (np.arange(COUNT) + 0.5) / COUNT - 0.5
        weight = np.abs(grid) / np.abs(grid).sum()
        across = float(weight.sum(0) @ middles) * math.radians(GRID_FIELD[0])
        up = float(weight.sum(1) @ middles) * math.radians(GRID_FIELD[1])
        seen = _grid_direction(across, up)
        out["touch_grid"] = (_off(RADIUS * seen, true), total, int((grid != 0).sum()))
    image = contact_image(
        layout,
        PadContact(
            point=true,
            normal=normal,
            normal_force=float(load[0]),
            shear=np.zeros(3),
            torsion=0.0,
            used=0.0,
        ),
    )
    seen_by = ContactEstimator(layout).estimate(image)
    felt = int((image[..., 0] > layout.array.threshold).sum())
    out["contacts"] = (_off(seen_by.point, true), seen_by.normal_force, felt)
    return out


def _grid_direction(across: float, up: float) -> FloatArray:
    """Direction (3,) of a bin of the touch grid, which looks along -z: azimuth, then elevation."""
    return np.array(
        [
            math.sin(across) * math.cos(up),
            math.sin(up),
            -math.cos(across) * math.cos(up),
        ]
    )


def _off(point: FloatArray, true: FloatArray) -> float:
    """Distance along the pad between what two points lie below, mm."""
    cosine = point @ true / (np.linalg.norm(point) * np.linalg.norm(true))
    return 1e3 * RADIUS * math.acos(float(np.clip(cosine, -1.0, 1.0)))


def _vertices(layout: TaxelLayout, above: float) -> FloatArray:
    outward = layout.frames[..., 0].reshape(-1, 3)
    return np.asarray((RADIUS + above) * outward)


def _model(
    layout: TaxelLayout, other: str, tilt: FloatArray, force: float, sensors: tuple[str, ...]
) -> Any:
    """A pad on a slide above an object, pressed by a force."""
    physics = PhysicsOptions()
    spec = mujoco.MjSpec()
    physics.apply(spec, np.zeros(3))
    sizes = {"flat": ("box", [0.1, 0.1, 0.02]), "round": ("sphere", [0.03, 0.0, 0.0])}
    kind, size = sizes[other]
    top = -size[2] if kind == "box" else -size[0]
    base = spec.worldbody.add_geom(
        name="object", type=getattr(mujoco.mjtGeom, f"mjGEOM_{kind.upper()}"), size=size
    )
    base.pos = [0.0, 0.0, top]
    press = spec.worldbody.add_body(name="press", pos=[0.0, 0.0, RADIUS + 1e-4])
    press.add_joint(name="z", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1], damping=2.0)
    finger = press.add_body(name="finger")
    half = np.array([math.cos(t / 2) for t in tilt]), np.array([math.sin(t / 2) for t in tilt])
    (c0, c1), (s0, s1) = half
    finger.quat = [c0 * c1, s0 * c1, c0 * s1, s0 * s1]
    pad = finger.add_geom(name="pad", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[RADIUS, 0, 0])
    pad.mass = 0.02
    for geom in (pad, base):
        geom.solref, geom.solimp, geom.friction = physics.solref, physics.solimp, physics.friction
    actuator = spec.add_actuator(name="press", target="z", trntype=mujoco.mjtTrn.mjTRN_JOINT)
    actuator.gainprm[0] = 0.0
    actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    actuator.biasprm[0] = -force
    for name, above in (("tactile", 0.0), ("skin", SKIN)):
        if name in sensors:
            _add_tactile(spec, finger, name, _vertices(layout, above))
    if "grid" in sensors:
        _add_grid(spec, finger)
    return spec.compile()


def _add_tactile(spec: Any, body: Any, name: str, vertices: FloatArray) -> None:
    mesh = spec.add_mesh(name=name, inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL)
    mesh.uservert = vertices.ravel()
    grid = np.arange(COUNT * COUNT).reshape(COUNT, COUNT)
    a, b, c, d = (g.ravel() for g in (grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]))
    mesh.userface = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).ravel()
    geom = body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, mass=0.0)
    geom.contype = geom.conaffinity = 0
    sensor = spec.add_sensor(name=name, type=mujoco.mjtSensor.mjSENS_TACTILE)
    sensor.objtype, sensor.objname = mujoco.mjtObj.mjOBJ_MESH, name
    sensor.reftype, sensor.refname = mujoco.mjtObj.mjOBJ_GEOM, name


def _add_grid(spec: Any, body: Any) -> None:
    spec.activate_plugin("mujoco.sensor.touch_grid")
    body.add_site(name="eye")
    sensor = spec.add_sensor(name="grid", type=mujoco.mjtSensor.mjSENS_PLUGIN)
    sensor.objtype, sensor.objname = mujoco.mjtObj.mjOBJ_SITE, "eye"
    sensor.plugin.active = True
    plugin = spec.add_plugin(name="grid", plugin_name="mujoco.sensor.touch_grid")
    plugin.config = {
        "size": f"{COUNT} {COUNT}",
        "fov": f"{GRID_FIELD[0] / 2} {GRID_FIELD[1] / 2}",  # each way
        "gamma": "0",
        "nchannel": "3",
    }
    sensor.plugin.name = "grid"
    sensor.plugin.plugin_name = "mujoco.sensor.touch_grid"
