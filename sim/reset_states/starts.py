"""Starts of holds: candidate i of a cell is a function of the seed, the cell and i alone."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from planner.files import write_json
from planner.files.whole import whole_file
from planner.hands.hand import Hand
from planner.spatial import FloatArray, IntArray
from sim.reset_states.asked import Cell, Draws, G, StatesAsked
from sim.reset_states.scene import SCENE_FILE, HoldScene, load_scene
from sim.reset_states.sources import KINDS

CELL_FILE, SOURCES_FILE = "cell.json", "sources.npz"
"""Files that a worker needs beside the scene; both in the folder ``WORK``."""

WORK = "work"
"""Folder of a cell for what a resumed run needs."""

_COLUMNS = ("q", "position", "quaternion", "rest", "press")


@dataclass(frozen=True, kw_only=True, eq=False)
class Start:
    """The start of a hold.

    Attributes:
        source: Row of the source.
        q: Joints (nq,), rad or m.
        commands: Position commands (nu,), within the actuators' ranges.
        position: Of the object (3,) in the hand's base, m.
        quaternion: Its orientation, w, x, y, z.
        gravity: (3,), m/s2, in the hand's base.
        mass: kg.
        friction: Sliding friction (-).
    """

    source: int
    q: FloatArray
    commands: FloatArray
    position: FloatArray
    quaternion: FloatArray
    gravity: FloatArray
    mass: float
    friction: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Starts:
    """From what the starts of a cell are drawn, and the scene in which they are held.

    Attributes:
        seed: Seed of the states.
        number: Number of the cell.
        draws: The draws.
        mass: Least and greatest mass, kg.
        sources: Columns of the sources by name, a row each.
        lower: (nq,), lower joint limits.
        upper: (nq,), upper joint limits.
        ctrl_range: (nu, 2), ranges of the commands.
        moment: (nu, nq), lengths of the actuators per joint.
        still: (nq,), 0 for joints of the wrist, which are not perturbed, else 1.
        scene: The scene.
    """

    seed: int
    number: int
    draws: Draws
    mass: tuple[float, float]
    sources: dict[str, Any]
    lower: FloatArray
    upper: FloatArray
    ctrl_range: FloatArray
    moment: FloatArray
    still: FloatArray
    scene: HoldScene

    def draw(self, index: int) -> Start:
        """Candidate ``index``."""
        rng = np.random.default_rng([self.seed, self.number, index])
        draws, sources = self.draws, self.sources
        row = int(rng.integers(len(sources["q"])))
        q, rest = sources["q"][row], sources["rest"][row]
        offset = rng.normal(size=len(q)) * draws.joints * self.still
        squeeze = float(np.exp(rng.uniform(*np.log(draws.squeeze))))
        commands = rest + squeeze * (sources["press"][row] - rest) + self.moment @ offset
        turn = rng.normal(size=3) * draws.angle
        place = sources["position"][row] + rng.normal(size=3) * draws.position
        drawn = rng.normal(size=3)  # drawn anyway, so that what follows does not depend on it
        down = drawn if draws.gravity is None else np.array(draws.gravity)
        return Start(
            source=row,
            q=np.clip(q + offset, self.lower, self.upper),
            commands=np.clip(commands, *self.ctrl_range.T),
            position=place,
            quaternion=_turned(sources["quaternion"][row], turn),
            gravity=G * down / np.linalg.norm(down),
            mass=float(rng.uniform(*self.mass)),
            friction=float(rng.uniform(*draws.friction)),
        )

    def put(self, start: Start) -> None:
        """Put a start into the scene."""
        self.scene.draw(start.mass, start.friction, start.gravity)
        self.scene.put(start.q, start.position, start.quaternion, start.commands)


def _turned(quaternion: FloatArray, turn: FloatArray) -> FloatArray:
    """An orientation (w, x, y, z), turned by a rotation vector (3,) in the object's own axes."""
    angle = float(np.linalg.norm(turn))
    w, v = np.cos(angle / 2), np.sinc(angle / (2 * np.pi)) / 2 * turn
    w0, v0 = quaternion[0], quaternion[1:]
    out: FloatArray = np.concatenate([[w0 * w - v0 @ v], w0 * v + w * v0 + np.cross(v0, v)])
    return out


def write_cell(
    asked: StatesAsked, cell: Cell, hand: Hand, sources: list[dict[str, Any]], folder: Path
) -> None:
    """Write what workers need to hold the starts of a cell.

    Args:
        asked: What is asked for.
        cell: The cell.
        hand: The hand.
        sources: Sources as plain data, at least one.
        folder: Folder of the cell; its scene is there.
    """
    still = np.ones(hand.nq)
    still[hand.wrist_index] = 0.0
    low, high = asked.draws.mass or (0.5 * cell.mass, 1.5 * cell.mass)
    data = {
        "seed": asked.seed,
        "number": cell.number,
        "draws": asked.to_dict()["draws"],
        "mass": [low, high],
        "lower": hand.q_lower.tolist(),
        "upper": hand.q_upper.tolist(),
        "ctrl_range": hand.actuation.ctrl_range.tolist(),
        "moment": hand.actuation.moment.tolist(),
        "still": still.tolist(),
        "joint_names": list(hand.joint_names),
        "actuator_names": list(hand.actuation.names),
        "fingers": sorted(hand.finger_of_body.items()),
    }
    columns: dict[str, Any] = {name: np.array([s[name] for s in sources]) for name in _COLUMNS}
    columns["kind"] = np.array([KINDS.index(s["kind"]) for s in sources], dtype=np.int8)
    for name in ("plan", "pose"):
        columns[name] = np.array([s[name] for s in sources], dtype=np.int32)
    with whole_file(folder / WORK / SOURCES_FILE) as stream:
        np.savez(stream, **columns)
    write_json(data, folder / WORK / CELL_FILE)


@lru_cache(maxsize=2)
def load_starts(folder: Path) -> Starts:
    """What ``write_cell`` wrote into the folder of a cell, with its scene; once per process."""
    data = json.loads((folder / WORK / CELL_FILE).read_text(encoding="utf-8"))
    with np.load(folder / WORK / SOURCES_FILE) as file:
        sources = {name: file[name] for name in file.files}
    draws: dict[str, Any] = {
        k: tuple(v) if isinstance(v, list) else v for k, v in data["draws"].items()
    }
    arrays = ("lower", "upper", "ctrl_range", "moment", "still")
    scene = load_scene(
        folder / SCENE_FILE,
        tuple(data["joint_names"]),
        tuple(data["actuator_names"]),
        tuple((body, finger) for body, finger in data["fingers"]),
    )
    return Starts(
        seed=data["seed"],
        number=data["number"],
        draws=Draws(**draws),
        mass=(data["mass"][0], data["mass"][1]),
        sources=sources,
        scene=scene,
        **{name: np.array(data[name], dtype=np.float64) for name in arrays},
    )


def rows_of(sources: dict[str, Any], rows: IntArray) -> dict[str, Any]:
    """What sources (m,) say of where they are from: names of kinds, numbers of plans and poses."""
    kinds = np.array(KINDS)[sources["kind"][rows]]
    return {"kind": kinds, "plan": sources["plan"][rows], "pose": sources["pose"][rows]}
