"""Why options of ``manipulate`` mean nothing with --goal or --in-palm: what a refusal says of them.

Used by ``sim.cli.manipulate``; a test holds that no option is refused without its reason.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping


def _by_option(reasons: Mapping[str, Collection[str]]) -> dict[str, str]:
    return {option: reason for reason, options in reasons.items() for option in options}


WITH_GOAL = _by_option(
    {
        "--goal is the rotation and --place where it is held; whether wrist, table or fingers turn "
        "it is searched": ("rotate", "shift", "attitude", "gait"),
        "movements are planned over a table at height 0 with nothing else on it": (
            *("at", "table", "stand", "obstacle", "gravity"),
        ),
        "its grasps are kept for all goals: fingertips anywhere on a known object, joints exact": (
            *("touch", "avoid", "type", "mu_torsion", "grip_force", "expect_load"),
            *("joint_error", "cloud_error", "base", "wrist"),
        ),
        "all grasps that are kept are tried": ("max_attempts", "best_of"),
        "give --mass": ("density",),
        "there the object lies in the palm, and --turn-to is the goal": (
            *("in_palm", "turn_to", "tilt"),
        ),
        "what is executed is drawn into --out": ("picture",),
        "--plan-only executes nothing": (
            *("sim_mu", "physics", "error_model", "error_seed", "estimate", "pads", "controller"),
            *("view", "video", "arrows", "max_force"),
        ),
    }
)
"""Parameter -> why it means nothing with --goal."""

IN_PALM = _by_option(
    {
        "--turn-to is the rotation": ("rotate", "shift", "gait", "goal", "put_down"),
        "the object lies in the palm, and there is no table": (
            *("pose", "at", "table", "stand", "obstacle", "place"),
        ),
        "the hand stands still with the palm up, and leans by --tilt": (
            *("attitude", "gravity", "base", "wrist", "goal_tilt", "wrist_tilt"),
        ),
        "palm and all fingers may touch it anywhere": ("touch", "avoid", "fingers", "type"),
        "no contact is planned; --sim-mu is the friction that there is": ("mu", "mu_torsion"),
        "it is not gripped": ("grip_force", "expect_load", "max_force"),
        "pose and joints are known exactly": (
            *("joint_error", "cloud_error", "error_model", "error_seed", "estimate", "pads"),
        ),
        "nothing is planned before": ("plan_only", "max_attempts", "best_of"),
        "contact-implicit control is the only one": ("controller",),
        "give --mass": ("density",),
        "its films show neither": ("view", "arrows"),
    }
)
"""Parameter -> why it means nothing with --in-palm."""
