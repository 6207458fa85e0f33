"""Vectorised envs over the network, with the real sim and reward services."""

import itertools
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import pytest
import torch

from freerein.clients import Channel, RewardClient, SimClient, SyncClient
from freerein.errors import FailedPrecondition, InvalidInput
from freerein.types.common import Camera, ModelRef
from freerein.types.reward import Mode, RewardRequest
from freerein.types.sim import CreateSessionRequest, StepResponse
from freerein_orchestrator.envs.vector_env import RemoteVectorEnv, RewardFn, envs_per_sim
from freerein_orchestrator.rewards.learned import LearnedReward
from freerein_orchestrator.rewards.oracle import OracleReward
from freerein_orchestrator.rl.config import PPOConfig
from freerein_orchestrator.rl.errors import IterationRejected, Stopped
from freerein_orchestrator.rl.initial_network import network_spec
from freerein_orchestrator.rl.reward import Reward
from freerein_orchestrator.rl.rollout import CollectorState, RolloutBuffer, collect
from freerein_orchestrator.rl.state import PPOState, init_state
from freerein_orchestrator.rl.vec_env import CameraFrames, Rewards, VecStep, moments

pytestmark = pytest.mark.e2e
zero_reward, oracle_reward = Reward().of_frames, OracleReward().of_frames
CPU = torch.device("cpu")
TASK, CAMERA, GOAL = "blocks.red-on-top-of-yellow", "front", "a red block on top of a yellow block"
FAST = PPOConfig(iterations=2, num_envs=3, num_steps=8, epochs=1, batch_size=8, hidden_size=8, feature_size=8)


@pytest.fixture(scope="module")
def sim(start_module_service: Callable[..., Any], wait_until: Callable[..., float]) -> Iterator[SyncClient]:
    service = start_module_service("freerein_sim", FREEREIN_SIM_WORKERS="1")
    wait_until(service.is_ready, 300)
    with SyncClient(SimClient(Channel(service.address))) as sim:
        yield sim


@pytest.fixture(scope="module")
def reward(start_module_service: Callable[..., Any]) -> Iterator[SyncClient]:
    with SyncClient(RewardClient(Channel(start_module_service("freerein_reward").address))) as reward:
        yield reward


def open_envs(
    *sims: SyncClient,
    reward_fn: RewardFn,
    privileged: bool = False,
    action_repeat: int = 1,
    max_episode_steps: int = 0,
    snapshots: Sequence[bytes] = (),
) -> RemoteVectorEnv:
    request = CreateSessionRequest(TASK, num_envs=3, seed=3, privileged=privileged, max_episode_steps=max_episode_steps)
    return RemoteVectorEnv(
        sims,
        request,
        cameras=(CAMERA,),
        reward_fn=reward_fn,
        action_repeat=action_repeat,
        snapshots=snapshots,
    )


def draw_actions(rng: np.random.Generator) -> Any:
    return rng.uniform(-1, 1, (3, 3)).astype(np.float32)


def test_the_frames_that_actions_led_to_are_rewarded_also_where_an_episode_ended(
    sim: SyncClient, reward: SyncClient
) -> None:
    envs = open_envs(sim, reward_fn=LearnedReward(reward, GOAL).of_frames)
    envs.reset()
    rng, steps = np.random.default_rng(0), list[VecStep]()
    while not steps or not (steps[-1].terminated | steps[-1].truncated).any():
        steps.append(envs.step(draw_actions(rng)))
    frames = np.concatenate([step.final_observations for step in steps])
    expected = reward.reward(RewardRequest(GOAL, {CAMERA: frames})).rewards
    np.testing.assert_array_equal(envs.rewards(), expected.reshape(-1, 3))
    over = steps[-1].terminated | steps[-1].truncated
    assert not np.array_equal(steps[-1].final_observations[over], steps[-1].observations[over])
    envs.close()


