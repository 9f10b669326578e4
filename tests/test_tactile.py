"""Taxels: known answers on paper, properties, and senses of touch in a simulation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from brief import BRIEF
from conftest import PlanOf, calls_in
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from planner.errors import NotFoundError, TaskError
from planner.hand_loading import load_hand
from planner.hands.description_toml import _mirrored_array
from planner.joints.description import FingerDescription, PadDescription, TaxelDescription
from planner.plan import GraspPlan
from planner.spatial import FloatArray
from sim import simulate
from sim.controllers import PHASES, Observation
from sim.scene.carrier import Timeline
from sim.sensing.errors import ErrorModel
from sim.sensing.touch import (
    TOUCH_SENSES,
    ContactEstimator,
    PadContact,
    TaxelArray,
    TaxelFrictionEstimator,
    TaxelLayout,
    TaxelSlipDetector,
    Texture,
    TouchContext,
    contact_image,
    make_sense,
    register_touch,
)
from sim.sensing.touch.exact import CONTACT_MODULUS, contact_deviation, spread
from sim.sensing.touch.senses import ExactSense
from sim.sensing.touch.slip import GainTracker, fit_patches
from sim.simulation import Simulation

pytestmark = pytest.mark.usefixtures("coarse_steps")

RADIUS = 0.012


def layout_of(**changes: Any) -> TaxelLayout:
    array = TaxelDescription(
        **({"rows": 11, "columns": 9, "spacing": 0.002, "noise": 0.0} | changes)
    )
    pad = PadDescription(
        geom="pad",
        center=(0.001, 0.002, 0.02),
        radius=RADIUS,
        axis=(1.0, 0.0, 1.0),
        half_angle_deg=45.0,
        taxels=array,
    )
    return TaxelLayout.of(FingerDescription(name="f", joints=("a",), tip_site="tip", pad=pad))


def press(
    layout: TaxelLayout,
    place: Sequence[float] = (0.0, 0.0),
    force: float = 1.0,
    shear: Sequence[float] | FloatArray = (0.0, 0.0),
    torsion: float = 0.0,
    used: float = 0.5,
) -> PadContact:
    frame = layout.frame_at(np.array(place))
    return PadContact(
        point=layout.point(np.array(place)),
        normal=frame[:, 0],
        normal_force=force,
        shear=shear[0] * frame[:, 1] + shear[1] * frame[:, 2],
        torsion=torsion,
        used=used,
    )


# ---- geometry


def test_neighbours_are_one_spacing_apart_along_the_pad() -> None:
    layout = layout_of()
    middle, beside = layout.positions[5, 4], layout.positions[5, 5]
    chord = 2 * RADIUS * math.sin(0.002 / RADIUS / 2)
    assert np.linalg.norm(beside - middle) == pytest.approx(chord, rel=1e-9)
    above = layout.positions[6, 4] - middle
    assert above @ layout.axes[:, 1] > 0
    assert (beside - middle) @ layout.axes[:, 0] > 0


@given(u=st.floats(-0.015, 0.015), v=st.floats(-0.015, 0.015))
def test_chart_and_point_are_inverse_and_frames_are_rotations(u: float, v: float) -> None:
    layout, place = layout_of(), np.array([u, v])
    assert layout.chart(layout.point(place)) == pytest.approx(place, abs=1e-9)
    frame = layout.frame_at(place)
    assert frame.T @ frame == pytest.approx(np.eye(3), abs=1e-9)
    assert np.linalg.det(frame) == pytest.approx(1.0)
    outward = (layout.point(place) - layout.center) / RADIUS
    assert frame[:, 0] == pytest.approx(outward, abs=1e-9)


# ---- images


def test_a_light_touch_on_the_middle_of_a_taxel_is_felt_by_it_alone() -> None:
    layout = layout_of()
    image = contact_image(layout, press(layout, (0.002, -0.004), force=0.001))
    row, column = 5 - 2, 4 + 1
    assert image[row, column, 0] == pytest.approx(0.001, rel=1e-6)
    image[row, column] = 0.0
    assert np.abs(image).max() < 1e-9


def test_radius_and_spread_of_the_patch_are_hertz() -> None:
    force = 2.0
    patch = (3 * force * RADIUS / (4 * CONTACT_MODULUS)) ** (1 / 3)
    assert contact_deviation(force, RADIUS) == pytest.approx(patch / math.sqrt(5))
    # second moment of Hertz's pressure p (1 - r^2/a^2)^(1/2) on one axis
    r = np.linspace(0.0, patch, 20001)
    p = np.sqrt(np.maximum(1 - (r / patch) ** 2, 0)) * r
    moment = np.trapezoid(p * r**2, r) / np.trapezoid(p, r) / 2
    assert contact_deviation(force, RADIUS) ** 2 == pytest.approx(moment, rel=1e-3)


def test_a_gaussian_lies_within_its_cells() -> None:
    shares = spread(np.array([-1.0, 0.0, 1.0]), 0.0, 1.0)
    assert shares == pytest.approx([0.34134475, 0.34134475], abs=1e-7)


@settings(max_examples=60, deadline=None)
@given(
    u=st.floats(-0.003, 0.003),
    v=st.floats(-0.004, 0.004),
    force=st.floats(0.5, 4.0),
    share=st.floats(0.0, 1.0),
    angle=st.floats(0.0, 6.28),
    twist=st.floats(-1e-3, 1e-3),
)
def test_force_and_torsion_of_a_perfect_array_are_those_of_the_contact(
    u: float, v: float, force: float, share: float, angle: float, twist: float
) -> None:
    layout = layout_of(threshold=0.0)
    shear = 0.6 * share * force * np.array([math.cos(angle), math.sin(angle)])
    contact = press(layout, (u, v), force, shear, twist * force, used=share)
    image = contact_image(layout, contact)
    seen = ContactEstimator(layout).estimate(image)
    total = np.einsum("rcik,rck->i", layout.frames, image)
    assert total == pytest.approx(
        contact.normal_force * contact.normal + contact.shear, abs=2e-3 * force
    )
    assert seen.force == pytest.approx(total, abs=1e-9)
    assert np.linalg.norm(seen.point - contact.point) < 2e-4
    assert seen.normal_force == pytest.approx(force, rel=0.02)
    assert seen.torsion == pytest.approx(twist * force, abs=2e-4 * force)


def test_the_centroid_of_a_symmetric_patch_is_its_middle() -> None:
    layout = layout_of()
    seen = ContactEstimator(layout).estimate(contact_image(layout, press(layout)))
    assert seen.place == pytest.approx([0, 0], abs=1e-12)
    assert seen.normal == pytest.approx(layout.axes[:, 2])


def test_torsion_has_the_sign_of_a_turn_about_the_outward_normal() -> None:
    layout = layout_of()
    image = contact_image(layout, press(layout, torsion=1e-3))
    # at the taxel on the u side, a turn from u to v is a force along v
    assert image[5, 6, 2] > 0 > image[5, 2, 2]
    assert image[7, 4, 1] < 0 < image[3, 4, 1]


def test_what_lies_beside_the_array_is_not_felt() -> None:
    layout = layout_of()
    edge = contact_image(layout, press(layout, (0.009, 0.0)))
    assert edge[..., 0].sum() == pytest.approx(0.5, abs=0.02)  # its border is at 9 mm
    assert contact_image(layout, press(layout, (0.016, 0.0)))[..., 0].sum() < 1e-6


def test_shear_at_full_use_is_spread_like_pressure_and_wider_below() -> None:
    layout = layout_of(spacing=0.0005, rows=41, columns=41)
    spreads = {}
    for used in (0.1, 0.5, 1.0):
        image = contact_image(layout, press(layout, shear=(0.3, 0.0), used=used))
        seen = ContactEstimator(layout).estimate(image)
        cell = 0.0005**2 / 6
        spreads[used] = (seen.shear_spread - cell) / (seen.pressure_spread - cell)
    for used, found in spreads.items():
        assert found == pytest.approx((1 - (1 - used) ** (5 / 3)) / used, abs=0.03)


# ---- imperfections


def test_threshold_noise_and_dead_taxels_act_as_described() -> None:
    layout = layout_of(noise=0.05, threshold=0.02, dead=((5, 4),))
    exact = np.zeros((11, 9, 3))
    exact[..., 0], exact[5, 5, 0], exact[0, 0, 0] = 1.0, 0.01, 0.0
    array = TaxelArray(layout, np.random.default_rng(0))
    images = np.array([array.measured(exact) for _ in range(400)])
    assert not images[:, 5, 4].any() and not images[:, 0, 0].any()
    assert (images[:, 5, 5] == 0).all()  # 10 mN, below the threshold
    assert images[:, 3, 3, 0].std() == pytest.approx(0.05, rel=0.15)
    assert images[:, 3, 3, 0].mean() == pytest.approx(1.0, abs=0.01)


def test_a_dead_taxel_under_the_contact_moves_the_place_by_little() -> None:
    alive, broken = layout_of(), layout_of(dead=((5, 4),))
    contact = press(alive, (0.0007, 0.0003), force=2.0)
    exact = contact_image(alive, contact)
    image = TaxelArray(broken, np.random.default_rng(0)).measured(exact)
    blind = ContactEstimator(alive).estimate(image)
    known = ContactEstimator(broken).estimate(image)
    assert np.linalg.norm(known.point - contact.point) < 1e-3
    assert known.normal_force > blind.normal_force


def test_images_come_late_and_at_their_rate() -> None:
    array = TaxelArray(layout_of(latency=0.01, rate=100.0), np.random.default_rng(0))
    seen = []
    for k in range(21):
        now = 0.002 * k
        image = np.full((11, 9, 3), now + 1.0)
        seen.append(array.read(now, image)[0])
        if seen[-1] == 0.0 and now < 0.01:
            assert not array.read(now, image)[1].any()  # none has arrived yet
    assert seen[5] == 0.0 and seen[9] == 0.0  # taken at 0 s, arrived at 10 ms
    assert seen[10] == pytest.approx(0.01) and seen[20] == pytest.approx(0.03)


def test_a_wrong_array_is_refused_with_what_is_allowed() -> None:
    with pytest.raises(ValidationError, match=r"dead taxel \[11, 0\].*rows from 0 to 10"):
        layout_of(dead=((11, 0),))
    with pytest.raises(ValidationError, match=r"dead taxel \[1, 2\] is named twice"):
        layout_of(dead=((1, 2), (1, 2)))
    with pytest.raises(ValidationError, match="rows"):
        TaxelDescription(rows="9", columns=7, spacing=0.002)  # type: ignore[arg-type]
    with pytest.raises(ValidationError, match="at most 120 are possible; give fewer or closer"):
        layout_of(rows=40)
    with pytest.raises(ValidationError, match="all taxels are dead"):
        TaxelDescription(rows=2, columns=2, spacing=0.002, dead=((0, 0), (0, 1), (1, 0), (1, 1)))
    for field, value in (("noise", 1.0), ("spacing", 0.0), ("latency", -1.0), ("rows", 1)):
        with pytest.raises(ValidationError, match=field):
            layout_of(**{field: value})


def test_a_description_without_taxels_is_written_as_it_was() -> None:
    hand = load_hand("allegro_hand")
    text = hand.description.to_json()
    assert "taxels" not in text
    finger = hand.description.fingers[0]
    array = TaxelLayout.of(finger).array
    assert array.spacing == 0.002 and array.rows == array.columns == 15
    pad = finger.pad.model_copy(update={"taxels": array})
    changed = hand.description.model_copy(
        update={"fingers": (finger.model_copy(update={"pad": pad}), *hand.description.fingers[1:])}
    )
    assert type(changed).from_json(changed.to_json()) == changed


def test_a_mirrored_hand_has_its_dead_taxels_on_the_other_side_of_the_bone() -> None:
    array = TaxelDescription(rows=5, columns=7, spacing=0.002, dead=((1, 0), (2, 3)))
    assert _mirrored_array(array).dead == ((1, 6), (2, 3))


# ---- friction and slip


def test_texture_changes_with_the_slid_distance_only() -> None:
    texture = Texture((5, 5), np.random.default_rng(0), 0.1)
    before = texture.gains.copy()
    texture.slide(0.0)
    assert (texture.gains == before).all()
    texture.slide(1e-3)
    assert np.corrcoef(texture.gains.ravel(), before.ravel())[0, 1] < 0.5


def watched(
    speed: float,
    seconds: float = 1.0,
    noise: float = 0.05,
    share: float = 0.1,
    seed: int = 0,
    roll: float = 0.0,
    ramp: float = 0.0,
) -> float:
    """When a pad that slides from half-time on raises the alarm; its force ramps by so many N/s."""
    rng = np.random.default_rng(seed)
    layout = layout_of(noise=noise, rows=13, columns=13)
    array, estimator = TaxelArray(layout, rng), ContactEstimator(layout)
    texture, slips = Texture(layout.shape, rng, share), TaxelSlipDetector([layout])
    first, steps = math.inf, round(seconds / 0.002)
    for k in range(steps):
        now = 0.002 * k
        if k > steps / 2:
            texture.slide(speed * 0.002)
        place = (-0.002 + roll * now, 0.0005)
        contact = press(layout, place, 2.0 + ramp * now)
        image = array.measured(contact_image(layout, contact, texture.gains))
        slips.step(np.array([now]), [image], [estimator.estimate(image)])
        if slips.slipping[0]:
            first = min(first, now - seconds / 2)
    return first


@pytest.mark.slow
@pytest.mark.parametrize("speed", [0.005, 0.02])
def test_half_of_all_slips_are_noticed_within_10_ms_of_a_tenth_of_a_millimetre(
    speed: float,
) -> None:
    delays = [watched(speed, seconds=0.4, seed=seed) - 1e-4 / speed for seed in range(7)]
    assert np.median(delays) <= 0.015 if speed > 0.01 else np.median(delays) <= 0.01
    assert max(delays) < 0.1


@pytest.mark.slow
def test_a_pad_that_sticks_or_rolls_raises_no_alarm() -> None:
    assert watched(0.0, seconds=4.0) == math.inf
    assert watched(0.0, seconds=1.0, roll=0.004) == math.inf


@pytest.mark.slow
def test_a_force_that_grows_or_shrinks_fast_neither_raises_nor_hides_a_slip() -> None:
    for ramp in (30.0, -3.0):
        assert watched(0.0, seconds=0.6, ramp=ramp) == math.inf
    delays = [watched(0.02, seconds=0.4, ramp=30.0, seed=seed) - 0.005 for seed in range(5)]
    assert np.median(delays) <= 0.015 and max(delays) < 0.1


def test_gains_are_those_of_the_texture_whatever_force_and_place_are() -> None:
    layout = layout_of(noise=0.0, rows=13, columns=13)
    texture = Texture(layout.shape, np.random.default_rng(3), 0.1)
    tracker, estimator = GainTracker(layout), ContactEstimator(layout)

    def look(force: float, u: float) -> dict[int, float]:
        image = contact_image(layout, press(layout, (u, 0.0005), force), texture.gains)
        patch = tracker.patch(image, estimator.estimate(image))
        assert patch is not None
        (change,) = fit_patches([patch])
        assert change is not None
        taxels, gains = tracker.learn(0.002, patch, change)
        return dict(zip(taxels.tolist(), gains.tolist(), strict=True))

    for _ in range(20):
        first = look(2.0, 0.0)
    later = look(3.0, 0.0003)
    assert len(first.keys() & later.keys()) > 6
    for taxel in first.keys() & later.keys():
        assert later[taxel] == pytest.approx(first[taxel], abs=5e-3)
    texture.slide(1e-3)
    moved = look(3.0, 0.0003)
    assert max(abs(moved[k] - later[k]) for k in moved.keys() & later.keys()) > 0.05


def test_pads_fitted_together_are_fitted_as_each_alone() -> None:
    """Arrays of other shapes and spacings, patches of other sizes, one with a wrong first guess."""
    patches = []
    for rows, columns, spacing, force in ((13, 9, 0.002, 3.0), (7, 15, 0.0015, 1.0)):
        layout = layout_of(noise=0.0, rows=rows, columns=columns, spacing=spacing)
        texture = Texture(layout.shape, np.random.default_rng(rows), 0.1)
        image = contact_image(layout, press(layout, (0.0007, -0.001), force), texture.gains)
        patch = GainTracker(layout).patch(image, ContactEstimator(layout).estimate(image))
        assert patch is not None
        patches.append(patch)
    patches.insert(1, replace(patches[0], place=patches[0].place + 0.004))
    together = fit_patches(patches)
    alone = [fit_patches([one])[0] for one in patches]
    assert together[1] is None and alone[1] is None
    for k in (0, 2):
        a, b = together[k], alone[k]
        assert a is not None and b is not None and len(a) > 5
        np.testing.assert_allclose(a, b, atol=1e-9)
    assert fit_patches([]) == []


def test_a_polished_object_is_not_felt_to_slip() -> None:
    assert watched(0.02, share=0.0) == math.inf


@pytest.mark.parametrize("mu", [0.3, 0.6, 1.0])
def test_friction_is_found_from_the_spread_of_shear_before_anything_slips(mu: float) -> None:
    layout = layout_of(noise=0.05, rows=13, columns=13)
    rng = np.random.default_rng(1)
    array, estimator = TaxelArray(layout, rng), ContactEstimator(layout)
    watch = TaxelFrictionEstimator([0.002])
    for _ in range(500):
        contact = press(layout, (0.0, 0.0), 3.0, (0.7 * mu * 3.0, 0.0), used=0.7)
        seen = estimator.estimate(array.measured(contact_image(layout, contact)))
        watch.step(0.002, [seen], np.array([False]))
    assert watch.friction[0] == pytest.approx(mu, rel=0.2)
    assert watch.used[0] == pytest.approx(0.7, abs=0.15)
    # a jerk beyond the friction that is believed uses all of it, and no more
    jerk = press(layout, (0.0, 0.0), 3.0, (2.0 * mu * 3.0, 0.0), used=1.0)
    watch.step(0.002, [estimator.estimate(contact_image(layout, jerk))], np.array([False]))
    assert watch.used[0] == 1.0


def test_what_slips_has_all_of_its_friction_in_use() -> None:
    layout = layout_of()
    watch, estimator = TaxelFrictionEstimator([0.002]), ContactEstimator(layout)
    contact = press(layout, (0.0, 0.0), 2.0, (0.8, 0.0), used=1.0)
    seen = estimator.estimate(contact_image(layout, contact))
    for _ in range(50):
        watch.step(0.002, [seen], np.array([True]))
    assert watch.friction[0] == pytest.approx(0.4, rel=0.08)


# ---- senses in a simulation


MOST_CALLS = 2400
"""Functions of Python and C per reading of four pads; 1612 were counted."""


@pytest.fixture(scope="module")
def plan(plan_of: PlanOf) -> GraspPlan:
    return plan_of("allegro_hand", "box", seed=1)


def run(simulation: Simulation, **seconds: float) -> None:
    for phase in PHASES:
        if phase in seconds:
            for _ in simulation.run(phase, seconds[phase]):
                pass


def held(plan: GraspPlan, touch: str, seconds: float = 0.3) -> tuple[Observation, Observation]:
    """What a sense says while the object is held, and the truth, at the end."""
    simulation = Simulation(plan, error_model=ErrorModel(name="touch", touch=touch, seed=3))
    run(simulation, approach=0.3, close=0.6, squeeze=0.4, settle=seconds)
    truth = simulation.observe("settle", 1.0)
    return simulation.sensed(truth), truth


@pytest.fixture(scope="module")
def felt(plan: GraspPlan) -> tuple[Observation, Observation]:
    """What taxels say while the object is held, and the truth."""
    return held(plan, "taxels")


@pytest.mark.slow
def test_taxels_feel_what_mujoco_computes(felt: tuple[Observation, Observation]) -> None:
    seen, truth = felt
    pads, exact = seen.pads, truth.pads
    assert (exact.normal_force > 0.3).all()
    assert pads.normal_force == pytest.approx(exact.normal_force, rel=0.1)
    assert np.linalg.norm(pads.position - exact.position, axis=1).max() < 1e-3
    assert (np.einsum("ij,ij->i", pads.normal, exact.normal) > math.cos(math.radians(5))).all()
    assert np.linalg.norm(pads.force - exact.force, axis=1).max() < 0.15 * exact.normal_force.max()
    assert seen.normal_forces == pytest.approx(pads.normal_force)
    assert [image.shape for image in seen.touch.images] == [(15, 15, 3)] * 4
    assert truth.touch.images[0][..., 0].sum() == pytest.approx(exact.normal_force[0], rel=0.02)


@pytest.mark.slow
def test_effort_and_binary_say_that_all_fingers_touch_and_roughly_where(plan: GraspPlan) -> None:
    for touch, off_mm in (("effort", 8.0), ("binary", 5.0)):
        seen, truth = held(plan, touch)
        pads, exact = seen.pads, truth.pads
        assert (pads.normal_force > 0).all(), touch
        off = 1e3 * np.linalg.norm(pads.position - exact.position, axis=1)
        assert off.max() < off_mm, touch
        assert not seen.touch.images, touch
        if touch == "effort":
            assert pads.normal_force == pytest.approx(exact.normal_force, rel=0.5)


@pytest.mark.slow
@pytest.mark.parametrize("touch", ["taxels", "effort", "binary"])
@pytest.mark.parametrize("controller", ["feedforward", "impedance"])
def test_every_controller_holds_with_every_sense(
    plan: GraspPlan, touch: str, controller: str
) -> None:
    error_model = ErrorModel(name="t", touch=touch)
    report = simulate(plan, controller=controller, timeline=BRIEF, error_model=error_model)
    assert report.success, report.verdict
    assert report.error_model is not None and report.error_model["touch"] == touch


def touches_in_the_air(plan: GraspPlan, error_model: ErrorModel, told: bool = True) -> int:
    """How often effort feels something before anything is touched."""
    simulation = Simulation(plan, error_model=error_model)
    real = simulation.error_model
    assert real is not None
    if not told:
        context = TouchContext(
            scene=simulation.scene, data=simulation.data, plan=plan, seed=error_model.seed
        )
        real._touch = make_sense("effort", context)
    count = 0
    for phase, seconds in (("approach", 0.4), ("close", 0.4)):
        for _ in simulation.run(phase, seconds):  # type: ignore[arg-type]
            truth = simulation.observe(phase, 0.0)  # type: ignore[arg-type]
            if not truth.normal_forces.any():
                count += int((simulation.sensed(truth).normal_forces > 0.1).sum())
    return count


@pytest.mark.slow
def test_the_friction_of_joints_is_no_touch_for_effort(plan: GraspPlan) -> None:
    stiff = ErrorModel(name="stiff", touch="effort", dry_friction=0.02)
    known, unknown = (touches_in_the_air(plan, stiff, told) for told in (True, False))
    assert known < 0.1 * unknown


@pytest.mark.slow
def test_the_exact_sense_changes_nothing(plan: GraspPlan) -> None:
    assert ErrorModel(name="t", touch="exact").ideal
    ideal, same = (
        simulate(plan, error_model=error_model, timeline=Timeline.quick(lift=0.2, hold=0.2))
        for error_model in (None, ErrorModel(name="t", touch="exact"))
    )
    assert (ideal.samples.normal_force == same.samples.normal_force).all()


@pytest.mark.slow
def test_the_same_seed_gives_the_same_images(
    plan: GraspPlan, felt: tuple[Observation, Observation]
) -> None:
    again, _ = held(plan, "taxels")
    for a, b in zip(felt[0].touch.images, again.touch.images, strict=True):
        assert (a == b).all()


def test_an_unknown_sense_is_refused_with_those_there_are() -> None:
    with pytest.raises(NotFoundError, match="binary"):
        ErrorModel(touch="vision")
    with pytest.raises(TaskError, match="already"):
        register_touch("taxels", ExactSense)
    assert set(TOUCH_SENSES) == {"exact", "taxels", "effort", "binary"}


@pytest.mark.slow
def test_a_reading_of_four_pads_calls_few_functions(plan: GraspPlan) -> None:
    """``python -m benchmarks touch`` times it, in microseconds per step of the simulation."""
    simulation = Simulation(plan, error_model=ErrorModel(name="t", touch="taxels"))
    run(simulation, approach=0.3, close=0.6, squeeze=0.2)
    assert simulation.error_model is not None
    sense, truth = simulation.error_model.touch, simulation.observe("squeeze", 1.0)
    assert sense is not None
    sense.read(truth)  # builds what it keeps
    readings = [replace(truth, time=truth.time + 0.002 * (k + 1)) for k in range(20)]
    calls = calls_in(lambda: [sense.read(one) for one in readings])
    assert calls < 20 * MOST_CALLS, calls / 20
