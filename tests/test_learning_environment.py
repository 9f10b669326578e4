"""The Gymnasium environment: its spaces, seeds and faults; its verdict is that of the protocol."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner.errors import NotFoundError, TaskError
from planner.motion.verify import ASKED_SHARE
from sim.learning import Conditions, Plans, TurnTask
from sim.learning.controller import Demonstrator
from sim.manipulation.log import force_limit
from sim.sensing.errors import named_errors

gymnasium = pytest.importorskip("gymnasium")
pytest.importorskip("greenlet")

from gymnasium.utils.env_checker import check_env  # noqa: E402
from gymnasium.utils.seeding import np_random  # noqa: E402

from sim.learning.environment import ENVIRONMENT, TurnEnv  # noqa: E402

pytestmark = pytest.mark.usefixtures("brief_manipulations")

OBJECT, ANGLE_DEG = "cylinder:0.03x0.08", 45.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("plans")


def make(folder: Path, **options: Any) -> TurnEnv:
    """An environment of one plan."""
    return TurnEnv(objects=OBJECT, angle_deg=ANGLE_DEG, plans=1, folder=folder, **options)


@pytest.fixture
def env(folder: Path) -> Iterator[TurnEnv]:
    made = make(folder, error_model="lab")
    yield made
    made.close()


def rollout(env: TurnEnv, seed: int, n: int) -> list[Any]:
    """All that n random steps tell."""
    rng = np.random.default_rng(0)
    told: list[Any] = [env.reset(seed=seed)[0]]
    for _ in range(n):
        action = 0.1 * rng.uniform(-1, 1, env.action_space.shape).astype(np.float32)
        told += env.step(action)[:3]
    return told


def equal(one: list[Any], other: list[Any]) -> bool:
    """Whether two rollouts are the same to the last bit."""

    def flat(told: Any) -> list[Any]:
        return [v.tobytes() for v in told.values()] if isinstance(told, dict) else [told]

    return [v for t in one for v in flat(t)] == [v for t in other for v in flat(t)]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*render.*")
def test_gymnasium_finds_nothing_wrong_with_it(folder: Path) -> None:
    env = make(folder)  # without errors of sensors, which it does not ask about
    check_env(env, skip_render_check=True)
    env.close()


@pytest.mark.slow
def test_the_same_seed_gives_the_same_rollout_bit_for_bit(env: TurnEnv, folder: Path) -> None:
    first = rollout(env, 5, 15)
    assert equal(first, rollout(env, 5, 15))  # also after an episode that was left
    other = make(folder, error_model="lab")
    assert equal(first, rollout(other, 5, 15))
    assert not equal(first, rollout(other, 6, 15))
    other.close()


@pytest.mark.slow
def test_reward_and_success_are_the_verdict_on_the_teachers_own_run(
    env: TurnEnv, folder: Path
) -> None:
    """The teacher's actions, given from outside, make the run that it made itself."""
    angle = math.radians(ANGLE_DEG)
    lab = named_errors("lab")
    task = TurnTask(hand="allegro_hand", objects=OBJECT, angle=angle, error_model=lab)
    plan = Plans(task, folder)(0)
    rng, _ = np_random(11)
    rng.integers(1)
    conditions = Conditions.draw(rng)
    teacher = Demonstrator(
        plan.grasp,
        None,
        share=1.0,
        noise=0.0,
        rng=np.random.default_rng(0),
        max_normal=ASKED_SHARE * force_limit(plan),
    )
    run = conditions.run(task, plan, teacher)
    teacher.simulation = run.sim.simulation
    report = run.perform()
    env.reset(seed=11)
    info: dict[str, Any] = {}
    rewards, ended = [], False
    for action in teacher.wanted:
        assert not ended
        _, reward, ended, _, info = env.step(action)
        rewards.append(reward)
    assert ended
    assert info["turned_deg"] == math.degrees(report.turned)  # bit for bit
    assert info["success"] == report.success_with_closure
    assert info["reason"] == (report.reason or report.faults)
    assert report.success_with_closure, report  # a teacher that fails would show less
    assert sum(rewards) == pytest.approx(2.0)
    assert rewards[-1] == 1.0


