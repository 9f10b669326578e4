"""Tasks of others in their own process: what ``scenes`` registers, and what each is played through.

A ``Task`` says where in a checkout its scene file is and how it is played once; ``Served`` runs it
in its own environment (``scenes_launch``) and mirrors its state in this MuJoCo, for reading.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

import mujoco

from planner.errors import TaskError
from sim.foreign import ForeignRun
from sim.tables import Row

LAUNCH = Path(__file__).with_name("scenes_launch.py")
"""Script for its environment's Python."""


@dataclass(frozen=True, kw_only=True)
class Task:
    """A task of another project.

    Attributes:
        name: Also the name under which ``scenes_launch`` serves it.
        project: Where it comes from.
        model: Its scene file, in the checkout.
        play: Plays it once; takes the task in its process, the description of its hand, and a seed.
    """

    name: str
    project: str
    model: str
    play: Callable[[Served, Path, int], Row]


class Served:
    """Its task in its own process, mirrored here.

    Attributes:
        model: Its scene in this MuJoCo, for reading.
        data: Its state, after every step.
        told: What it said last.
        steps: Steps made since the reset.
        period: Time that one of them takes, s.
    """

    def __init__(self, task: Task, checkout: Path, python: Path, seed: int) -> None:
        """Start it and reset it.

        Raises:
            TaskError: There is no such file, or it does not start.
        """
        self._project = task.project
        for what, file in (("--scene", checkout / task.model), ("--python", python)):
            if not file.is_file():
                raise TaskError(
                    f"there is no {file}; give {what}: a checkout of {task.project}, and the "
                    "Python of an environment with the versions that it asks for"
                )
        # read first: a scene that does not compile leaves no process behind
        self.model: Any = mujoco.MjModel.from_xml_path(str(checkout / task.model))
        self.data: Any = mujoco.MjData(self.model)
        # isolated: no module of the current folder is imported
        command = [str(python), "-I", str(LAUNCH), task.name, str(checkout), str(seed)]
        pipe = subprocess.PIPE
        self._said = TemporaryFile("w+")  # noqa: SIM115  # as long as the process
        self._process = subprocess.Popen(
            command, stdin=pipe, stdout=pipe, stderr=self._said, text=True
        )
        self.steps = 0
        self._ask({"reset": True})
        self.period: float = self.told["seconds"]

    def step(self, action: Sequence[float]) -> None:
        """One of its steps, with the action that it takes."""
        self._ask({"action": [float(value) for value in action]})
        self.steps += 1

    def _ask(self, line: dict[str, Any]) -> None:
        assert self._process.stdin is not None and self._process.stdout is not None
        try:
            self._process.stdin.write(json.dumps(line) + "\n")
            self._process.stdin.flush()
            answer = self._process.stdout.readline()
        except BrokenPipeError:
            answer = ""
        if not answer:
            self._process.wait()
            self._said.seek(0)
            said = self._said.read().strip().splitlines()
            self.close()
            raise TaskError(f"{self._project} ended: {said[-1] if said else 'without a word'}")
        self.told: dict[str, Any] = json.loads(answer)
        for owner in (self.model, self.data):
            for name, values in self.told.items():
                if isinstance(values, list) and hasattr(owner, name):
                    getattr(owner, name)[:] = values
        self.data.time = self.told["time"]
        mujoco.mj_forward(self.model, self.data)

    def close(self) -> None:
        """End it; again does nothing."""
        if not self._said.closed:
            self._process.communicate()
            self._said.close()


def outcome(run: ForeignRun, *, done: bool, ended: str, steps: int, **more: Any) -> Row:
    """What a case says after its episode: of a nail also how deep it was driven in, mm."""
    (far, turned), record = run.slip, run.plan.record
    return {
        "done": done,
        "ended": "done" if done else ended,
        **more,
        "fingers_left": run.touching(),
        "slip_mm": far,
        "slip_deg": turned,
        "steps": steps,
        "attempts": record.attempts,
        "plan_s": record.cpu_s,
        "fingers": len(run.plan.task.finger_names),
    }
