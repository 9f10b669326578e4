"""Models that packages of others download on request and cache.

A name on the command line or in Python is such a request. A name in a plan or batch file is not,
because its writer may be unknown: reading the file uses cached models and fetches nothing.
"""

from __future__ import annotations

import importlib
import importlib.util
from contextlib import nullcontext
from pathlib import Path

from planner.errors import ModelError, NotFoundError
from planner.system.environment import Held

__all__ = ["menagerie_model", "robot_descriptions_model"]

NOT_CACHED = "is not cached, and a file that is read downloads nothing; if you trust the file, run"
"""Message about a model that a file names and that is not cached."""

_no_transport = Held("GIT_ALLOW_PROTOCOL", "none")
"""While it is held, git neither clones nor fetches, by any protocol, but reads local files."""


def menagerie_model(name: str, *, download: bool) -> Path:
    """Model file of MuJoCo Menagerie, downloaded by the package ``mujoco-menagerie`` if need be.

    Args:
        name: What follows ``menagerie:``.
        download: Whether to fetch what is not cached.

    Raises:
        NotFoundError: Menagerie has no such model, or the model no such entry.
        ModelError: The package is not installed, or the model is neither cached nor reachable.
    """
    if importlib.util.find_spec("mujoco_menagerie") is None:
        raise ModelError(
            f"menagerie:{name} needs a package that is not installed; pip install mujoco-menagerie"
        )
    menagerie = importlib.import_module("mujoco_menagerie")
    robot_name, _, entry = name.partition("/")
    if robot_name not in menagerie.names():
        hands = [robot.name for robot in menagerie.robots("end_effector")]
        raise NotFoundError("model of MuJoCo Menagerie", robot_name, hands)
    robot = menagerie.get(robot_name)
    if not download:
        cache = menagerie.Cache()
        if cache.root is None and not cache.is_cached(robot):
            raise ModelError(
                f"menagerie:{robot_name} {NOT_CACHED} python -m mujoco_menagerie prefetch "
                f"{robot_name} first"
            )
    if entry and entry not in robot.entry_names:
        raise NotFoundError(f"entry of menagerie:{robot_name}", entry, robot.entry_names)
    try:
        return Path(robot.xml(entry or robot.default_model))
    except (menagerie.MenagerieError, OSError) as error:
        raise ModelError(
            f"menagerie:{name} is neither cached nor can it be downloaded ({error}); run python -m "
            f"mujoco_menagerie prefetch {robot_name} where there is a network, or let "
            "MENAGERIE_ROOT name a copy of MuJoCo Menagerie"
        ) from error


def robot_descriptions_model(name: str, *, download: bool) -> Path:
    """Model file that the package ``robot_descriptions`` finds, cloned by it if need be.

    Args:
        name: What follows ``robot_descriptions:``.
        download: Whether to fetch what is not cached.

    Raises:
        NotFoundError: The package has no such description.
        ModelError: The package or git is not installed, the model is neither cached nor reachable,
            or the description holds no model file.
    """
    if importlib.util.find_spec("robot_descriptions") is None:
        raise ModelError(
            f"robot_descriptions:{name} needs a package that is not installed; pip install "
            "robot_descriptions"
        )
    known = importlib.import_module("robot_descriptions._descriptions").DESCRIPTIONS
    module = name if name in known else f"{name}_description"
    if module not in known:
        hands = [n.removesuffix("_description") for n in known if "end_effector" in known[n].tags]
        raise NotFoundError("model of robot_descriptions", name, hands)
    try:
        git = importlib.import_module("git")  # an ImportError where the program git is missing
    except ImportError as error:
        raise ModelError(
            f"robot_descriptions:{name} is cloned with git, which is missing ({error}); install "
            "git and pip install GitPython"
        ) from error
    try:
        with nullcontext() if download else _no_transport():
            found = importlib.import_module(f"robot_descriptions.{module}")
    except (git.exc.GitError, OSError) as error:
        if not download:
            raise ModelError(
                f"robot_descriptions:{name} {NOT_CACHED} python -m robot_descriptions pull "
                f"{module} first ({error})"
            ) from error
        raise ModelError(
            f"robot_descriptions:{name} is neither cached nor can it be cloned ({error}); run "
            f"python -m robot_descriptions pull {module} where there is a network, or give the "
            "path of the model"
        ) from error
    for field in ("MJCF_PATH", "URDF_PATH"):
        if hasattr(found, field):
            return Path(getattr(found, field))
    raise ModelError(
        f"robot_descriptions:{name} names neither an MJCF nor a URDF file; give the path of a model"
    )
