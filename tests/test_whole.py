"""Files are written whole, in the folder that was named, and follow no links that were planted."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

import mujoco
import pytest
import typer

import planner.bridge  # noqa: F401 - what is tested
from planner.errors import FileFormatError
from planner.files import plain_name, write_json
from planner.files.disk import whole_file
from sim.cli.common import errors_for_people, make_folder


def test_a_link_in_the_way_is_not_followed(tmp_path: Path) -> None:
    victim, target = tmp_path / "victim", tmp_path / "x.json"
    victim.write_text("years of work", encoding="utf-8")
    for name in ("x.json.part", ".x.json.part", "x.json"):
        (tmp_path / name).symlink_to(victim)
    write_json({"a": 1}, target)
    assert victim.read_text(encoding="utf-8") == "years of work"
    assert not target.is_symlink()
    assert target.read_text(encoding="utf-8") == '{\n "a": 1\n}\n'


def test_a_file_has_the_mode_that_the_user_gives_files(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        write_json({}, tmp_path / "x.json")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "x.json").stat().st_mode) == 0o640


def test_what_fails_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    path.write_text("old", encoding="utf-8")
    with pytest.raises(FileFormatError, match="No space left"), whole_file(path) as stream:
        stream.write(b"new")
        raise OSError(errno.ENOSPC, "No space left on device")
    with pytest.raises(RuntimeError), whole_file(path):
        raise RuntimeError
    assert [p.name for p in tmp_path.iterdir()] == ["x.json"]
    assert path.read_text(encoding="utf-8") == "old"
    for wrong in (tmp_path / "missing" / "x", tmp_path / "a\0b", tmp_path / ("x" * 5000)):
        with pytest.raises(FileFormatError, match="cannot write"):
            write_json({}, wrong)


@pytest.mark.parametrize(
    ("name", "plain"),
    [
        ("allegro_hand", "allegro_hand"),
        ("../../../ESCAPED", "ESCAPED"),
        ("/etc/passwd", "etc-passwd"),
        ("..", "unnamed"),
        ("", "unnamed"),
        (".hidden", "hidden"),
        ("a b\n\0c", "a-b--c"),
        ("-rf", "rf"),
        ("x" * 5000, "x" * 100),
    ],
)
def test_names_stay_in_their_folder(name: str, plain: str) -> None:
    assert plain_name(name) == plain


def test_an_error_leaves_no_empty_folders(tmp_path: Path) -> None:
    @errors_for_people()
    def command(content: str) -> None:
        make_folder(tmp_path / "a" / "b")
        if content:
            (tmp_path / "a" / content).touch()
        raise FileFormatError("no")

    with pytest.raises(typer.Exit):
        command("")
    assert not (tmp_path / "a").exists()
    with pytest.raises(typer.Exit):
        command("kept")
    assert [p.name for p in (tmp_path / "a").iterdir()] == ["kept"]


def test_mujoco_writes_no_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    text = "<mujoco><worldbody><body><freejoint/><geom size='1'/></body></worldbody></mujoco>"
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qvel[:] = 1e300
    mujoco.mj_step(model, data)
    assert data.warning[int(mujoco.mjtWarning.mjWARN_BADQVEL)].number
    assert not list(tmp_path.iterdir())