def test_a_held_action_leads_where_single_ones_do_and_ends_with_its_episode(sim: SyncClient) -> None:
    def count(frames: CameraFrames, _oracle: Rewards | None) -> Rewards:
        return np.ones(moments(frames), np.float32)

    single, held = (open_envs(sim, reward_fn=count, action_repeat=each, max_episode_steps=10) for each in (1, 3))
    np.testing.assert_array_equal(single.reset(), held.reset())
    rng = np.random.default_rng(0)
    for timesteps in (3, 3, 3, 1) * 3:
        actions = draw_actions(rng)
        last, whole = [single.step(actions) for _ in range(timesteps)][-1], held.step(actions)
        for name, values in vars(last).items():
            np.testing.assert_array_equal(getattr(whole, name), values, name)
        assert whole.truncated.tolist() == [timesteps == 1] * 3
    assert held.rewards().shape == (12, 3)
    for envs in (single, held):
        envs.close()


def test_episodes_are_truncated_also_after_sessions_were_restored(sim: SyncClient) -> None:
    still = np.zeros((3, 3), np.float32)
    first = open_envs(sim, reward_fn=zero_reward, action_repeat=2, max_episode_steps=6)
    first.reset()
    begun, snapshots = first.step(still), tuple(first.snapshots())
    again = open_envs(sim, reward_fn=zero_reward, action_repeat=2, max_episode_steps=6, snapshots=snapshots)
    for envs in (first, again):
        steps = [begun, *(envs.step(still) for _ in range(4))]
        assert [step.truncated.tolist() for step in steps] == [[at % 3 == 2] * 3 for at in range(5)]
        assert not any(step.terminated.any() for step in steps)
        assert not np.array_equal(steps[2].observations, steps[2].final_observations)
        np.testing.assert_array_equal(steps[1].observations, steps[1].final_observations)
        envs.close()


def test_the_same_frames_are_always_rewarded_together(sim: SyncClient) -> None:
    sizes: list[int] = []

    def reward_fn(frames: CameraFrames, _oracle: Rewards | None) -> Rewards:
        sizes.append(moments(frames))
        return np.zeros(moments(frames), np.float32)

    envs = open_envs(sim, reward_fn=reward_fn)
    envs.reset()
    for _ in range(2):
        for _ in range(25):
            envs.step(np.zeros((3, 3), np.float32))
        assert envs.rewards().shape == (25, 3)
    assert sizes == [30, 30, 15, 30, 30, 15]
    envs.close()


def test_an_unprivileged_session_returns_frames_and_nothing_else(sim: SyncClient, reward: SyncClient) -> None:
    oracles: list[Rewards | None] = []
    replies: list[StepResponse] = []

    def reward_fn(frames: CameraFrames, oracle: Rewards | None) -> Rewards:
        oracles.append(oracle)
        return LearnedReward(reward, GOAL).of_frames(frames, oracle)

    class Overheard:
        """The service, overheard."""

        def __getattr__(self, name: str) -> Callable[..., Any]:
            def call(request: Any, **kwargs: Any) -> Any:
                reply = getattr(sim, name)(request, **kwargs)
                replies.append(reply)
                return reply

            return call

    envs = open_envs(Overheard(), reward_fn=reward_fn)  # type: ignore[arg-type]  # as good as the service
    envs.reset()
    envs.step(np.zeros((3, 3), np.float32))
    envs.rewards()
    envs.close()
    assert oracles == [None]
    assert {getattr(reply, "truth", None) for reply in replies} == {None}
    assert [reply.reward.tolist() for reply in replies if isinstance(reply, StepResponse)] == [[0.0] * 3]


def test_the_oracle_needs_a_privileged_session(sim: SyncClient) -> None:
    still = np.zeros((3, 3), np.float32)
    privileged, plain = (
        open_envs(sim, reward_fn=oracle_reward, privileged=True),
        open_envs(sim, reward_fn=oracle_reward),
    )
    for envs in (privileged, plain):
        envs.reset()
        envs.step(still)
    assert privileged.rewards().shape == (1, 3)
    with pytest.raises(FailedPrecondition, match="privileged"):
        plain.rewards()
    for envs in (privileged, plain):
        envs.close()


