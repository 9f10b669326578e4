"""From a name or a path to the files of a hand on disk: shipped, in a package, or downloaded.

The models travel inside the wheel (``planner/_models``) and stand at the top of a checkout
(``models``); both are found from any working directory. Hands of other projects stay in the Python
packages that ship them and are looked up there.

Some packages download models on request and cache them. A name on the command line or in Python is
such a request. A name in a plan or batch file is not, because its writer may be unknown: reading
the file uses cached models and fetches nothing.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import re
import sys
from contextlib import nullcontext
from importlib import metadata
from pathlib import Path

from planner.errors import ModelError, NotFoundError
from planner.registry import Registry
from planner.system.package import models_dir
from planner.system.threads import Held

__all__ = [
    "FOREIGN_HANDS",
    "MODEL_SUFFIXES",
    "PACKAGE_SCHEME",
    "find_hand",
    "foreign_hand_model",
    "foreign_hand_names",
    "hand_names",
    "hand_reference",
    "joined_names",
    "model_file",
]

DESCRIPTION_FILE = "hand.toml"

MODEL_SUFFIXES = (".xml", ".mjcf", ".urdf")
"""Suffixes of model files, as opposed to descriptions."""

JOIN = "+"
"""Between the names of two hands that are to be one (``planner.hands.two_hands``)."""

JOINED_NAMES = ("first", "second")
"""What the two are called in the whole, which no file names."""

PACKAGE_SCHEME = "package:"
"""``package:PACKAGE/PATH`` is a file inside an installed Python package."""

ASSETS_HINT = 'install it, for example with pip install "opposable[assets]"'

_GYM = "package:gymnasium_robotics/envs/assets"
_ALLEGRO = "package:example-robot-data/robots/allegro_hand_description/urdf"
_SUITE = "package:robosuite/models/assets/grippers"

_KNOWN = {
    "gymnasium-robotics:adroit": f"{_GYM}/adroit_hand/adroit_pen.xml",
    "gymnasium-robotics:shadow": f"{_GYM}/hand/reach.xml",
    "example-robot-data:allegro_left": f"{_ALLEGRO}/allegro_left_hand.urdf",
    "example-robot-data:allegro_right": f"{_ALLEGRO}/allegro_right_hand.urdf",
    "robosuite:fourier_left": f"{_SUITE}/fourier_left_hand.xml",
    "robosuite:fourier_right": f"{_SUITE}/fourier_right_hand.xml",
    "robosuite:inspire_left": f"{_SUITE}/inspire_left_hand.xml",
    "robosuite:inspire_right": f"{_SUITE}/inspire_right_hand.xml",
    "robosuite:jaco_three_finger": f"{_SUITE}/jaco_three_finger_gripper.xml",
    "robosuite:robotiq_3f": f"{_SUITE}/robotiq_gripper_s.xml",
}
"""Hands in packages that we know, ``PACKAGE:NAME`` -> model. The fragment ``hand/robot.xml`` of
gymnasium-robotics is empty by itself, so a scene that includes it stands here."""

FOREIGN_HANDS: Registry[str | Path] = Registry("hand", group="hands", error=ModelError)
"""Hands of others: name -> path of a description or model, or ``package:PACKAGE/PATH``. A package
adds its own by an entry point of the group ``opposable.hands``, which names such a path."""

for _name, _model in _KNOWN.items():
    FOREIGN_HANDS.add(_name, _model)

_NOT_CACHED = "is not cached, and a file that is read downloads nothing; if you trust the file, run"
"""Message about a model that a file names and that is not cached."""

_no_transport = Held("GIT_ALLOW_PROTOCOL", "none")
"""While it is held, git neither clones nor fetches, by any protocol, but reads local files."""

_PACKAGE_NAME = re.compile(r"[A-Za-z0-9_-]+")


def hand_names() -> tuple[str, ...]:
    """Names of the hands that come with Opposable, sorted."""
    folders = (models_dir() / "hands").iterdir()
    return tuple(sorted(f.name for f in folders if (f / DESCRIPTION_FILE).is_file()))


def foreign_hand_names() -> tuple[str, ...]:
    """Names of hands in packages of others, sorted.

    ``PACKAGE:NAME`` of known ones, installed or not, and those that installed packages bring.
    """
    return tuple(sorted(FOREIGN_HANDS))


def foreign_hand_model(name: str) -> str | None:
    """The ``model`` line of a known hand of others; None if a name ``PACKAGE:NAME`` is none.

    The package may be spelt with underscores, as it is imported.
    """
    package, colon, inside = name.partition(":")
    model = FOREIGN_HANDS.get(f"{package.replace('_', '-')}:{inside}" if colon else name)
    return None if model is None else str(model)


def find_hand(name_or_path: str | Path, *, download: bool = True) -> Path:
    """Path of a hand's description file, or of its model where there is no description.

    Args:
        name_or_path: A name out of ``hand_names()`` or ``foreign_hand_names()``; ``menagerie:NAME``
            or ``menagerie:NAME/ENTRY``; ``robot_descriptions:ID``; ``package:PACKAGE/PATH``; a
            description file (``hand.toml``) or a folder that holds one; a model file.
        download: Whether ``menagerie:`` and ``robot_descriptions:`` may fetch what is not cached.

    Raises:
        NotFoundError: It is neither a known name nor an existing path.
        ModelError: The path exists but is neither a description nor a model, or the package or
            download that has the model is missing.
    """
    text = str(name_or_path)
    if text in hand_names():
        return models_dir() / "hands" / text / DESCRIPTION_FILE
    if text.startswith(PACKAGE_SCHEME):
        return model_file(text, Path())
    source, _, name = text.partition(":")
    if source == "menagerie":
        return _menagerie_model(name, download=download)
    if source == "robot_descriptions":
        return _robot_descriptions_model(name, download=download)
    foreign = foreign_hand_model(text)
    path = Path(name_or_path) if foreign is None else model_file(foreign, Path())
    if os.path.isdir(path):  # False, not an error, where the name is too long or the way is barred
        path = path / DESCRIPTION_FILE
    if os.path.isfile(path):
        if path.suffix != ".toml" and path.suffix.lower() not in MODEL_SUFFIXES:
            raise ModelError(
                f"{path} is neither a hand description nor a model; give a hand.toml or a model "
                f"that ends in {', '.join(MODEL_SUFFIXES)}"
            )
        return path
    # package:NAME may hold a slash, and is none
    if "/" in text.partition(":")[0] or path.suffix.lower() in (".toml", *MODEL_SUFFIXES):
        advice = "give a hand.toml, a model, or a name that opposable hands lists"
        raise NotFoundError("hand", str(path), hand_names(), advice, is_path=True)
    hint = "Or give the path of a hand.toml or of a model."
    brought = (n for n in foreign_hand_names() if name or ":" not in n)
    names = (*hand_names(), *brought)
    raise NotFoundError("hand", text, names, hint)


def joined_names(name_or_path: str | Path) -> tuple[str, ...]:
    """The names in "ONE+OTHER", which are two hands; none where it is one hand or a path."""
    text = str(name_or_path)
    if JOIN not in text or os.path.exists(text):
        return ()
    return tuple(name.strip() for name in text.split(JOIN))


def hand_reference(name_or_path: str | Path) -> str:
    """Reference to the same hand from any folder: the name, or the absolute path."""
    text = str(name_or_path)
    if names := joined_names(name_or_path):
        return JOIN.join(hand_reference(name) for name in names)
    is_name = text in hand_names() or (
        not os.path.exists(text) and (":" in text or text in FOREIGN_HANDS)
    )
    if is_name:
        return text
    path = Path(name_or_path).absolute()
    shipped = (models_dir() / "hands").resolve()
    inside = path.resolve()
    if inside.parent.parent == shipped and inside.name == DESCRIPTION_FILE:
        return inside.parent.name
    return str(path)


def model_file(model: str, folder: Path) -> Path:
    """The file that the ``model`` line of a description means.

    Args:
        model: A path, relative to ``folder`` or absolute, or ``package:PACKAGE/PATH``.
        folder: Folder of the description.

    Raises:
        ModelError: The package is not installed, or has no such file.
    """
    if not model.startswith(PACKAGE_SCHEME):
        return folder / model
    package, _, inside = model.removeprefix(PACKAGE_SCHEME).partition("/")
    if not _PACKAGE_NAME.fullmatch(package):
        raise ModelError(
            f"{model!r}: {package!r} is not the name of a package; give package:PACKAGE/PATH, the "
            "package by letters, digits, _ and -"
        )
    roots = _package_folders(package)
    if not roots:
        raise ModelError(f"{model}: the package {package!r} {_how_to_install(package)}")
    for root in roots:
        if inside and os.path.isfile(root / inside):
            return root / inside
    raise ModelError(
        f"{model}: the installed package {package!r} has no file {inside!r}; correct the path, or "
        "install another version of the package"
    )


def _how_to_install(package: str) -> str:
    """Message about a package without files: an install command for known packages only.

    The name may come from a file of unknown origin; a command to install it would run any code that
    was uploaded under that name.
    """
    if package in sys.stdlib_module_names:
        return "is a module of Python itself, which has no models; correct the name"
    known = {name.partition(":")[0] for name in _KNOWN}
    if package.replace("_", "-") in known:
        return f"is not installed; {ASSETS_HINT} or pip install {package.replace('_', '-')}"
    return (
        "is not installed, and it is none of those that Opposable knows "
        f"({', '.join(sorted(known))}); install it if you know where it comes from, or "
        "give the path of the model"
    )


def _package_folders(package: str) -> list[Path]:
    """Where a package keeps its data: beside its modules, or as a share of a cmeel wheel."""
    found = importlib.util.find_spec(package) if package.isidentifier() else None
    folders = [Path(f) for f in (found.submodule_search_locations or ())] if found else []
    try:
        wheel = metadata.distribution(package)
    except metadata.PackageNotFoundError:
        return folders
    share = Path(str(wheel.locate_file(f"cmeel.prefix/share/{package}")))
    return [*folders, share] if share.is_dir() else folders


def _menagerie_model(name: str, *, download: bool) -> Path:
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
                f"menagerie:{robot_name} {_NOT_CACHED} python -m mujoco_menagerie prefetch "
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


def _robot_descriptions_model(name: str, *, download: bool) -> Path:
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
                f"robot_descriptions:{name} {_NOT_CACHED} python -m robot_descriptions pull "
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
