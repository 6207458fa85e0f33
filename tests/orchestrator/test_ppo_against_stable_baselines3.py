"""What ours and stable-baselines3 must have in common: advantages, losses, gradients, and what is learnt in the end."""

import math
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
import pytest
import stable_baselines3
import torch
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.logger import configure

from freerein.learning import weights
from freerein_orchestrator import ppo, ppo_training
from freerein_orchestrator.networks import ActorCritic, ActorCriticSpec
from freerein_orchestrator.ppo import Samples
from freerein_orchestrator.ppo_config import PPOConfig
from freerein_orchestrator.ppo_loop import iterations
from freerein_orchestrator.rollout import Actions, Observations, Rewards, Step

CPU = torch.device("cpu")
CARTPOLE = PPOConfig(
    iterations=12,
    num_envs=8,
    steps=128,
    epochs=10,
    batch_size=128,
    lr=1e-3,
    discount=0.98,
    trace_decay=0.8,
    entropy_weight=0.0,
    overlap=False,
    scale_rewards=False,
)


def test_advantages_are_those_of_stable_baselines3_to_the_last_bit() -> None:
    rng = np.random.default_rng(0)
    rewards, values = (rng.standard_normal((50, 8)).astype(np.float32) for _ in range(2))
    ends, next_values = rng.random((50, 8)) < 0.1, rng.standard_normal(8).astype(np.float32)
    space = gymnasium.spaces.Box(-1, 1, (1,))
    buffer = RolloutBuffer(50, space, space, "cpu", gae_lambda=0.9, gamma=0.97, n_envs=8)
    buffer.rewards, buffer.values = rewards, values
    buffer.episode_starts[1:] = ends[:-1]
    buffer.compute_returns_and_advantage(torch.from_numpy(next_values), ends[-1])
    advantages = ppo.estimate_advantages(
        *(torch.from_numpy(each) for each in (rewards, values, ends, next_values)), discount=0.97, trace_decay=0.9
    )
    np.testing.assert_array_equal(advantages.numpy(), buffer.advantages)


LAYERS = {
    "mlp_extractor.policy_net.0": "actor.0",
    "mlp_extractor.policy_net.2": "actor.2",
    "action_net": "actor.4",
    "mlp_extractor.value_net.0": "critic.0",
    "mlp_extractor.value_net.2": "critic.2",
    "value_net": "critic.4",
}


@pytest.mark.parametrize(
    ("task", "spec"),
    [
        ("CartPole-v1", ActorCriticSpec(vector_size=4, action_choices=2)),
        ("Pendulum-v1", ActorCriticSpec(vector_size=3)),
    ],
)
def test_loss_and_gradient_are_those_of_stable_baselines3(task: str, spec: ActorCriticSpec) -> None:
    generator, count = torch.Generator().manual_seed(0), 256
    network = ActorCritic(spec)
    weights.initialise(network, generator=generator)
    for parameter in network.parameters():  # away from the first policy, which is indifferent
        parameter.data += 0.1 * torch.randn(parameter.shape, generator=generator)
    observations = torch.randn(1, count, spec.vector_size, generator=generator)
    no_memory, starts = torch.zeros(1, count, 0), torch.zeros(1, count, dtype=torch.bool)
    with torch.no_grad():
        policy = network(observations, starts, no_memory[0]).actions
        actions = policy.sample(generator)
        log_probs = policy.log_prob(actions) + 0.2 * torch.randn(1, count, generator=generator)
    advantages, targets = torch.randn(2, 1, count, generator=generator).unbind()
    batch = Samples(observations, starts, actions, log_probs, torch.ones(1, count), advantages, targets, no_memory)

    losses = ppo.evaluate(network, batch, clip=0.2)
    loss = losses.total(PPOConfig(entropy_weight=0.01))
    loss.backward()  # type: ignore[no-untyped-call]  # torch does not annotate it

    theirs_loss, theirs = _theirs(task, network, batch)
    assert 0.1 < losses.clipped_share < 0.9
    assert loss.item() == pytest.approx(theirs_loss, abs=1e-6)
    for name, parameter in network.named_parameters():
        torch.testing.assert_close(parameter.grad, theirs[name], atol=1e-6, rtol=0)


