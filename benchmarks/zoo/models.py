"""The hands of the zoo: shipped, in installed packages, and in clones of public repositories."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from planner.errors import FileFormatError, NotFoundError
from planner.hands.catalog import foreign_hand_names, hand_names

MODELS_FILE = Path(__file__).resolve().parents[2] / "docs" / "zoo" / "models.toml"
"""The list of published models, in the checkout."""


@dataclass(frozen=True, kw_only=True)
class ZooModel:
    """A hand of the zoo.

    Attributes:
        name: What the zoo calls it.
        source: "shipped", "package" or "repository".
        reference: What ``load_hand`` takes; for a repository, relative to the folder of clones.
        url: Where a reader finds the model; "" for those that ship.
        base: The body that is the hand's base, where the model holds more; else "".
    """

    name: str
    source: str
    reference: str
    url: str = ""
    base: str = ""

    @property
    def slug(self) -> str:
        """The name in a file's name."""
        letters = "".join(c if c.isalnum() else " " for c in self.name.lower())
        return "-".join(letters.split())


def zoo_models(file: Path = MODELS_FILE) -> list[ZooModel]:
    """All hands: those that ship, those in packages, those of the list.

    Raises:
        FileFormatError: The list cannot be read, or names two hands alike.
    """
    models = [ZooModel(name=name, source="shipped", reference=name) for name in hand_names()]
    models += [
        ZooModel(
            name=name,
            source="package",
            reference=name,
            url=f"https://pypi.org/project/{name.partition(':')[0]}/",
        )
        for name in foreign_hand_names()
    ]
    for entry in _read(file):
        where, commit = entry["repository"], entry["commit"]
        models += [
            ZooModel(
                name=name,
                source="repository",
                reference=f"{where}/{path}",
                url=_url(where, commit, path),
                base="".join(base),
            )
            for name, path, *base in entry["hands"]
        ]
    slugs = [model.slug for model in models]
    twice = sorted({slug for slug in slugs if slugs.count(slug) > 1})
    if twice:
        raise FileFormatError(f"{file} names hands alike: {', '.join(twice)}; rename one of each")
    return models


def chosen(models: list[ZooModel], names: list[str]) -> list[ZooModel]:
    """Those of some names, or of some references; all if none is named.

    Raises:
        NotFoundError: No hand of the zoo is called so.
    """
    by_name = {m.name: m for m in models} | {m.slug: m for m in models}
    by_name |= {m.reference: m for m in models}
    for name in names:
        if name not in by_name:
            raise NotFoundError("hand of the zoo", name, [m.name for m in models])
    return [by_name[name] for name in names] or models


def _url(repository: str, commit: str, path: str) -> str:
    """Where a file of a commit is read, or the release of a package of the owner ``pypi``."""
    owner, _, package = repository.partition("/")
    if owner == "pypi":
        return f"https://pypi.org/project/{package}/{commit}/"
    return f"https://github.com/{repository}/blob/{commit}/{path}"


def _read(file: Path) -> list[dict[str, Any]]:
    try:
        with file.open("rb") as stream:
            entries: list[dict[str, Any]] = tomllib.load(stream)["repositories"]
    except (OSError, KeyError, tomllib.TOMLDecodeError) as error:
        raise FileFormatError(f"cannot read the list of models {file}: {error}") from error
    wrong = [e for e in entries if {"repository", "commit", "hands"} - set(e)]
    if wrong:
        raise FileFormatError(f"{file}: an entry lacks repository, commit or hands: {wrong[0]}")
    return entries
