"""Plans as a folder of DexGraspBench: paths lead to what is there, and nothing is half written."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from planner.errors import FileFormatError, TaskError
from planner.exchange.dexgraspbench import export as module
from planner.exchange.dexgraspbench.export import write_dexgraspbench
from planner.exchange.formats import Writing
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.plan import GraspPlan
from planner.search.grasp import plan_grasp
from planner.task import GraspTask


@pytest.fixture(scope="module")
def plans(allegro: Hand) -> list[GraspPlan]:
    sizes = ("sphere:0.03", "box")
    return [
        plan_grasp(GraspTask.create(allegro, size), seed=seed) for size in sizes for seed in (0, 1)
    ]


def test_every_path_in_a_folder_leads_to_what_is_in_it(
    plans: list[GraspPlan], tmp_path: Path
) -> None:
    folder = tmp_path / "bench"
    files = write_dexgraspbench(plans, folder, Writing())
    assert len(files) == 4
    for file, plan in zip(files, plans, strict=True):
        data = np.load(file, allow_pickle=True).item()
        np.testing.assert_array_equal(data["grasp_qpos"][7:], plan.q)
        assert (Path(data["obj_path"]) / "info" / "simplified.json").is_file()
        assert folder in Path(data["obj_path"]).parents
    (config,) = (folder / "hand").glob("*.yaml")
    model = Path(json.loads(config.read_text(encoding="utf-8"))["xml_path"])
    assert model.is_file()
    assert folder in model.parents
    assert [path.name for path in tmp_path.iterdir()] == ["bench"]


def test_a_folder_with_something_in_it_is_refused(plans: list[GraspPlan], tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("keep", encoding="utf-8")
    with pytest.raises(FileFormatError, match="is no empty folder; name another one"):
        write_dexgraspbench(plans, tmp_path, Writing())
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


def test_nothing_stays_of_a_folder_that_could_not_be_finished(
    plans: list[GraspPlan], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(module, "write_object", full)
    with pytest.raises(FileFormatError, match="No space left"):
        write_dexgraspbench(plans, tmp_path / "bench", Writing())
    assert not list(tmp_path.iterdir())


def test_hands_that_the_benchmark_cannot_have_are_refused(
    plans: list[GraspPlan], tmp_path: Path
) -> None:
    left = plan_grasp(GraspTask.create("allegro_hand_left", "box"), seed=0)
    with pytest.raises(TaskError, match="more than one hand, allegro_hand and allegro_hand_left"):
        write_dexgraspbench([*plans, left], tmp_path / "bench", Writing())
    motors = plan_grasp(GraspTask.create(load_hand("shadow_hand_torque"), "sphere"), seed=0)
    with pytest.raises(TaskError, match="no position servos"):
        write_dexgraspbench([motors], tmp_path / "bench", Writing())
