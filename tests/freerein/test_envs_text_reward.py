"""Rewards from language in a training loop: a toy reward service that judges frames by their brightness."""
# ruff: noqa: N802 -- gRPC names the methods

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import grpc
import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecMonitor

from freerein import wire
from freerein.api.reward.v1 import reward_pb2_grpc
from freerein.envs import TextReward, VectorTextReward
from freerein.envs.sb3 import SB3VecEnv
from freerein.errors import InvalidInput, Unauthenticated
from freerein.types.common import ModelRef, Timing
from freerein.types.reward import RewardRequest, RewardResponse

BRIGHT = "a bright frame"
BRIGHTEST = 4
FRAME = spaces.Box(0, 255, (6, 5, 3), np.uint8)


class Brighter(gymnasium.Env[Any, Any]):
    """Each step is a shade brighter; episode number k ends at a brightness of 4 + k, which the observation shows."""

    action_space = spaces.Discrete(2)

    def __init__(self, *, is_dict: bool) -> None:
        self.observation_space = spaces.Dict({"top": FRAME, "arm": spaces.Box(0, 1, (2,))}) if is_dict else FRAME
        self.episode = -1

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.episode, self.brightness = self.episode + 1, 0
        return self.observe(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.brightness += 1
        return self.observe(), -1.0, self.brightness == BRIGHTEST + self.episode, False, {"own": self.brightness}

    def observe(self) -> Any:
        frame = np.full(FRAME.shape, self.brightness, np.uint8)
        return (
            {"top": frame, "arm": np.zeros(2, np.float32)} if isinstance(self.observation_space, spaces.Dict) else frame
        )


class Lamp(gymnasium.Env[Any, Any]):
    """A lamp that each action turns up or down a little, for ten steps."""

    observation_space = FRAME
    action_space = spaces.Discrete(2)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.brightness, self.steps = 0, 0
        return self.observe(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.brightness, self.steps = max(0, self.brightness + 2 * int(action) - 1), self.steps + 1
        return self.observe(), 0.0, False, self.steps == 10, {}

    def observe(self) -> Any:
        return np.full(FRAME.shape, self.brightness, np.uint8)


@dataclass
class Judge(reward_pb2_grpc.RewardServiceServicer):
    """The similarity is the brightness; knows `bright`, and is activated anew by every call without a version."""

    requests: list[RewardRequest] = field(default_factory=list)

    def Reward(self, message, context):
        if ("authorization", "Bearer secret") not in context.invocation_metadata():
            context.abort(grpc.StatusCode.UNAUTHENTICATED, "who is it?")
        request = wire.unpack(message, RewardRequest)
        self.requests.append(request)
        [frames] = request.frames.values()
        brightness = frames[:, 0, 0, 0].astype(np.float32)
        known = "bright" in request.goal_text
        return wire.pack(
            RewardResponse(
                rewards=(brightness >= BRIGHTEST).astype(np.float32) if request.mode == "binary" else brightness,
                similarities=brightness,
                winners=np.zeros(len(frames), np.int64),
                texts=(request.goal_text,),
                truncated=False,
                in_distribution=np.full(len(frames), 0.5, np.float32),
                unknown=() if known else ("gloomy",),
                model=ModelRef("judge", request.model.version or f"{len(self.requests):012d}"),
                timing=Timing(),
            )
        )


@pytest.fixture
def judge() -> Judge:
    return Judge()


@pytest.fixture
def address(judge: Judge) -> Iterator[str]:
    server = grpc.server(ThreadPoolExecutor(2))
    reward_pb2_grpc.add_RewardServiceServicer_to_server(judge, server)
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    yield f"127.0.0.1:{port}"
    server.stop(None).wait()


@pytest.fixture(params=[False, True], ids=["frame", "dict"])
def make(request: pytest.FixtureRequest) -> Callable[[], Brighter]:
    return lambda: Brighter(is_dict=request.param)


def test_each_step_is_rewarded_by_the_frame_after_it(make: Callable[[], Brighter], address: str) -> None:
    env = TextReward(make(), BRIGHT, address=address, token="secret")
    env.reset(seed=0)
    steps = [env.step(0) for _ in range(BRIGHTEST)]
    assert [(reward, terminated) for _, reward, terminated, *_ in steps] == [(0, False)] * 3 + [(1, True)]
    assert steps[-1][-1] == {"own": BRIGHTEST, "similarity": BRIGHTEST, "in_distribution": 0.5}
    env.close()


def test_the_info_of_a_reset_has_the_keys_of_a_steps(make: Callable[[], Brighter], address: str, judge: Judge) -> None:
    env = TextReward(make(), BRIGHT, address=address, token="secret")
    asked = len(judge.requests)
    _, info = env.reset(seed=0)
    assert len(judge.requests) == asked
    assert np.isnan([info["similarity"], info["in_distribution"]]).all()
    assert info.keys() == env.step(0)[-1].keys() - {"own"}  # of the environment's steps alone


def test_a_vector_is_rewarded_by_one_call_and_where_an_episode_ends_by_its_last_frame(
    make: Callable[[], Brighter], address: str, judge: Judge
) -> None:
    vector = SyncVectorEnv([make, make], autoreset_mode=AutoresetMode.SAME_STEP)
    envs = VectorTextReward(vector, BRIGHT, address=address, token="secret", mode="raw")
    envs.reset(seed=0)
    envs.reset(options={"reset_mask": np.array([False, True])})  # the second one's episodes are longer
    steps = [envs.step(np.zeros(2, np.int64)) for _ in range(BRIGHTEST + 1)]
    assert [reward.tolist() for _, reward, *_ in steps] == [[1, 1], [2, 2], [3, 3], [4, 4], [1, 5]]
    *running, last = steps[:4]
    assert [info["similarity"].tolist() for *_, info in running] == [reward.tolist() for _, reward, *_ in running]
    assert last[2].tolist() == [True, False]
    np.testing.assert_equal(last[-1]["similarity"], np.array([np.nan, 4], np.float32))
    np.testing.assert_equal(last[-1]["final_info"]["similarity"], np.array([4, np.nan], np.float32))
    assert len(judge.requests) == 1 + len(steps)
    envs.close()


def test_the_infos_of_resets_have_the_keys_of_steps_and_no_judgement_of_an_old_episode(
    make: Callable[[], Brighter], address: str
) -> None:
    vector = SyncVectorEnv([make, make], autoreset_mode=AutoresetMode.SAME_STEP)
    envs = SB3VecEnv(VectorTextReward(vector, BRIGHT, address=address, token="secret"))
    envs.reset()
    judgements = {"similarity", "in_distribution"}
    begun = {name: np.float32(np.nan) for name in judgements}
    np.testing.assert_equal(envs.reset_infos, [begun] * 2)
    infos = [envs.step(np.zeros(2, np.int64))[-1] for _ in range(BRIGHTEST)]
    np.testing.assert_equal(envs.reset_infos, [begun] * 2)
    assert [info["similarity"] for info in infos[-1]] == [BRIGHTEST] * 2
    assert "terminal_observation" in infos[-1][0]
    envs.close()


def test_a_token_is_not_recorded_in_the_spec_of_an_environment(address: str) -> None:
    gymnasium.register("Lamp-v0", entry_point=Lamp)
    env = TextReward(gymnasium.make("Lamp-v0"), BRIGHT, address=address, token="secret", mode="raw")
    assert env.spec is not None
    assert env.spec.additional_wrappers[-1].kwargs == {"goal_text": BRIGHT, "address": address, "mode": "raw"}
    env.close()
    gymnasium.registry.pop("Lamp-v0")


def test_the_model_stays_the_same_and_frames_have_the_cameras_name(address: str, judge: Judge) -> None:
    env = TextReward(Brighter(is_dict=False), BRIGHT, address=address, token="secret", camera="top", rivals=("night",))
    env.reset()
    env.step(0)
    env.step(0)
    assert [request.model.version for request in judge.requests] == ["", *["000000000001"] * 2]
    assert {tuple(request.frames) for request in judge.requests} == {("top",)}
    assert judge.requests[-1].rivals == ("night",)
    env.close()


def test_what_cannot_be_rewarded_is_refused_at_once(address: str) -> None:
    options = {"address": address, "token": "secret"}
    with pytest.raises(InvalidInput, match="does not know gloomy"):
        TextReward(Brighter(is_dict=False), "a gloomy frame", **options)
    with pytest.raises(InvalidInput, match="must observe frames"):
        TextReward(gymnasium.make("CartPole-v1"), BRIGHT, **options)
    with pytest.raises(InvalidInput, match="SAME_STEP"):
        VectorTextReward(SyncVectorEnv([lambda: Brighter(is_dict=False)]), BRIGHT, **options)
    with pytest.raises(Unauthenticated):
        TextReward(Brighter(is_dict=False), BRIGHT, address=address)


def test_stable_baselines_learns_from_a_sentence(address: str) -> None:
    vector = SyncVectorEnv([Lamp] * 8, autoreset_mode=AutoresetMode.SAME_STEP)
    envs = VecMonitor(SB3VecEnv(VectorTextReward(vector, BRIGHT, address=address, token="secret")))
    model = PPO("MlpPolicy", envs, n_steps=32, batch_size=64, n_epochs=8, learning_rate=3e-3, seed=0, device="cpu")
    before, _ = evaluate_policy(model, envs, 32, deterministic=False)
    model.learn(2048)
    after, _ = evaluate_policy(model, envs, 32, deterministic=False)
    assert before < 2
    assert after > 5  # of 7
    envs.close()
