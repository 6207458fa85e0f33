"""Practice, on a line that is walked along in this process; over the network, see the tests of runs and remote envs."""

import json
from collections.abc import Mapping, Sequence

import numpy as np
import pytest

from freerein_orchestrator.envs.practice import MOST_STARTS, STEPS_BETWEEN, PractisingEnvs, Start, before_reward
from freerein_orchestrator.rl.vec_env import Actions, Observations, Rewards, VecStep

STEPS = 2 * STEPS_BETWEEN
GOAL, LENGTH = 12, 20


class LineEnvs:
    """A walker on a line goes by one place a step; from `GOAL` on it is rewarded. Episodes have `LENGTH` steps."""

    def __init__(self, num_envs: int) -> None:
        self.num_envs = num_envs
        self.places, self.ages = np.zeros((2, num_envs), np.int64)
        self._rewards: list[Rewards] = []

    def reset(self) -> Observations:
        self.places[:] = self.ages[:] = 0
        return self._seen()

    def step(self, actions: Actions) -> VecStep:
        self.places += np.sign(actions[:, 0]).astype(np.int64)
        self.ages += 1
        self._rewards.append((self.places >= GOAL).astype(np.float32))
        truncated, final = self.ages >= LENGTH, self._seen()
        self.places[truncated] = self.ages[truncated] = 0
        return VecStep(self._seen(), np.zeros(self.num_envs, np.bool_), truncated, final)

    def rewards(self) -> Rewards:
        rewards, self._rewards = np.stack(self._rewards), []
        return rewards

    def snapshots(self) -> tuple[bytes, ...]:
        return (json.dumps([self.places.tolist(), self.ages.tolist()]).encode(),)

    def states(self) -> Sequence[Start]:
        return [Start(self.snapshots()[0], env) for env in range(self.num_envs)]

    def begin_at(self, starts: Mapping[int, Start]) -> Observations:
        for env, start in starts.items():
            self.places[env], self.ages[env] = (each[start.env] for each in json.loads(start.snapshot))
        return self._seen()

    def close(self) -> None:
        """Holds nothing."""

    def _seen(self) -> Observations:
        return self.places[:, None].astype(np.float32)


def practise(envs: LineEnvs, share: float = 1.0, memory: bytes | None = None) -> PractisingEnvs:
    return PractisingEnvs(envs, share=share, num_steps=STEPS, memory=memory, seed=(0, 1))


def walk(envs: PractisingEnvs, direction: float = 1.0) -> VecStep:
    """Walks for a rollout; returns its last step."""
    steps = [envs.step(np.full((envs.num_envs, 1), direction, np.float32)) for _ in range(STEPS)]
    envs.rewards()
    return steps[-1]


def test_a_state_is_on_the_way_until_its_episode_is_rewarded() -> None:
    rewarded = np.array([[0, 0], [1, 0], [0, 0], [0, 1], [0, 0]], np.bool_)
    dones = np.array([[0, 0], [0, 0], [0, 1], [0, 0], [0, 0]], np.bool_)
    expected = np.array([[1, 0], [0, 0], [0, 0], [0, 0], [0, 0]], np.bool_)
    np.testing.assert_array_equal(before_reward(rewarded, dones), expected)


def test_a_rollout_begins_at_states_from_which_earlier_episodes_were_rewarded() -> None:
    line = LineEnvs(8)
    envs = practise(line)
    envs.reset()
    last = walk(envs)  # there is no start yet
    assert not last.truncated.any()
    np.testing.assert_array_equal(last.observations, np.full((8, 1), STEPS))

    last = walk(envs)  # each episode ends at LENGTH, and another one is under way
    assert last.truncated.all()
    assert set(last.observations[:, 0].tolist()) == {1, 1 + STEPS_BETWEEN}  # those that rewarded steps led to are not
    assert last.given_up is not None
    assert last.given_up.all()
    np.testing.assert_array_equal(last.final_observations, np.full((8, 1), 2 * STEPS - LENGTH))
    np.testing.assert_array_equal(line.places, last.observations[:, 0])
    np.testing.assert_array_equal(line.ages, line.places)  # an episode goes on with the steps that it has left


def test_no_episode_begins_in_a_state_that_is_rewarded_itself() -> None:
    line = LineEnvs(8)
    envs = practise(line)
    envs.reset()
    line.places[:] = GOAL - STEPS_BETWEEN
    for direction in (*[1] * STEPS_BETWEEN, -1, *[1] * (STEPS_BETWEEN - 1)):  # to the goal, back, and again
        envs.step(np.full((8, 1), direction, np.float32))
    envs.rewards()
    assert set(walk(envs).observations[:, 0].tolist()) == {GOAL - STEPS_BETWEEN + 1, GOAL - 1}


def test_an_episode_that_ends_as_another_begins_at_a_start_is_not_given_up() -> None:
    line = LineEnvs(8)
    envs = practise(line)
    envs.reset()
    walk(envs)
    line.ages[:4] = LENGTH - STEPS
    last = walk(envs)
    assert last.truncated.all()
    assert last.given_up is not None
    assert last.given_up.tolist() == [False] * 4 + [True] * 4


def test_episodes_without_a_reward_give_no_starts() -> None:
    envs = practise(LineEnvs(8))
    envs.reset()
    assert not [walk(envs, -1.0).truncated.any() for _ in range(3)][-1]


@pytest.mark.parametrize("share", [0.25, 0.75])
def test_so_many_environments_practise(share: float) -> None:
    envs = practise(LineEnvs(1000), share)
    envs.reset()
    walk(envs)
    assert np.mean(walk(envs).truncated) == pytest.approx(share, abs=0.05)


def test_what_snapshots_hold_goes_on_with_the_same_draws() -> None:
    line = LineEnvs(16)
    envs = practise(line, 0.5)
    envs.reset()
    walk(envs)
    snapshot, memory = envs.snapshots()
    resumed_line = LineEnvs(16)
    resumed_line.begin_at({env: Start(snapshot, env) for env in range(16)})
    resumed = practise(resumed_line, 0.5, memory)
    for _ in range(3):
        expected, step = walk(envs), walk(resumed)
        np.testing.assert_array_equal(step.observations, expected.observations)
        np.testing.assert_array_equal(step.truncated, expected.truncated)
        assert resumed.snapshots() == envs.snapshots()


def test_the_newest_starts_are_kept() -> None:
    envs = practise(LineEnvs(MOST_STARTS))
    envs.reset()
    walk(envs)
    _, memory = envs.snapshots()
    header = json.loads(memory[8 : 8 + int.from_bytes(memory[:8])])
    assert header["starts"] == [[0, env] for env in range(MOST_STARTS)]
    assert [json.loads(each)[0][0] for each in (memory[-header["lengths"][0] :],)] == [1 + STEPS_BETWEEN]
