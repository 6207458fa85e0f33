"""Stable-Baselines3's interface over a vector environment is what its own vectors of environments are."""

from collections.abc import Callable
from copy import deepcopy
from typing import Any, ClassVar

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import RecordEpisodeStatistics
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from freerein.envs.sb3 import SB3VecEnv
from freerein.errors import InvalidInput

FRAME = spaces.Box(0, 255, (4, 4, 3), np.uint8)


class Walk(gymnasium.Env[Any, Any]):
    """A random walk that terminates at 3 and is truncated after 5 steps."""

    metadata: ClassVar = {"render_modes": ["rgb_array"]}
    action_space = spaces.Box(-1, 1, (1,))
    render_mode = "rgb_array"

    def __init__(self, *, is_dict: bool) -> None:
        self.observation_space = spaces.Dict({"front": FRAME, "left": FRAME}) if is_dict else FRAME

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.place, self.steps = int(self.np_random.integers(2)), 0
        return self.observe(), {"begun_at": self.place}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.place += int(self.np_random.integers(2)) + int(action[0] > 0)
        self.steps += 1
        return self.observe(), float(action[0]), self.place >= 3, self.steps == 5, {"place": self.place}

    def observe(self) -> Any:
        frame = np.full(FRAME.shape, self.place, np.uint8)
        return {"front": frame, "left": frame + 1} if isinstance(self.observation_space, spaces.Dict) else frame

    def render(self) -> Any:
        return np.full(FRAME.shape, self.place, np.uint8)


def same_step(make: Callable[[], Walk], count: int) -> SyncVectorEnv[Any, Any]:
    return SyncVectorEnv([make] * count, autoreset_mode=AutoresetMode.SAME_STEP)


@pytest.mark.parametrize("is_dict", [False, True], ids=["frame", "dict"])
def test_a_vector_is_what_stable_baselines_makes_of_its_environments(is_dict: bool) -> None:
    ours = SB3VecEnv(same_step(lambda: Walk(is_dict=is_dict), 3))
    theirs = DummyVecEnv([lambda: Walk(is_dict=is_dict)] * 3)
    assert (ours.observation_space, ours.action_space) == (theirs.observation_space, theirs.action_space)
    assert ours.seed(7) == theirs.seed(7)
    np.testing.assert_equal(ours.reset(), theirs.reset())
    assert ours.reset_infos == theirs.reset_infos
    rng = np.random.default_rng(0)
    ended, cut = 0, 0
    for _ in range(40):
        actions = rng.uniform(-1, 1, (3, 1)).astype(np.float32)
        (*got, infos), (*expected, expected_infos) = ours.step(actions), theirs.step(actions)
        np.testing.assert_equal(got, expected)
        np.testing.assert_equal(ours.reset_infos, theirs.reset_infos)
        assert got[1].dtype == expected[1].dtype
        for info, other in zip(infos, expected_infos, strict=True):
            assert {
                "begun_at"
            } >= info.keys() - other.keys()  # of the next episode, which theirs only has in reset_infos
            np.testing.assert_equal({key: info[key] for key in other}, other)
            ended += "terminal_observation" in info
            cut += info["TimeLimit.truncated"]
    assert ended > cut > 0
    np.testing.assert_array_equal(ours.render(), theirs.render())
    ours.close()
    theirs.close()


@pytest.mark.parametrize("is_dict", [False, True], ids=["frame", "dict"])
def test_what_normalises_observations_changes_a_space_of_its_own(is_dict: bool) -> None:
    envs = same_step(lambda: Walk(is_dict=is_dict), 2)
    before = deepcopy(envs.single_observation_space)
    ours = SB3VecEnv(envs)
    VecNormalize(ours, norm_obs_keys=["front", "left"] if is_dict else None)
    assert envs.single_observation_space == before
    assert ours.observation_space is not envs.single_observation_space


@pytest.mark.parametrize("is_dict", [False, True], ids=["frame", "dict"])
def test_small_frames_are_enlarged_on_request(is_dict: bool) -> None:
    plain, ours = (same_step(lambda: Walk(is_dict=is_dict), 2) for _ in range(2))
    large = SB3VecEnv(ours, render_size=36)
    first, _ = plain.reset(seed=3)
    large.seed(3)
    for seen, expected in [(large.reset(), first)]:
        for name in ("front", "left") if is_dict else (...,):
            np.testing.assert_array_equal(seen[name], expected[name].repeat(9, axis=1).repeat(9, axis=2))
    infos = [info for _ in range(5) for info in large.step(np.zeros((2, 1), np.float32))[-1]]
    last = next(info["terminal_observation"] for info in infos if "terminal_observation" in info)
    assert large.observation_space.contains(last)


def test_frames_without_a_channel_axis_stay_as_their_space_says() -> None:
    class Gray(Walk):
        def observe(self) -> Any:
            return super().observe()[..., 0]

    def gray() -> Gray:
        env = Gray(is_dict=False)
        env.observation_space = spaces.Box(0, 255, FRAME.shape[:2], np.uint8)
        return env

    envs = SB3VecEnv(same_step(gray, 4), render_size=36)
    assert envs.reset().shape == (4, *envs.observation_space.shape) == (4, 4, 4)


def test_cnn_policy_takes_enlarged_frames() -> None:
    envs, small = SB3VecEnv(same_step(lambda: Walk(is_dict=False), 2), render_size=36), {"features_dim": 8}
    PPO("CnnPolicy", envs, n_steps=2, batch_size=4, policy_kwargs={"features_extractor_kwargs": small})


def test_statistics_of_gymnasiums_wrapper_reach_the_learner() -> None:
    envs = SB3VecEnv(RecordEpisodeStatistics(same_step(lambda: Walk(is_dict=False), 2)))
    envs.reset()
    infos = [info for _ in range(5) for info in envs.step(np.zeros((2, 1), np.float32))[-1]]
    assert all(("episode" in info) == ("terminal_observation" in info) for info in infos)
    assert any("episode" in info for info in infos)


def test_what_single_environments_have_a_vector_lacks() -> None:
    envs = SB3VecEnv(same_step(lambda: Walk(is_dict=False), 2))
    assert envs.get_attr("render_mode") == ["rgb_array"] * 2
    assert not envs.has_attr("landlord")
    with pytest.raises(NotImplementedError, match="no single one"):
        envs.env_method("render")
    with pytest.raises(InvalidInput, match="SAME_STEP"):
        SB3VecEnv(SyncVectorEnv([lambda: Walk(is_dict=False)]))