def _theirs(task: str, network: ActorCritic, batch: Samples) -> tuple[float, dict[str, torch.Tensor]]:
    """Returns stable-baselines3's loss on a batch, and its gradients by the names of our parameters."""
    count = batch.starts.numel()
    model = stable_baselines3.PPO(
        "MlpPolicy", task, n_steps=count, batch_size=count, n_epochs=1, ent_coef=0.01, max_grad_norm=1e9, device="cpu"
    )
    model.set_logger(configure(None, []))
    names = {f"{theirs}.{part}": f"{ours}.{part}" for theirs, ours in LAYERS.items() for part in ("weight", "bias")} | (
        {"log_std": "spread.log_std"} if network.spread else {}
    )
    ours = network.state_dict()
    model.policy.load_state_dict({theirs: ours[name] for theirs, name in names.items()})
    buffer = model.rollout_buffer
    buffer.observations[:, 0], buffer.actions[:, 0] = batch.observations[0].numpy(), batch.actions[0].numpy()
    buffer.log_probs[:, 0], buffer.advantages[:, 0] = batch.log_probs[0].numpy(), batch.advantages[0].numpy()
    buffer.returns[:, 0], buffer.full = batch.targets[0].numpy(), True
    model.train()
    gradients = {names[name]: parameter.grad for name, parameter in model.policy.named_parameters()}
    return model.logger.name_to_value["train/loss"], {n: g for n, g in gradients.items() if g is not None}


@pytest.mark.slow
@pytest.mark.timeout(180)
def test_the_cart_pole_is_learnt_as_fast_as_by_stable_baselines3() -> None:
    ours, theirs = (
        np.array([curve(replace(CARTPOLE, seed=seed)) for seed in range(4)]) for curve in (_curve, _their_curve)
    )
    by_seed, theirs_by_seed = np.nanmean(ours, axis=1), np.nanmean(theirs, axis=1)
    spread = np.sqrt((by_seed.var(ddof=1) + theirs_by_seed.var(ddof=1)) / 2)
    assert abs(by_seed.mean() - theirs_by_seed.mean()) < 2 * spread
    assert np.nanmean(ours[:, 0]) < 30
    assert np.nanmean(ours[:, -5:]) > 200


class GymnasiumEnvironments:
    """N environments of Gymnasium with discrete actions."""

    def __init__(self, task: str, num_envs: int, seed: int) -> None:
        self._vector = SyncVectorEnv(
            [lambda: gymnasium.make(task) for _ in range(num_envs)], autoreset_mode=AutoresetMode.SAME_STEP
        )
        self._vector.reset(seed=seed)
        self._rewards: list[Rewards] = []

    @property
    def num_envs(self) -> int:
        return self._vector.num_envs

    def reset(self) -> Observations:
        observations: npt.NDArray[np.float32] = self._vector.reset()[0]
        return observations

    def step(self, actions: Actions) -> Step:
        observations, rewards, terminated, truncated, info = self._vector.step(actions[:, 0])
        final = observations.copy()
        for index in np.flatnonzero(terminated | truncated):
            final[index] = info["final_obs"][index]
        self._rewards.append(rewards.astype(np.float32))
        return Step(observations, terminated, truncated, final)

    def rewards(self) -> Rewards:
        earned, self._rewards = np.stack(self._rewards), []
        return earned

    def snapshots(self) -> tuple[bytes, ...]:
        return ()


def _curve(config: PPOConfig) -> list[float]:
    """Returns, by iteration, the mean return of the episodes that ended in it; not a number where none did."""
    torch.set_num_threads(1)
    environments = GymnasiumEnvironments("CartPole-v1", config.num_envs, config.seed)
    spec = ppo_training.design(config, observation=(4,), action_choices=2)
    training = ppo_training.begin(config, spec, environments, device=CPU)
    made = iterations(training, lambda actor, at: ppo_training.roll_out(actor, at, environments, config))
    return [each.metrics.get("episode_return", np.nan) for each in made]


class _Returns(BaseCallback):
    """The mean return of the episodes that ended in each iteration."""

    def __init__(self) -> None:
        super().__init__()
        self.curve: list[float] = []
        self._ended: list[float] = []

    def _on_step(self) -> bool:
        infos: list[dict[str, Any]] = self.locals["infos"]
        self._ended += [info["episode"]["r"] for info in infos if "episode" in info]
        return True

    def _on_rollout_end(self) -> None:
        self.curve.append(float(np.mean(self._ended)) if self._ended else np.nan)
        self._ended = []


def _their_curve(config: PPOConfig) -> list[float]:
    model = stable_baselines3.PPO(
        "MlpPolicy",
        make_vec_env("CartPole-v1", n_envs=config.num_envs, seed=config.seed),
        n_steps=config.steps,
        batch_size=config.batch_size,
        n_epochs=config.epochs,
        gamma=config.discount,
        gae_lambda=config.trace_decay,
        ent_coef=config.entropy_weight,
        max_grad_norm=1.0,
        lr=lambda left: config.lr * 0.5 * (1 + math.cos(math.pi * (1 - left))),
        seed=config.seed,
        device="cpu",
    )
    returns = _Returns()
    model.learn(config.iterations * config.num_envs * config.steps, callback=returns)
    return returns.curve
