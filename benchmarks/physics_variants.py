"""Physics and grips under which ``bench physics`` measures creep."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

from sim.physics import PRESETS, PhysicsOptions

SOFT = PRESETS["mujoco-default"]
"""The physics of which one number is varied."""

ROUND = replace(SOFT, cone="elliptic")


@dataclass(frozen=True, kw_only=True)
class Variant:
    """Physics and grip under which creep is measured.

    Attributes:
        physics: How MuJoCo computes.
        grip: Factor on the least normal forces of the plan (-).
    """

    physics: PhysicsOptions
    grip: float = 1.0


VARIANTS: Mapping[str, Variant] = MappingProxyType(
    {
        "mujoco-default": Variant(physics=SOFT),
        "condim 4": Variant(physics=replace(SOFT, condim=4)),
        "mu 0.6": Variant(physics=replace(SOFT, mu=0.6)),
        "elliptic": Variant(physics=ROUND),
        "impratio 10": Variant(physics=replace(SOFT, impratio=10.0)),
        "elliptic, impratio 10": Variant(physics=replace(ROUND, impratio=10.0)),
        "elliptic, impratio 100": Variant(physics=replace(ROUND, impratio=100.0)),
        "solref 0.01": Variant(physics=replace(SOFT, solref=(0.01, 1.0))),
        "solref 0.005": Variant(physics=replace(SOFT, solref=(0.005, 1.0))),
        "solimp 0.95 0.95": Variant(physics=replace(SOFT, solimp=(0.95, 0.95, 1e-3, 0.5, 2.0))),
        "solimp 0.99 0.99": Variant(physics=replace(SOFT, solimp=(0.99, 0.99, 1e-3, 0.5, 2.0))),
        "solimp 0.999 0.999": Variant(physics=replace(SOFT, solimp=(0.999, 0.999, 1e-3, 0.5, 2))),
        "noslip 1": Variant(physics=replace(SOFT, noslip_iterations=1)),
        "noslip 3": Variant(physics=replace(SOFT, noslip_iterations=3)),
        "noslip 10": Variant(physics=replace(SOFT, noslip_iterations=10)),
        "grip x 1.5": Variant(physics=SOFT, grip=1.5),
        "grip x 2": Variant(physics=SOFT, grip=2.0),
        "elliptic, grip x 2": Variant(physics=ROUND, grip=2.0),
        "menagerie": Variant(physics=PRESETS["menagerie"]),
        "menagerie, grip x 2": Variant(physics=PRESETS["menagerie"], grip=2.0),
        "ours without noslip": Variant(physics=replace(PRESETS["ours"], noslip_iterations=0)),
        "ours": Variant(physics=PRESETS["ours"]),
    }
)
"""By what differs from MuJoCo's defaults."""