@pytest.mark.slow
def test_doing_nothing_in_mode_increment_fails_and_is_told_why(folder: Path) -> None:
    env = make(folder, action="increment", rate_hz=20.0)
    first, _ = env.reset(seed=1)
    info: dict[str, Any] = {}
    total, ended = 0.0, False
    while not ended:
        told, reward, ended, _, info = env.step(np.zeros(env.action_space.shape))
        np.testing.assert_array_equal(told["targets"], first["targets"])
        total += reward
    assert not info["success"] and info["reason"]
    assert total < 0.5


def test_an_absolute_action_is_a_share_of_the_range(folder: Path) -> None:
    env = make(folder, action="absolute")
    env.reset(seed=1)
    low, high = env._plans.hand.actuation.ctrl_range.T
    told, *_ = env.step(np.full(env.action_space.shape, -0.5))
    np.testing.assert_allclose(told["targets"], low + 0.25 * (high - low), rtol=1e-6)
    env.close()


def test_the_camera_is_seen_only_where_it_is_asked_for(env: TurnEnv, folder: Path) -> None:
    assert set(env.observation_space.spaces) == {"joints", "targets", "touch", "clock", "plan"}
    seeing = make(folder, senses=["object_pose"])
    told, _ = seeing.reset(seed=2)
    pose = told["object_pose"]
    assert np.linalg.norm(pose[3:]) == pytest.approx(1.0, abs=1e-5)
    assert 0.03 < np.linalg.norm(pose[:3]) < 0.3  # in reach of the fingers
    seeing.close()


@pytest.mark.filterwarnings("ignore")
def test_it_is_registered_and_makes_vectors(folder: Path) -> None:
    several = gymnasium.make_vec(
        ENVIRONMENT,
        num_envs=2,
        vectorization_mode="sync",
        objects=OBJECT,
        angle_deg=ANGLE_DEG,
        plans=1,
        folder=folder,
    )
    told, _ = several.reset(seed=[3, 4])
    assert told["joints"].shape == (2, 16)
    assert not np.array_equal(told["joints"][0], told["joints"][1])
    _, rewards, ended, _, _ = several.step(np.zeros(several.action_space.shape))
    assert rewards.shape == (2,) and not ended.any()
    several.close()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"action": "torque"}, "no meaning of an action is called 'torque'"),
        ({"senses": ["sound"]}, "no sense of the environment is called 'sound'"),
        ({"plans": 0}, "plans is 0; give an integer >= 1"),
        ({"plans": 1.5}, "plans is 1.5; give an integer >= 1"),
        ({"senses": "object_pose"}, r"give a list of names: \['object_pose'\]"),
        ({"rate_hz": 0.0}, "rate_hz is 0.0; give"),
        ({"angle_deg": 0.0}, "the turn is 0 degrees"),
        ({"error_model": "moon"}, "no error model is called 'moon'"),
        ({"objects": "cylinder:0.04..0.03x0.1"}, "ends below its beginning"),
    ],
)
def test_faults_are_told(wrong: dict[str, Any], message: str) -> None:
    from planner.errors import PlannerError

    with pytest.raises(PlannerError, match=message):
        TurnEnv(**wrong)


def test_steps_that_cannot_be_are_refused(env: TurnEnv) -> None:
    with pytest.raises(TaskError, match="call reset first"):
        env.step(np.zeros(16))
    env.reset(seed=1)
    with pytest.raises(TaskError, match=r"shape \(3,\); give one of shape \(16,\)"):
        env.step(np.zeros(3))
    with pytest.raises(TaskError, match="not finite"):
        env.step(np.full(16, np.nan))
    for options in ({"plan": -1}, {"plan": 1.5}, {"plan": "first"}, {"plans": 3}):
        with pytest.raises(TaskError, match="option"):
            env.reset(seed=1, options=options)
    with pytest.raises((TaskError, NotFoundError)):
        TurnEnv(hand="foot")
