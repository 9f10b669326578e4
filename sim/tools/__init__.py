"""Uses of tools in MuJoCo: what stands in the scene, how the hand goes, and when it has succeeded.

A kind of use is one file and one registration: a subclass of ``Use`` (``sim.tools.use``)::

    from sim.tools import use_tool

    print(use_tool("shadow_hand", "screwdriver").success)
"""

from sim.tools.fingers import FingersTrial, plan_fingers, use_tool
from sim.tools.press import Press
from sim.tools.strike import Strike
from sim.tools.trial import UseTimeline, UseTrial, plan_tool
from sim.tools.turn import Turn
from sim.tools.use import USES, Use, register_use

register_use("turn", Turn)
register_use("strike", Strike)
register_use("press", Press)

__all__ = [
    "USES",
    "FingersTrial",
    "Use",
    "UseTimeline",
    "UseTrial",
    "plan_fingers",
    "plan_tool",
    "register_use",
    "use_tool",
]
