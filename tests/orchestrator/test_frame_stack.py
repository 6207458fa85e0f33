"""Stacks of frames: what an observation is made of, wherever it is collected."""

from typing import Any

import numpy as np
import pytest
import torch

from freerein.errors import InvalidInput
from freerein.learning.actor_critic.frame_stack import luma, stack_frames
from freerein.learning.actor_critic.networks import ActorCritic, ActorCriticSpec
from freerein_orchestrator.rl.initial_network import calibrate, init_network
from freerein_orchestrator.rl.network_policy import NetworkPolicy
from freerein_orchestrator.rl.rollout import CollectorState, collect
from freerein_orchestrator.rl.vec_env import Actions, Observations, Rewards, VecStep
from freerein_sim.worlds.rendering import gray

SIDE, LENGTHS = 8, np.array([3, 5])


class CountingEnvs:
    """Frames show 10 times the episode and the timestep in it; episodes of two lengths are truncated."""

    num_envs = 2

    def __init__(self) -> None:
        self._episodes, self._t = np.zeros(2, np.int64), np.zeros(2, np.int64)
        self._steps = 0

    def reset(self) -> Observations:
        self._episodes, self._t = self._episodes + 1, np.zeros(2, np.int64)
        return self._frames()

    def step(self, actions: Actions) -> VecStep:
        self._t, self._steps = self._t + 1, self._steps + 1
        final, done = self._frames(), self._t == LENGTHS
        self._episodes, self._t = self._episodes + done, self._t * ~done
        return VecStep(self._frames(), np.zeros(2, np.bool_), done, final)

    def rewards(self) -> Rewards:
        steps, self._steps = self._steps, 0
        return np.zeros((steps, 2), np.float32)

    def snapshots(self) -> tuple[bytes, ...]:
        return ()

    def _frames(self) -> Observations:
        shown = (10 * self._episodes + self._t).astype(np.uint8)
        return np.broadcast_to(shown[:, None, None, None], (2, SIDE, SIDE, 1)).copy()


def network(**changes: Any) -> ActorCritic:
    sizes = {"height": SIDE, "width": SIDE, "channels": 1, "feature_size": 8, "hidden_size": 8}
    return init_network(ActorCriticSpec(**{**sizes, **changes}), torch.Generator().manual_seed(0))


def test_an_observation_is_the_last_frames_of_its_episode_whose_first_stands_for_those_before_it() -> None:
    envs, policy = CountingEnvs(), network(frame_stack=3)
    first = CollectorState.init(envs, policy, torch.Generator())
    rollout, between = collect(policy, envs, first, num_steps=4)
    rest, after = collect(policy, envs, between, num_steps=2)
    seen = torch.cat([rollout.observations, rest.observations, after.observations[None]])[:, 0, 0, 0]
    assert seen.tolist() == [
        [10, 10, 10],
        [10, 10, 11],
        [10, 11, 12],
        *[[20, 20, 20], [20, 20, 21], [20, 21, 22]],
        [30] * 3,
    ]
    assert rollout.final_observations[:, 0, 0].tolist() == [[11, 12, 13]]
    assert rollout.next_observations[2, 0, 0, 0].tolist() == [11, 12, 13]
    assert rest.last_observations[1, 0, 0].tolist() == [20, 20, 21]


@pytest.mark.parametrize("changes", [{}, {"frame_stack": 3}])
def test_one_that_acts_sees_what_the_collector_saw_and_encoders_are_calibrated_on_it(changes: dict[str, int]) -> None:
    envs, policy = CountingEnvs(), network(**changes)
    calibrate(policy, envs, torch.Generator().manual_seed(0))
    assert policy.image is not None
    assert len(policy.image.mean_image) == changes.get("frame_stack", 1)
    rollout, _ = collect(policy, envs, CollectorState.init(envs, policy, torch.Generator()), num_steps=6)
    acting, seen = NetworkPolicy(policy), rollout.observations[..., -1:].numpy()
    actions = [acting.act(frames, starts.numpy()) for frames, starts in zip(seen, rollout.episode_starts, strict=True)]
    with torch.no_grad():
        expected = policy(rollout.observations, rollout.episode_starts, torch.zeros(2, 0)).actions.mode()
    np.testing.assert_allclose(np.stack(actions), expected.clamp(-1, 1), atol=1e-7)


def test_cameras_lie_side_by_side_and_gray_is_the_simulators() -> None:
    frames = torch.randint(256, (5, SIDE, SIDE, 6), dtype=torch.uint8, generator=torch.Generator().manual_seed(0))
    first, second = frames.numpy()[0, ..., :3], frames.numpy()[0, ..., 3:]
    np.testing.assert_array_equal(luma(frames)[0], np.concatenate([gray(first), gray(second)], axis=-1))
    two = network(channels=3, cameras=2, gray=True, frame_stack=2)
    assert (two.spec.input_shape, two.spec.observation_shape) == ((SIDE, SIDE, 6), (SIDE, SIDE, 4))
    starts, nothing = torch.tensor([True] * 5), torch.zeros(5, SIDE, SIDE, 2, dtype=torch.uint8)
    observed = two.observe(frames, torch.zeros(5, 1), nothing, starts)
    assert torch.equal(observed, torch.cat([luma(frames)] * 2, dim=-1))
    assert stack_frames(frames, frames[..., :0], starts) is frames


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"frame_stack": 3, "channels": 3, "height": 128, "width": 128}, "The 2 earlier frames .* 65536 bytes"),
        ({"frame_stack": 2, "vector_size": 3}, "a stack of 2 vectors"),
    ],
)
def test_a_stack_that_cannot_be_served_is_refused(changes: dict[str, int], says: str) -> None:
    with pytest.raises(InvalidInput, match=says) as refused:
        network(**changes)
    assert refused.value.field == "config.frame_stack"
