"""The part ``arrays``: random contacts on an array alone, and the errors of their estimates."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np

from benchmarks.statistics import median_of, quantile_of
from planner.hand_loading import load_hand
from planner.spatial import FloatArray
from sim.tactile import ContactEstimator, PadContact, TaxelArray, TaxelLayout, contact_image

FORCES = (0.5, 5.0)
"""Normal forces (N), drawn evenly."""

REACH = 0.7
"""Share of the array, from its middle, in which contacts lie (-)."""

MU, MU_TORSION = 0.6, 0.0005
"""Friction (-, m) of the contacts; a pad of soft rubber resists turning by about 0.5 mm."""

CONTACTS = 500
"""Contacts per row."""


def array_layout(hand: str, spacing: float, **changes: Any) -> TaxelLayout:
    """The array of a hand's first finger with another spacing (m), over the same part of the pad.

    Args:
        hand: Name or path.
        spacing: m.
        **changes: Fields of ``TaxelDescription``.
    """
    finger = load_hand(hand).description.fingers[0]
    pad = finger.pad
    half = math.radians(pad.rolling_half_angle_deg or pad.half_angle_deg)
    count = 2 * max(1, round(pad.radius * half / spacing)) + 1
    layout = TaxelLayout.of(finger)
    array = layout.array.model_copy(
        update={"rows": count, "columns": count, "spacing": spacing, "latency": 0.0, **changes}
    )
    described = finger.model_copy(update={"pad": pad.model_copy(update={"taxels": array})})
    return TaxelLayout.of(described)


def random_contact(layout: TaxelLayout, rng: np.random.Generator) -> PadContact:
    """A contact somewhere on an array, with a force within the friction cone."""
    place = rng.uniform(-REACH, REACH, 2) * [layout.u[-1], layout.v[-1]]
    frame = layout.frame_at(place)
    force, used, angle = rng.uniform(*FORCES), rng.uniform(0.0, 1.0), rng.uniform(0.0, 2 * np.pi)
    shear = used * MU * force * (np.cos(angle) * frame[:, 1] + np.sin(angle) * frame[:, 2])
    return PadContact(
        point=layout.point(place),
        normal=frame[:, 0],
        normal_force=force,
        shear=np.asarray(shear),
        torsion=float(rng.uniform(-1.0, 1.0)) * MU_TORSION * force,
        used=used,
    )


def array_row(hand: str, seed: int) -> dict[str, Any]:
    """Errors and times for several spacings and noises, and with dead taxels; all on one hand."""
    cells = []
    for spacing in (0.001, 0.002, 0.003, 0.004):
        for noise in (0.0, 0.05, 0.1):
            layout = array_layout(hand, spacing, noise=noise)
            cells.append(_errors(layout, np.random.default_rng(seed)))
    rng = np.random.default_rng([seed, 1])
    whole = array_layout(hand, 0.002)
    count = whole.array.rows
    dead = rng.choice(count * count, size=round(0.05 * count * count), replace=False)
    broken = tuple((int(k) // count, int(k) % count) for k in dead)
    cells.append(_errors(array_layout(hand, 0.002, dead=broken), np.random.default_rng(seed)))
    return {"cells": cells}


def _errors(layout: TaxelLayout, rng: np.random.Generator) -> dict[str, Any]:
    array, estimator = TaxelArray(layout, rng), ContactEstimator(layout)
    errors: dict[str, list[float]] = {
        name: [] for name in ("place_mm", "normal_deg", "force", "shear", "torsion_N_mm")
    }
    spent = np.zeros(3)
    for _ in range(CONTACTS):
        contact = random_contact(layout, rng)
        t0 = time.process_time()
        exact = contact_image(layout, contact)
        t1 = time.process_time()
        image = array.measured(exact)
        t2 = time.process_time()
        seen = estimator.estimate(image)
        spent += t1 - t0, t2 - t1, time.process_time() - t2
        shear = seen.force - seen.normal_force * seen.normal
        errors["place_mm"].append(1e3 * _size(seen.point - contact.point))
        cosine = float(np.clip(seen.normal @ contact.normal, -1.0, 1.0))
        errors["normal_deg"].append(math.degrees(math.acos(cosine)))
        errors["force"].append(abs(seen.normal_force / contact.normal_force - 1.0))
        errors["shear"].append(_size(shear - contact.shear) / contact.normal_force)
        errors["torsion_N_mm"].append(1e3 * abs(seen.torsion - contact.torsion))
    return {
        "spacing_mm": 1e3 * layout.array.spacing,
        "noise": layout.array.noise,
        "dead": len(layout.array.dead),
        "taxels": layout.array.rows * layout.array.columns,
        "contacts": CONTACTS,
        **{name: median_of(values) for name, values in errors.items()},
        **{f"{name}_p95": quantile_of(values, 0.95) for name, values in errors.items()},
        "image_us": 1e6 * spent[0] / CONTACTS,
        "noise_us": 1e6 * spent[1] / CONTACTS,
        "estimate_us": 1e6 * spent[2] / CONTACTS,
    }


def _size(vector: FloatArray) -> float:
    return float(np.linalg.norm(vector))
