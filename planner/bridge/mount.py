"""Putting a hand on an arm: two ``mujoco.MjSpec`` become one.

The arm's names get the prefix ``arm/``; the hand's stay, so that its description holds for the
whole.
"""

from __future__ import annotations

import warnings
from typing import Any

import mujoco
import numpy as np

from planner.bridge.load import compile_spec
from planner.bridge.prepare import name_parts
from planner.errors import ModelError, NotFoundError
from planner.spatial import SE3, pose_from_wxyz, pose_to_wxyz

ARM_PREFIX = "arm/"
"""Prefix of every name of the arm's model in a hand that it carries."""


def mount_spec(arm: Any, hand: Any, *, site: str, T_site_base: SE3, what: str) -> tuple[Any, str]:
    """A spec of an arm that carries a hand, and the name of its root body.

    Args:
        arm: ``mujoco.MjSpec`` of the arm, with one root body.
        hand: ``mujoco.MjSpec`` of the hand; attached, so give a fresh one.
        site: Site of the arm that the hand is put on.
        T_site_base: Where the hand's base is in that site.
        what: What the arm is called in messages.

    Raises:
        NotFoundError: The arm has no such site.
        ModelError: The arm has no root body or several, or MuJoCo refuses the whole.
    """
    roots = [body.name for body in arm.worldbody.bodies]
    if len(roots) != 1 or len(arm.worldbody.geoms):
        raise ModelError(
            f"{what} has the bodies {roots} and {len(arm.worldbody.geoms)} geoms in its world; an "
            "arm is one tree of bodies: remove the rest, or put it into the tree"
        )
    name_parts(arm)
    model = compile_spec(arm, what)
    sites = [model.site(i).name for i in range(model.nsite)]
    if site not in sites:
        raise NotFoundError(f"site of {what}", site, sites, "A hand is attached to a site.")
    number = model.site(site).id
    T_body_site = pose_from_wxyz(model.site_pos[number], model.site_quat[number])
    position, quaternion = pose_to_wxyz(T_body_site * T_site_base)
    _exclude_root(arm, model)
    out = mujoco.MjSpec()
    out.attach(arm, prefix=ARM_PREFIX, frame=out.worldbody.add_frame())
    carrier = out.site(ARM_PREFIX + site).parent
    frame = carrier.add_frame(pos=np.array(position), quat=np.array(quaternion))
    # MuJoCo warns that names without prefix are lost in a saved file; none is written
    out.attach(hand, prefix="", frame=frame)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Attaching a spec with an empty prefix")
        compile_spec(out, f"{what} with its hand")
    return out.copy(), ARM_PREFIX + roots[0]


def _exclude_root(arm: Any, model: Any) -> None:
    """Let the root and what its joints carry touch, as parent and child may everywhere else.

    MuJoCo lets them collide where the parent is fixed to the world, as the root of an arm is.
    """
    names = [model.body(i).name for i in range(model.nbody)]
    static = [i for i in range(1, model.nbody) if model.body_weldid[i] == 0]
    excluded = {frozenset((e.bodyname1, e.bodyname2)) for e in arm.excludes}
    for i in range(1, model.nbody):
        if model.body_weldid[i] == 0 or model.body_weldid[model.body_parentid[i]] != 0:
            continue
        for j in static:
            if frozenset((names[i], names[j])) not in excluded:
                arm.add_exclude(bodyname1=names[j], bodyname2=names[i])
