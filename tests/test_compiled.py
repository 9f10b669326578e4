"""CasADi functions as compiled libraries."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from planner.errors import PlannerError
from planner.numerics.casadi_compiled import compiled
from planner.numerics.kernels import COMPILE_VARIABLE
from planner.system import disk_cache as trust
from planner.system.disk_cache import CACHE_VARIABLE, digest_file

needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler here")


def example() -> ca.Function:
    x, p = ca.SX.sym("x", 3), ca.SX.sym("p", 2)
    y = ca.vertcat(ca.sin(x[0]) * p[0] + x[1] * x[2], ca.sqrt(ca.sumsqr(x)) / p[1])
    return ca.Function("example", [x, p], [y, ca.jacobian(y, x)])


@needs_compiler
def test_a_compiled_function_gives_the_same_numbers_and_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    monkeypatch.setenv(COMPILE_VARIABLE, "1")
    plain, quick = example(), compiled(example())
    assert quick.class_name() != plain.class_name()
    rng = np.random.default_rng(0)
    for _ in range(20):
        x, p = rng.normal(size=3), rng.normal(size=2)
        for mine, theirs in zip(quick(x, p), plain(x, p), strict=True):
            np.testing.assert_array_equal(np.array(mine), np.array(theirs))
    (library,) = tmp_path.rglob("*.so")
    made = library.stat().st_mtime_ns
    compiled(example())
    assert library.stat().st_mtime_ns == made
    assert sorted(library.parent.iterdir()) == sorted([library, digest_file(library)])


@needs_compiler
@pytest.mark.parametrize("damage", ["empty", "cut", "open to others", "a link", "no digest"])
def test_a_damaged_or_open_library_is_compiled_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, damage: str
) -> None:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
    monkeypatch.setenv(COMPILE_VARIABLE, "1")
    compiled(example())
    (library,) = tmp_path.rglob("*.so")
    whole = library.read_bytes()
    library.unlink()  # the one that is loaded stays as it is
    if damage == "a link":
        (tmp_path / "elsewhere.so").write_bytes(whole)
        library.symlink_to(tmp_path / "elsewhere.so")
    else:
        library.write_bytes({"empty": b"", "cut": whole[:500]}.get(damage, whole))
    if damage == "open to others":
        library.chmod(0o666)
    if damage == "no digest":
        digest_file(library).unlink()
    again = compiled(example())
    assert again(np.ones(3), np.ones(2))[0].shape == (2, 1)
    assert library.read_bytes() == whole
    assert not library.is_symlink()
    assert library.stat().st_mode & 0o777 == 0o700


PLANTED = """
#include <stdio.h>
__attribute__((constructor)) static void run(void) { fclose(fopen("RAN", "w")); }
"""


@needs_compiler
@pytest.mark.parametrize("place", ["compiled", "cache", "above"])
def test_a_library_that_others_could_have_planted_does_not_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str
) -> None:
    monkeypatch.chdir(tmp_path)
    cache = tmp_path / "above" / "cache"
    monkeypatch.setenv(CACHE_VARIABLE, str(cache))
    monkeypatch.setenv(COMPILE_VARIABLE, "1")
    compiled(example())
    (library,) = tmp_path.rglob("*.so")
    source = tmp_path / "planted.c"
    source.write_text(PLANTED.replace("RAN", str(tmp_path / "ran")), encoding="utf-8")
    library.unlink()
    subprocess.run(["cc", "-shared", "-fPIC", str(source), "-o", str(library)], check=True)
    digest = hashlib.sha256(library.read_bytes()).hexdigest()
    digest_file(library).write_text(digest, encoding="ascii")
    folder = {"compiled": library.parent, "cache": cache, "above": cache.parent}[place]
    folder.chmod(0o777)
    with pytest.raises(PlannerError, match=r"can be written by others .mode 777.*chmod go-w"):
        compiled(example())
    assert not (tmp_path / "ran").exists()
    library.unlink()  # it is ours, and in a sticky folder nobody could have put it there
    folder.chmod(0o1777)
    if place == "compiled":
        with pytest.raises(PlannerError, match="mode 1777"):
            compiled(example())
    else:
        compiled(example())


@needs_compiler
def test_a_library_of_another_user_is_not_loaded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    monkeypatch.setenv(COMPILE_VARIABLE, "1")
    compiled(example())
    owner = (tmp_path / "compiled").stat().st_uid
    monkeypatch.setattr("os.getuid", lambda: owner + 1)
    if owner == 0:
        monkeypatch.setattr(trust, "is_mine", lambda state: state.st_uid == os.getuid())
    with pytest.raises(PlannerError, match="belongs to the user with id"):
        compiled(example())


@needs_compiler
def test_another_compiler_makes_another_library(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
    monkeypatch.setenv(COMPILE_VARIABLE, "1")
    compiled(example())
    other = tmp_path / "other"
    other.write_text('#!/bin/sh\nexec cc "$@"\n', encoding="utf-8")
    other.chmod(0o755)
    monkeypatch.setenv("CC", str(other))
    compiled(example())
    assert len(list(tmp_path.rglob("*.so"))) == 2


def test_nothing_is_compiled_unless_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    function = example()
    for value in ("", "0"):
        monkeypatch.setenv(COMPILE_VARIABLE, value)
        assert compiled(function) is function
    assert not list(tmp_path.iterdir())


def test_what_is_wrong_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    monkeypatch.setenv(COMPILE_VARIABLE, "yes")
    with pytest.raises(PlannerError, match="set it to 1 or to 0"):
        compiled(example())
    monkeypatch.setenv(COMPILE_VARIABLE, "1")
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(PlannerError, match="no C compiler 'no-such-compiler'"):
        compiled(example())
    monkeypatch.setenv("CC", "false")
    with pytest.raises(PlannerError, match="failed on generated code"):
        compiled(example())
    assert not list(tmp_path.rglob("*.so"))
