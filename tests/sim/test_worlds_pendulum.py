"""The pendulum beside Gymnasium's own environment."""

import sys
from collections.abc import Iterator
from contextlib import closing
from types import ModuleType

import numpy as np
import pytest

from freerein_sim.worlds import pendulum
from freerein_sim.worlds.pendulum import PendulumWorld

gymnasium = pytest.importorskip("gymnasium")
TASK = pendulum.TASKS[0]
SEEDS = 5


@pytest.fixture
def world() -> Iterator[PendulumWorld]:
    with closing(TASK.make()) as made:
        assert isinstance(made, PendulumWorld)
        yield made


def test_every_step_is_gymnasium_s(world: PendulumWorld, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "imageio", ModuleType("imageio"))  # Gymnasium's renderer alone needs it
    env = gymnasium.make("InvertedDoublePendulum-v5")
    assert (env.spec.max_episode_steps, env.unwrapped.dt) == (TASK.spec.max_episode_steps, TASK.spec.control_dt_s)
    steps = 0
    for seed in range(SEEDS):
        env.reset(seed=seed)
        world.reset(np.random.default_rng(seed))
        data, terminated = env.unwrapped.data, False
        np.testing.assert_array_equal(world.truth().state, np.concatenate([data.qpos, data.qvel]))
        rng = np.random.default_rng(seed)
        while not terminated:
            action = rng.uniform(-1, 1, size=1).astype(np.float32)
            _, reward, terminated, _, _ = env.step(action)
            assert world.step(action).terminated == terminated
            np.testing.assert_array_equal(world.truth().state, np.concatenate([data.qpos, data.qvel]))
            assert world.truth().reward == reward
            steps += 1
    assert steps > SEEDS
    env.close()


def test_the_camera_sees_the_poles(world: PendulumWorld) -> None:
    world.reset(np.random.default_rng(0))
    image = world.render("front", height=84, width=84).astype(int)
    poles = (image[..., 1] > 2 * image[..., 0] + 20) & (image[..., 2] > 2 * image[..., 0] + 20)  # they are cyan
    rows, columns = np.nonzero(poles)
    assert 0.01 < poles.mean() < 0.2
    assert rows.max() - rows.min() > 20
    assert 30 < columns.mean() < 54


def test_a_restored_pendulum_has_a_reward_and_can_fall(world: PendulumWorld) -> None:
    world.reset(np.random.default_rng(0))
    snapshot, push = world.snapshot(), np.ones(1, np.float32)
    while not world.step(push).terminated:
        pass
    assert world.truth().reward < 0
    world.restore(snapshot)
    assert world.truth().reward > 8
    assert not world.truth().success