def test_envs_split_over_two_sims_are_as_many_and_differ(sim: SyncClient) -> None:
    envs = open_envs(sim, sim, reward_fn=oracle_reward, privileged=True)
    frames = envs.reset()
    assert envs_per_sim(3, 2) == (2, 1)
    assert len({frame.tobytes() for frame in frames}) == 3
    step = envs.step(draw_actions(np.random.default_rng(0)))
    assert step.observations.shape == (3, 64, 64, 3)
    assert envs.rewards().shape == (1, 3)
    snapshots = envs.snapshots()
    expected = envs.step(np.ones((3, 3), np.float32)).observations
    again = open_envs(sim, sim, reward_fn=oracle_reward, privileged=True, snapshots=snapshots)
    np.testing.assert_array_equal(again.step(np.ones((3, 3), np.float32)).observations, expected)
    for each in (envs, again):
        each.close()


def test_single_envs_are_set_to_earlier_states_of_any_env(sim: SyncClient) -> None:
    envs = open_envs(sim, sim, reward_fn=zero_reward)
    envs.reset()
    rng = np.random.default_rng(0)
    passed = [envs.step(draw_actions(rng)).observations for _ in range(4)][-1]
    states = envs.states()
    now = envs.step(draw_actions(rng)).observations
    assert not np.array_equal(passed, now)
    frames = envs.begin_at({0: states[2], 2: states[1]})
    np.testing.assert_array_equal(frames, [passed[2], now[1], passed[1]])
    following = envs.step(np.zeros((3, 3), np.float32)).observations
    envs.begin_at({1: states[2]})
    again = envs.step(np.zeros((3, 3), np.float32)).observations
    np.testing.assert_array_equal(again[1], following[0])


