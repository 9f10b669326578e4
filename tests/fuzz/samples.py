"""Sound inputs that cases are made from: planned once per run."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from shutil import copytree
from typing import Any

from planner import GraspTask, plan_grasp
from planner.batch import plan_grasps
from planner.files import write_manipulation, write_motion, write_plan
from planner.hands.catalog import find_hand
from planner.motion import plan_motion
from planner.motion.manipulation import manipulation_of

HAND = "allegro_hand"


@dataclass(frozen=True)
class Samples:
    """Sound inputs in a folder of their own; read, never changed.

    Attributes:
        folder: Where they are.
    """

    folder: Path

    def make(self) -> None:
        """Write them all."""
        task = GraspTask.create(HAND, "cylinder")
        write_plan(plan_grasp(task, seed=0), self.folder / "plan.json")
        motion = plan_motion(task, angle=0.1, max_attempts=5)
        write_motion(motion, self.folder / "motion.json")
        write_manipulation(manipulation_of(motion), self.folder / "manipulation.json")
        plan_grasps(HAND, ["sphere"], 4, workers=1, out=self.folder / "batch")

    def plan(self) -> Any:
        """A plan as JSON."""
        return json.loads((self.folder / "plan.json").read_text(encoding="utf-8"))

    def motion(self) -> Any:
        """A motion as JSON."""
        return json.loads((self.folder / "motion.json").read_text(encoding="utf-8"))

    def manipulation(self) -> Any:
        """A manipulation as JSON."""
        return json.loads((self.folder / "manipulation.json").read_text(encoding="utf-8"))

    def batch(self, target: Path) -> Path:
        """A copy of a batch."""
        return Path(copytree(self.folder / "batch", target))

    @cached_property
    def description(self) -> str:
        """The text of a shipped hand.toml, its model by its full path."""
        path = find_hand(HAND)
        text = path.read_text(encoding="utf-8")
        lines = [
            f'model = "{path.parent / line.split(chr(34))[1]}"'
            if line.startswith("model")
            else line
            for line in text.splitlines()
        ]
        return "\n".join(lines) + "\n"
