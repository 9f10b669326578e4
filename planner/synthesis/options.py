"""Margins and weights of grasp synthesis."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["OPTION_NAMES", "SynthesisOptions"]


@dataclass(frozen=True, kw_only=True)
class SynthesisOptions:
    """Margins and weights of the NLP, and effort; none needs a rebuild.

    Attributes:
        cone_share: Share k of the friction coefficient that the internal force may use (-).
        clear_object: Distance from the object that is asked of the balls in the links (not pads),
            m. Between two balls the true link may be nearer; the verdict is on the true geometry.
        clear_tip: The same for the body that carries a pad, m.
        clear_table: Distance from table and obstacles that is asked of the links, m.
        clear_fingers: Distance asked between two fingers, m.
        weight_tangential: Cost of tangential force (-).
        weight_share: Cost of unequal normal forces (-).
        weight_posture: Cost of leaving the pinch posture, per squared share of joint range (-).
        weight_center: Cost of the mean contact point's squared distance from the centre of mass, in
            characteristic lengths (-): a grasp far from it bears the weight with torsion.
    """

    cone_share: float = 0.7
    clear_object: float = 0.003
    clear_tip: float = 0.0007
    clear_table: float = 0.003
    clear_fingers: float = 0.002
    weight_tangential: float = 1.0
    weight_share: float = 0.1
    weight_posture: float = 0.3
    weight_center: float = 1.0
    rounds: int = 2

    def values(self) -> dict[str, float]:
        """The NLP's parameters by name."""
        return {name: getattr(self, name) for name in OPTION_NAMES}


OPTION_NAMES = tuple(n for n in SynthesisOptions.__dataclass_fields__ if n != "rounds")
"""Names of the options that are parameters of the NLP."""