def test_sessions_of_sims_that_hang_are_left_to_their_leases_at_once(
    start_service: Callable[..., Any], wait_until: Callable[..., float], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("freerein_orchestrator.envs.vector_env._CLOSE_TIMEOUT_S", 1.0)
    service = start_service("freerein_sim", FREEREIN_SIM_WORKERS="1")
    wait_until(service.is_ready, 300)
    with SyncClient(SimClient(Channel(service.address))) as sim:
        request = CreateSessionRequest(TASK, num_envs=16, seed=3)
        envs = RemoteVectorEnv([sim] * 16, request, cameras=(CAMERA,), reward_fn=zero_reward)
        service.process.send_signal(signal.SIGSTOP)
        begun = time.monotonic()
        envs.close()
        took_s = time.monotonic() - begun
        service.process.send_signal(signal.SIGCONT)
    assert took_s < 10  # one after another, 16 s


def test_malformed_rewards_are_rejected(sim: SyncClient) -> None:
    whole = open_envs(sim, reward_fn=zero_reward)
    state = init(whole)
    envs = open_envs(sim, reward_fn=lambda *_: np.zeros(2, np.float32), snapshots=state.collector.env_snapshots)
    with pytest.raises(IterationRejected, match="Rewards must be"):
        collect(state.network, envs, state.collector, num_steps=FAST.num_steps)
    for each in (whole, envs):
        each.close()


@pytest.mark.parametrize(
    ("mode", "possible", "garbage"),
    [("binary", [0, 1, 1], [0, 0.5, 1]), ("raw", [-1, 0.3, 1], [0, 1e30, 0]), ("raw", [0, 0, 0], [0, np.nan, 0])],
)
def test_a_learned_reward_outside_its_mode_is_rejected(mode: Mode, possible: list[float], garbage: list[float]) -> None:
    class Service:
        """A reward service that answers what it was told."""

        def __init__(self, rewards: list[float]) -> None:
            self.rewards = np.array(rewards, np.float32)

        def reward(self, _request: RewardRequest) -> "Service":
            return self

    def call(rewards: list[float]) -> Rewards:
        service: Any = Service(rewards)
        return LearnedReward(service, GOAL, mode=mode).of_frames({CAMERA: np.zeros((3, 4, 4, 3), np.uint8)})

    np.testing.assert_array_equal(call(possible), np.array(possible, np.float32))
    with pytest.raises(IterationRejected, match=f"mode {mode} must be"):
        call(garbage)


def test_the_reward_model_is_pinned_and_what_it_cannot_reward_refused_at_once(reward: SyncClient) -> None:
    camera = Camera(CAMERA, 64, 64, 3)
    model = LearnedReward(reward, GOAL).resolve((camera,)).model
    assert len(model.version) == 12
    assert LearnedReward(reward, GOAL, model).resolve((camera,)).model == model
    one = LearnedReward(reward, GOAL, model).of_frames({CAMERA: np.zeros((1, 64, 64, 3), np.uint8)})
    assert one.shape == (1,)
    with pytest.raises(InvalidInput, match="rivals"):
        LearnedReward(reward, "a red block").resolve((camera,))
    with pytest.raises(InvalidInput, match="does not know crimson, amber"):
        LearnedReward(reward, "the crimson block is on the amber one").resolve((camera,))
    with pytest.raises(InvalidInput, match="does not know blok") as error:
        LearnedReward(reward, GOAL.replace("block", "blok")).resolve((camera,))
    assert error.value.hint == f"Did you mean: {GOAL}?"
    with pytest.raises(FailedPrecondition, match="active model"):
        LearnedReward(reward, GOAL, ModelRef("another")).resolve((camera,))


def init(envs: RemoteVectorEnv) -> PPOState:
    return init_state(FAST, network_spec(FAST, observation=(64, 64, 3), action_size=3), envs, device=CPU)


def test_a_rollout_is_collected_in_another_session_to_the_same_bits(sim: SyncClient, reward: SyncClient) -> None:
    reward_fn = LearnedReward(reward, GOAL).of_frames
    envs = open_envs(sim, reward_fn=reward_fn)
    state = init(envs)

    def both(envs: RemoteVectorEnv, start: CollectorState) -> list[tuple[RolloutBuffer, CollectorState]]:
        first = collect(state.network, envs, start, num_steps=FAST.num_steps)
        return [first, collect(state.network, envs, first[1], num_steps=FAST.num_steps)]

    others = open_envs(sim, reward_fn=reward_fn, snapshots=state.collector.env_snapshots)
    for (ours, after), (theirs, theirs_after) in zip(
        both(envs, state.collector), both(others, state.collector), strict=True
    ):
        for name, tensor in vars(ours).items():
            assert torch.equal(tensor, vars(theirs)[name]), name
        assert after.env_snapshots == theirs_after.env_snapshots
    for each in (envs, others):
        each.close()


def test_a_step_of_a_sim_that_hangs_can_be_interrupted(
    start_service: Callable[..., Any], wait_until: Callable[..., float]
) -> None:
    service, hangs = start_service("freerein_sim", FREEREIN_SIM_WORKERS="1"), threading.Event()
    wait_until(service.is_ready, 300)
    polls = itertools.count()

    def interrupt() -> None:
        if hangs.is_set() and next(polls) == 3:
            raise Stopped

    with SyncClient(SimClient(Channel(service.address))) as sim:
        request = CreateSessionRequest(TASK, num_envs=3, seed=3)
        envs = RemoteVectorEnv([sim], request, cameras=(CAMERA,), reward_fn=zero_reward, interrupt=interrupt)
        envs.reset()
        service.process.send_signal(signal.SIGSTOP)
        hangs.set()
        with pytest.raises(Stopped):
            envs.step(np.zeros((3, 3), np.float32))
        envs.close()
        service.process.send_signal(signal.SIGCONT)
