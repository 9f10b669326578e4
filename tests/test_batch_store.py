"""The folder of a batch: nothing is lost, nothing is half there, nothing is mixed."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.batch.dataset import GraspSet
from planner.batch.recipe import Manifest, ManifestObject, Recipe
from planner.batch.rows import failed_row, grasp_schema
from planner.batch.store import Store, shard_file
from planner.errors import FileFormatError, NotFoundError, TaskError
from planner.failure import Failure
from planner.hands.hand import Hand
from planner.plan import GraspPlan
from planner.search.grasp import Attempt
from planner.system.package import written_by
from planner.task import GraspTask

pytest.importorskip("pyarrow")


@dataclass(frozen=True)
class Kit:
    """What stores are made of."""

    manifest: Manifest
    schema: Any

    def store(self, folder: Path, **changes: Any) -> Store:
        """A store on a folder."""
        return Store(folder, self.manifest.model_copy(update=changes), self.schema)


@pytest.fixture(scope="module")
def kit(allegro: Hand) -> Kit:
    objects = [
        ManifestObject(label=name, **dict(Recipe.of(GraspTask.create(allegro, name))))
        for name in ("sphere", "box")
    ]
    manifest = Manifest(
        written_by=written_by(),
        hand=allegro.name,
        joint_names=list(allegro.joint_names),
        n=5,
        seed=0,
        max_attempts=3,
        options={"clear_tip": 0.1},
        shard_rows=4,
        objects=objects,
    )
    return Kit(manifest, grasp_schema(allegro))


def row(index: int) -> dict[str, Any]:
    """The row of a request out of 2 objects x 5 grasps; requests make one to three attempts."""
    made: list[Attempt[GraspPlan]] = [
        Attempt(index=i, plan=None, failure=Failure(kind="none", text=f"reason {i}"), cpu_s=0.1)
        for i in range(1 + index % 3)
    ]
    label = ("sphere", "box")[index // 5]
    return failed_row(index, label, index % 5, 1000 + index, str(made[-1].failure), made)


def line(kit: Kit, index: int) -> str:
    """The row of a request as the journal has it."""
    return json.dumps({"manifest_sha256": kit.manifest.digest, **row(index)}) + "\n"


def numbers(grasps: GraspSet) -> list[int]:
    """Which requests are there, in the order of the rows."""
    return [r["seed"] - 1000 for r in grasps]


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(order=st.permutations(range(10)), cut=st.integers(0, 10))
def test_any_order_and_any_interruption_give_the_same_rows(
    kit: Kit, tmp_path_factory: pytest.TempPathFactory, order: list[int], cut: int
) -> None:
    folder = tmp_path_factory.mktemp("store")
    with kit.store(folder) as store:
        for i in order[:cut]:
            store.add(row(i))
    assert numbers(GraspSet(folder)) == sorted(order[:cut])
    with kit.store(folder) as store:
        assert len(store) == cut
        assert [i for i in range(10) if store.has(i)] == sorted(order[:cut])
        for i in order[cut:]:
            store.add(row(i))
    grasps = GraspSet(folder)
    assert numbers(grasps) == list(range(10))
    assert grasps.complete
    assert sorted(p.name for p in (folder / "grasps").iterdir()) == [
        "part-000000.parquet",
        "part-000001.parquet",
        "part-000002.parquet",
    ]
    assert (folder / "journal.jsonl").read_text(encoding="utf-8") == ""


def test_a_row_is_on_the_disk_when_it_is_added(kit: Kit, tmp_path: Path) -> None:
    with kit.store(tmp_path) as store:
        store.add(row(7))
        assert numbers(GraspSet(tmp_path)) == [7]  # nothing was closed


def test_a_kill_within_a_write_loses_that_row_only(kit: Kit, tmp_path: Path) -> None:
    with kit.store(tmp_path) as store:
        for i in (0, 1, 9):
            store.add(row(i))
    journal = tmp_path / "journal.jsonl"
    text = journal.read_text(encoding="utf-8")
    for cut in (1, 40, len(text.splitlines()[-1]) - 1):
        journal.write_text(text[:-cut], encoding="utf-8")
        with kit.store(tmp_path) as store:
            assert [store.has(i) for i in (0, 1, 9)] == [True, True, cut == 1]
            store.add(row(2))
        assert 2 in numbers(GraspSet(tmp_path))
        journal.write_text(text, encoding="utf-8")


def test_a_kill_between_shard_and_journal_repeats_nothing(kit: Kit, tmp_path: Path) -> None:
    with kit.store(tmp_path) as store:
        for i in range(3):
            store.add(row(i))
        kept = (tmp_path / "journal.jsonl").read_text(encoding="utf-8")
        store.add(row(3))
    # the file of the shard is there, and its rows are still in the journal
    (tmp_path / "journal.jsonl").write_text(kept + line(kit, 3) + line(kit, 4), encoding="utf-8")
    assert numbers(GraspSet(tmp_path)) == [0, 1, 2, 3, 4]
    with kit.store(tmp_path) as store:
        assert len(store) == 5


def test_a_kill_before_the_shard_leaves_a_full_journal(kit: Kit, tmp_path: Path) -> None:
    with kit.store(tmp_path) as store:
        for i in range(4):
            store.add(row(i))
    shard_file(tmp_path, "grasps", 0).unlink()
    lines = "".join(line(kit, i) for i in range(4))
    (tmp_path / "journal.jsonl").write_text(lines, encoding="utf-8")
    with kit.store(tmp_path):
        assert shard_file(tmp_path, "grasps", 0).exists()
    assert numbers(GraspSet(tmp_path)) == [0, 1, 2, 3]


def test_a_damaged_shard_counts_as_absent(kit: Kit, tmp_path: Path) -> None:
    with kit.store(tmp_path) as store:
        for i in range(10):
            store.add(row(i))
    whole = shard_file(tmp_path, "grasps", 1).read_bytes()
    shard_file(tmp_path, "grasps", 1).write_bytes(whole[: len(whole) // 2])
    shard_file(tmp_path, "attempts", 2).unlink()
    (tmp_path / "partial.tmp").write_bytes(whole[:100])
    assert numbers(GraspSet(tmp_path)) == [0, 1, 2, 3]
    with kit.store(tmp_path) as store:
        missing = [i for i in range(10) if not store.has(i)]
        assert missing == [4, 5, 6, 7, 8, 9]
        for i in missing:
            store.add(row(i))
    assert numbers(GraspSet(tmp_path)) == list(range(10))


def test_rows_leave_memory_with_their_shard(kit: Kit, tmp_path: Path) -> None:
    many = 1000
    with kit.store(tmp_path, n=many // 2, shard_rows=10) as store:
        most = 0
        for i in range(many):
            store.add(row(0) | {"index": i})
            most = max(most, len(store._rows))
        assert most <= 10
        assert len(store) == many
        assert (tmp_path / "journal.jsonl").stat().st_size == 0


def test_every_attempt_is_in_the_second_table(kit: Kit, tmp_path: Path) -> None:
    with kit.store(tmp_path) as store:
        for i in range(6):
            store.add(row(i))
    table = GraspSet(tmp_path).attempts().to_pylist()
    assert len(table) == sum(1 + i % 3 for i in range(6))
    assert [t["attempt"] for t in table if (t["object"], t["k"]) == ("sphere", 2)] == [0, 1, 2]
    assert {t["reason"] for t in table} == {"reason 0", "reason 1", "reason 2"}


def test_one_writer_at_a_time(kit: Kit, tmp_path: Path) -> None:
    with kit.store(tmp_path):
        with pytest.raises(FileFormatError, match="another process"):
            kit.store(tmp_path)
        assert len(GraspSet(tmp_path)) == 0  # readers may
    with kit.store(tmp_path):
        pass


def test_another_batch_is_refused_and_told_apart(kit: Kit, tmp_path: Path) -> None:
    with kit.store(tmp_path):
        pass
    with pytest.raises(FileFormatError, match=r"seed is 0 there and 1 here; options.clear_tip is"):
        kit.store(tmp_path, seed=1, options={"clear_tip": 0.2})
    with pytest.raises(FileFormatError, match="objects is 2 values there and 1 values here"):
        kit.store(tmp_path, objects=kit.manifest.objects[:1])
    with pytest.raises(FileFormatError, match="written_by is"):
        kit.store(tmp_path, written_by="opposable 0.0.1")
    with kit.store(tmp_path):  # none of these keeps the folder locked
        pass


@pytest.mark.parametrize("n_rows", [1, 5, 10])
def test_grasps_without_a_manifest_are_not_adopted(kit: Kit, tmp_path: Path, n_rows: int) -> None:
    with kit.store(tmp_path) as store:
        for i in range(n_rows):
            store.add(row(i))
    kept = (tmp_path / "manifest.json").read_bytes()
    (tmp_path / "manifest.json").unlink()
    with pytest.raises(FileFormatError, match=r"no manifest.json.*bring that file back"):
        kit.store(tmp_path, seed=99)
    assert not (tmp_path / "manifest.json").exists()
    (tmp_path / "manifest.json").write_bytes(kept)
    with kit.store(tmp_path) as store:
        assert len(store) == n_rows


def test_a_batch_that_was_killed_before_its_manifest_begins_again(kit: Kit, tmp_path: Path) -> None:
    with kit.store(tmp_path):
        pass
    (tmp_path / "manifest.json").rename(tmp_path / ".0123456789abcdef.part")
    with kit.store(tmp_path, seed=99) as store:
        assert len(store) == 0


@pytest.mark.parametrize("n_rows", [1, 4])
def test_rows_of_another_manifest_are_refused(kit: Kit, tmp_path: Path, n_rows: int) -> None:
    with kit.store(tmp_path / "old") as store:  # one row in the journal, four in a shard
        for i in range(n_rows):
            store.add(row(i))
    with kit.store(tmp_path / "other", seed=99):
        pass
    (tmp_path / "other" / "manifest.json").replace(tmp_path / "old" / "manifest.json")
    with pytest.raises(FileFormatError, match=r"planned for another manifest.json"):
        kit.store(tmp_path / "old", seed=99)
    with pytest.raises(FileFormatError, match=r"planned for another manifest.json"):
        GraspSet(tmp_path / "old")


def test_a_batch_of_the_first_version_is_read_but_not_gone_on_with(
    kit: Kit, tmp_path: Path
) -> None:
    with kit.store(tmp_path) as store:
        for i in range(5):
            store.add(row(i))
    data = json.loads((tmp_path / "manifest.json").read_text(encoding="utf-8"))
    for item in data["objects"]:
        del item["may_spare_fingers"], item["rotations"]
    del data["max_cpu_s"]
    data["version"] = 1
    shard_file(tmp_path, "grasps", 0).unlink()
    lines = "".join(json.dumps(row(i)) + "\n" for i in range(5))
    (tmp_path / "journal.jsonl").write_text(lines, encoding="utf-8")
    (tmp_path / "manifest.json").write_text(json.dumps(data), encoding="utf-8")
    assert numbers(GraspSet(tmp_path)) == list(range(5))
    with pytest.raises(FileFormatError, match="version is 1 there and 2 here"):
        kit.store(tmp_path)


@pytest.mark.parametrize("damage", ["truncated", "foreign", "empty", "scrambled"])
def test_damage_of_a_file_is_an_error_that_says_what_to_do(
    kit: Kit, tmp_path: Path, damage: str
) -> None:
    with kit.store(tmp_path) as store:
        for i in range(10):
            store.add(row(i))
    path = shard_file(tmp_path, "grasps", 0)
    whole = path.read_bytes()
    changed = {
        "truncated": whole[:-20],
        "foreign": b"PAR1 is not enough",
        "empty": b"",
        "scrambled": whole[:4] + bytes(255 - b for b in whole[4:600]) + whole[600:],
    }
    path.write_bytes(changed[damage])
    grasps = GraspSet(tmp_path)
    if damage == "scrambled":  # its end, which says what is where, is as it was
        with pytest.raises(FileFormatError, match=r"is damaged: .*; delete that file"):
            list(grasps)
    else:
        assert numbers(grasps) == list(range(4, 10))


def test_a_folder_with_other_files_is_refused(kit: Kit, tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work", encoding="utf-8")
    with pytest.raises(FileFormatError, match="holds files but no batch"):
        kit.store(tmp_path)
    with pytest.raises(FileFormatError, match="cannot write"):
        kit.store(tmp_path / "thesis.tex")


def test_reading_says_what_is_missing(kit: Kit, tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="cannot read"):
        GraspSet(tmp_path)
    with kit.store(tmp_path) as store:
        store.add(row(5))
        store.add(row(3))
    grasps = GraspSet(tmp_path)
    assert grasps[0]["k"] == 3
    assert grasps[-1]["object"] == "box"
    with pytest.raises(IndexError):
        grasps[2]
    with pytest.raises(NotFoundError, match="sphere"):
        grasps.task("spere")
    with pytest.raises(FileFormatError, match="was not found: reason"):
        grasps.plan(0)
    (tmp_path / "manifest.json").write_text('{"format": "opposable-grasps"}', encoding="utf-8")
    with pytest.raises(FileFormatError, match="damaged"):
        GraspSet(tmp_path)


def test_an_empty_batch_has_empty_tables(kit: Kit, tmp_path: Path) -> None:
    with kit.store(tmp_path):
        pass
    grasps = GraspSet(tmp_path)
    assert (len(grasps), grasps.table().num_rows, grasps.attempts().num_rows) == (0, 0, 0)
    assert grasps.diversity("box").n == 0
    assert grasps.thinned("box").tolist() == []


def test_without_pyarrow_the_extra_is_named(
    kit: Kit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    with pytest.raises(TaskError, match=r"pip install 'opposable\[batch\]'"):
        kit.store(tmp_path)
