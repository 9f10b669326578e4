"""A scratch environment and a checkout of DexGraspBench, in one folder that can be thrown away."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from planner.errors import FileFormatError, TaskError

COMMIT = "1e7a5a6"
"""Of https://github.com/JYChen18/DexGraspBench, 2025-06-05."""

HANDS = ("shadow", "allegro", "leap")
"""Hands of the benchmark without an arm: ``assets/hand/NAME/right_hand.xml``."""

MESHES = ("shadow_hand", "wonik_allegro", "leap_hand")
"""Folders of MuJoCo Menagerie that the files of these hands name."""

REQUIREMENTS = (
    "mujoco==3.3.2",
    "numpy==1.26.4",
    "scipy>=1.14,<1.16",
    "trimesh",
    "hydra-core",
    "transforms3d",
    "matplotlib",
    "scikit-learn",
    "imageio",
    "qpsolvers[clarabel]",
)
"""What the benchmark's README installs, without what its evaluation does not use (see
``dexgraspbench_launch.ABSENT``). The two versions are its own; its scipy is the newest for that
numpy, and 1.14 is the first with the ``scalar_first`` that it uses."""

LAUNCH = Path(__file__).with_name("dexgraspbench_launch.py")
"""Script for the environment's Python."""

LAST_LINES = 15
"""Lines of a failed command's output that the error repeats."""


@dataclass(frozen=True, kw_only=True)
class Installed:
    """The benchmark, ready to run.

    Attributes:
        python: Of its environment.
        checkout: Its files.
        lacking: Hands whose meshes are not there.
    """

    python: Path
    checkout: Path
    lacking: tuple[str, ...]

    def hand_file(self, hand: str) -> Path:
        """The benchmark's own file of one of ``HANDS``."""
        return self.checkout / "assets" / "hand" / hand / "right_hand.xml"

    def evaluate(self, arguments: Sequence[str]) -> None:
        """Run ``src/main.py`` with arguments.

        Raises:
            TaskError: It fails.
        """
        command(self._launch("run", str(self.checkout), *arguments), "DexGraspBench")

    def results(self, folder: Path) -> list[dict[str, Any]]:
        """What it found, one row per grasp: ``file`` and its numbers."""
        text = command(self._launch("read", str(folder)), "reading results of DexGraspBench")
        return [json.loads(line) for line in text.splitlines()]

    def opened(self, model: Path) -> dict[str, Any]:
        """Version of MuJoCo there, and nq and nu of a model that it compiles.

        Raises:
            TaskError: It refuses the model.
        """
        out: dict[str, Any] = json.loads(
            command(self._launch("open", str(model)), f"opening {model}")
        )
        return out

    def _launch(self, *arguments: str) -> list[str]:
        # isolated: no module of the current folder is imported
        return [str(self.python), "-I", str(LAUNCH), *arguments]


def install(home: Path, benchmark: str, meshes: str | None) -> Installed:
    """Make what is not there yet: ``HOME/env``, ``HOME/checkout`` at ``COMMIT``, the meshes.

    Args:
        home: Folder for all of it.
        benchmark: Path or URL of a git repository with the benchmark.
        meshes: Path or URL of MuJoCo Menagerie, or a folder laid out as it is; None if no hand of
            the benchmark is used, or they are there.

    Raises:
        TaskError: git, pip or a download fails; says what they said.
        FileFormatError: The folder cannot be written.
    """
    home = home.resolve()
    checkout, third = home / "checkout", home / "checkout" / "third_party" / "mujoco_menagerie"
    try:
        home.mkdir(parents=True, exist_ok=True)
        python = _environment(home / "env")
        if not (checkout / "src" / "main.py").exists():
            shutil.rmtree(checkout, ignore_errors=True)
            _clone(benchmark, checkout)
        command(["git", "-C", str(checkout), "checkout", "-q", "--detach", COMMIT], "git checkout")
        changed = ["git", "-C", str(checkout), "status", "--porcelain", "--", "src", "config"]
        if text := command(changed, "git status"):
            raise TaskError(
                f"{checkout} was changed: {' '.join(text.split())}; remove that folder, and the "
                "benchmark is fetched anew"
            )
        if meshes is not None and _lacking(third):
            source = Path(meshes)
            if not source.is_dir():
                source = home / "menagerie"
                shutil.rmtree(source, ignore_errors=True)
                _clone(meshes, source, "--depth", "1")
            for name in MESHES:
                if (source / name).is_dir():
                    shutil.copytree(source / name, third / name, dirs_exist_ok=True)
    except OSError as error:
        raise FileFormatError(f"cannot write to {home}: {error.strerror}") from error
    return Installed(python=python, checkout=checkout, lacking=_lacking(third))


def command(words: Sequence[str], what: str) -> str:
    """What a program prints.

    Raises:
        TaskError: It is not there or fails; its last lines are told.
    """
    try:
        done = subprocess.run(words, capture_output=True, text=True, check=False)
    except OSError as error:
        raise TaskError(f"{what}: cannot run {words[0]}: {error.strerror}; install it") from error
    if done.returncode != 0:
        last = "\n".join((done.stdout + done.stderr).strip().splitlines()[-LAST_LINES:])
        raise TaskError(f"{what} failed with code {done.returncode}; the last it said:\n{last}")
    return done.stdout


def _environment(folder: Path) -> Path:
    """Python of a virtual environment with ``REQUIREMENTS``; made anew when they have changed."""
    python, note = folder / "bin" / "python", folder / "requirements.txt"
    wanted = "\n".join(REQUIREMENTS) + "\n"
    if python.exists() and note.exists() and note.read_text(encoding="utf-8") == wanted:
        return python
    shutil.rmtree(folder, ignore_errors=True)
    command([sys.executable, "-m", "venv", str(folder)], "making an environment")
    command([str(python), "-m", "pip", "install", "-q", *REQUIREMENTS], "pip install")
    note.write_text(wanted, encoding="utf-8")
    return python


def _clone(source: str, folder: Path, *options: str) -> None:
    command(["git", "clone", "-q", *options, source, str(folder)], f"git clone {source}")


def _lacking(third: Path) -> tuple[str, ...]:
    """Hands whose meshes are not there."""
    there = [(third / name).is_dir() for name in MESHES]
    return tuple(hand for hand, found in zip(HANDS, there, strict=True) if not found)
