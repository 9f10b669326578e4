"""What a search for causes looks at: the file as it is written, and both sides' values."""

from __future__ import annotations

import numpy as np

from planner.spatial import SE3
from sim.crosscheck.compare import local_pose
from sim.crosscheck.mjcf_text import MjcfText
from sim.crosscheck.mujoco_side import MujocoSide
from sim.crosscheck.parts import Slot
from sim.crosscheck.pinocchio_side import PinocchioSide
from sim.crosscheck.quantities import Difference
from sim.crosscheck.reader import ReaderResult, is_urdf
from sim.crosscheck.sources import Source
from sim.crosscheck.states import as_drawn

ORIENTATIONS = ("quat", "axisangle", "euler", "xyaxes", "zaxis", "fromto")
"""Attributes of MJCF that turn an element."""

EQUAL = 1e-6
"""Up to which a value, m, rad or relative, is the one that a mistake predicts."""


class Context:
    """A model, what Pinocchio's own reader made of it, and the text of the file.

    ``twins`` keeps what ``evidence_masses`` compiles: mistakes -> bodies touched, their masses.
    """

    def __init__(
        self, source: Source, here: MujocoSide, there: PinocchioSide, result: ReaderResult
    ) -> None:
        """Compute what is asked for again and again.

        Args:
            source: The model, from a file.
            here: The reference.
            there: The reader's model.
            result: What the reader gave.
        """
        self.source, self.model, self.layout = source, source.model, here.layout
        self.result = result
        mjcf = None if source.path is None or is_urdf(source.path) else source.path
        self.text = None if mjcf is None else MjcfText(mjcf)
        self.here, self.there = here.parts(), there.parts()
        drawn = as_drawn(here.layout)
        self._drawn = here.observe(drawn), there.observe(drawn)
        self.twins: dict[tuple[str, ...], tuple[frozenset[str], dict[str, float]]] = {}
        self.slots: dict[str, Slot] = {slot.name: slot for slot in here.layout.joints}

    def local(self, part: str, *, site: bool = False) -> SE3:
        """The reader's pose of a body or site in its parent's frame, as the model is drawn."""
        there = self._drawn[1]
        return local_pose(self.layout, there, there, part, site=site)

    def pose_in(self, root: str, body: str) -> SE3:
        """The reference's pose of a body in a body that it is fixed to."""
        here = self._drawn[0]
        return here.bodies[root].actInv(here.bodies[body])

    def fixed_site(self, site: str) -> tuple[SE3, SE3]:
        """The reader's pose of a site in the moving body that carries it, and the wrong one.

        The wrong one is what comes out where the site's body is placed by its own offset alone,
        as if the body that it is fixed to stood at the moving body's origin.
        """
        here, there = self._drawn
        body = self.layout.sites[site]
        root = self.layout.roots[body]
        pose = there.sites[site]
        carried = pose if root not in there.bodies else there.bodies[root].actInv(pose)
        wrong = local_pose(self.layout, there, here, body) * local_pose(
            self.layout, there, here, site, site=True
        )
        return carried, wrong

    def turned(self, part: str, *, site: bool = False) -> bool:
        """Whether the reader's orientation of a part is that of a rotation at all."""
        rotation = np.asarray(self.local(part, site=site).rotation)
        return bool(np.abs(rotation.T @ rotation - np.eye(3)).max() < EQUAL)

    def body_of(self, difference: Difference) -> str:
        """Body of the joint, site or body that a difference is about; "world" if it has none."""
        part = difference.part
        if difference.quantity.startswith("site"):
            return self.layout.sites.get(part, "world")
        if part in self.slots and difference.quantity.startswith("joint"):
            return self.slots[part].body
        return part if part in self.layout.parents else "world"

    def top(self, body: str) -> str:
        """The ancestor of a body that stands right below the world."""
        while self.layout.parents.get(body, "world") != "world":
            body = self.layout.parents[body]
        return body

    @property
    def first(self) -> str:
        """The first body below the world."""
        return next(iter(self.layout.parents))
