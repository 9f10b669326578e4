"""The folder of a cache: what it was asked for, and what earlier runs left in it.

Its files, where ``NAME`` is one object in one size::

    manifest.json         what was asked for; another request is refused
    check_states.py       holds a sample of states with NumPy and MuJoCo alone
    summary.json          rates, reasons, coverage
    NAME/scene.xml        hand and object, with mesh files if there are any
    NAME/states.npz ...   the states in every format
    NAME/work/            sources and shards, for a run that goes on
    hora/                 caches of HORA
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from shutil import copyfile
from typing import Any

from planner.errors import FileFormatError, few_of, shown
from planner.files import read_json, write_json
from planner.version import written_by
from sim.reset_states.asked import StatesAsked
from sim.reset_states.starts import WORK

MANIFEST, SUMMARY, CHECK_FILE = "manifest.json", "summary.json", "check_states.py"
"""Files in the root of a cache."""

FORMAT, VERSION = "opposable-states-cache", 1

JOURNAL = "sources.jsonl"


def open_folder(folder: Path, asked: StatesAsked, hand_digest: str) -> None:
    """Begin a cache, or go on with one.

    Args:
        folder: Its folder.
        asked: What is asked for. More states than last time may be, nothing else may differ.
        hand_digest: Digest of the hand's files.

    Raises:
        FileFormatError: The folder holds another cache, or something else.
    """
    path = folder / MANIFEST
    wanted = {"format": FORMAT, "version": VERSION, "hand_sha256": hand_digest, **asked.to_dict()}
    if path.exists():
        there = read_json(path, "a cache of states")
        there.pop("written_by", None)
        if there.get("format") != FORMAT:
            raise FileFormatError(
                f"{folder} holds something else, of the format {shown(there.get('format'))}; "
                "choose another folder"
            )
        if differing := [k for k in sorted({*there, *wanted}) if there.get(k) != wanted.get(k)]:
            k = differing[0]
            raise FileFormatError(
                f"{folder} holds states that were asked for otherwise: {few_of(differing)} "
                f"differ ({k} is {shown(there.get(k))} there and {shown(wanted.get(k))} here); ask "
                "for the same to go on, or choose another folder"
            )
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise FileFormatError(f"{folder} is not empty and holds no {MANIFEST}; choose another")
        copyfile(Path(__file__).with_name(CHECK_FILE), folder / CHECK_FILE)
    except OSError as error:
        raise FileFormatError(
            f"cannot begin a cache in {folder}: {error.strerror}; choose another folder"
        ) from error
    write_json({**wanted, "written_by": written_by()}, path)


def journal(folder: Path) -> dict[str, Mapping[str, Any]]:
    """Plans of a cell that were made, by their key; half a line, left by a kill, is skipped."""
    path = folder / WORK / JOURNAL
    made: dict[str, Mapping[str, Any]] = {}
    if path.exists():
        for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
            try:
                plan = json.loads(line)
            except ValueError:
                continue
            if isinstance(plan, dict) and isinstance(plan.get("key"), str):
                made[plan["key"]] = plan
    return made


def append_line(folder: Path, plans: Iterable[Mapping[str, Any]]) -> Iterable[Mapping[str, Any]]:
    """Add plans to the journal of a cell as they come, and pass them on."""
    path = folder / WORK / JOURNAL
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", encoding="utf-8") as stream:
        stream.write("\n")  # after half a line, if there is one
        for plan in plans:
            stream.write(json.dumps(plan) + "\n")
            stream.flush()
            yield plan
