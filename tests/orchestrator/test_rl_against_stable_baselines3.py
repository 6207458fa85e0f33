"""What ours and stable-baselines3 must have in common: advantages, losses, gradients, and what is learnt in the end."""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
import pytest
import stable_baselines3
import torch
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from stable_baselines3.common.buffers import RolloutBuffer as TheirRolloutBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.logger import configure

from freerein.learning.actor_critic.networks import ActorCritic, ActorCriticSpec
from freerein_orchestrator.rl import ppo
from freerein_orchestrator.rl.config import PPOConfig
from freerein_orchestrator.rl.initial_network import init_network, network_spec
from freerein_orchestrator.rl.ppo import Batch
from freerein_orchestrator.rl.rollout import CollectorState, RolloutBuffer, collect
from freerein_orchestrator.rl.state import init_state
from freerein_orchestrator.rl.trainer import Trainer
from freerein_orchestrator.rl.vec_env import Actions, Observations, Rewards, VecStep

CPU = torch.device("cpu")
CARTPOLE = PPOConfig(
    iterations=12,
    num_envs=8,
    num_steps=128,
    epochs=10,
    batch_size=128,
    lr=1e-3,
    gamma=0.98,
    gae_lambda=0.8,
    ent_coef=0.0,
    normalise_rewards=False,
    hidden_size=64,
    layer_norm=False,
)


def test_advantages_are_those_of_stable_baselines3_to_the_last_bit() -> None:
    rng = np.random.default_rng(0)
    rewards, values = (rng.standard_normal((50, 8)).astype(np.float32) for _ in range(2))
    dones, last_values = rng.random((50, 8)) < 0.1, rng.standard_normal(8).astype(np.float32)
    space = gymnasium.spaces.Box(-1, 1, (1,))
    buffer = TheirRolloutBuffer(50, space, space, "cpu", gae_lambda=0.9, gamma=0.97, n_envs=8)
    buffer.rewards, buffer.values = rewards, values
    buffer.episode_starts[1:] = dones[:-1]
    buffer.compute_returns_and_advantage(torch.from_numpy(last_values), dones[-1])
    advantages = ppo.generalised_advantages(
        *(torch.from_numpy(each) for each in (rewards, values, dones, last_values)), gamma=0.97, gae_lambda=0.9
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
    network = init_network(spec, generator)
    for parameter in network.parameters():  # away from the initial policy, which is uniform
        parameter.data += 0.1 * torch.randn(parameter.shape, generator=generator)
    observations = torch.randn(1, count, spec.vector_size, generator=generator)
    no_state, starts = torch.zeros(1, count, 0), torch.zeros(1, count, dtype=torch.bool)
    with torch.no_grad():
        policy = network(observations, starts, no_state[0]).actions
        actions = policy.sample(generator)
        log_probs = policy.log_prob(actions) + 0.2 * torch.randn(1, count, generator=generator)
    advantages, returns = torch.randn(2, 1, count, generator=generator).unbind()
    batch = Batch(observations, starts, actions, log_probs, advantages, returns, no_state)

    losses = ppo.evaluate(network, batch, clip_range=0.2)
    loss = losses.total(PPOConfig(ent_coef=0.01))
    loss.backward()  # type: ignore[no-untyped-call]  # torch does not annotate it

    theirs_loss, theirs = _theirs(task, network, batch)
    assert 0.1 < losses.clip_fraction < 0.9
    assert loss.item() == pytest.approx(theirs_loss, abs=1e-6)
    for name, parameter in network.named_parameters():
        torch.testing.assert_close(parameter.grad, theirs[name], atol=1e-6, rtol=0)


def _theirs(task: str, network: ActorCritic, batch: Batch) -> tuple[float, dict[str, torch.Tensor]]:
    """Returns stable-baselines3's loss on a batch, and its gradients by the names of our parameters."""
    count = batch.episode_starts.numel()
    model = stable_baselines3.PPO(
        "MlpPolicy", task, n_steps=count, batch_size=count, n_epochs=1, ent_coef=0.01, max_grad_norm=1e9, device="cpu"
    )
    model.set_logger(configure(None, []))
    names = {f"{theirs}.{part}": f"{ours}.{part}" for theirs, ours in LAYERS.items() for part in ("weight", "bias")} | (
        {"log_std": "gaussian.log_std"} if network.gaussian else {}
    )
    ours = network.state_dict()
    model.policy.load_state_dict({theirs: ours[name] for theirs, name in names.items()})
    buffer = model.rollout_buffer
    buffer.observations[:, 0], buffer.actions[:, 0] = batch.observations[0].numpy(), batch.actions[0].numpy()
    buffer.log_probs[:, 0], buffer.advantages[:, 0] = batch.log_probs[0].numpy(), batch.advantages[0].numpy()
    buffer.returns[:, 0], buffer.full = batch.returns[0].numpy(), True
    model.train()
    gradients = {names[name]: parameter.grad for name, parameter in model.policy.named_parameters()}
    return model.logger.name_to_value["train/loss"], {n: g for n, g in gradients.items() if g is not None}


@pytest.mark.long
def test_the_cart_pole_is_learnt_as_fast_as_by_stable_baselines3() -> None:
    ours, theirs = (
        np.array([curve(replace(CARTPOLE, seed=seed)) for seed in range(4)]) for curve in (_curve, _their_curve)
    )
    by_seed, theirs_by_seed = np.nanmean(ours, axis=1), np.nanmean(theirs, axis=1)
    spread = np.sqrt((by_seed.var(ddof=1) + theirs_by_seed.var(ddof=1)) / 2)
    assert abs(by_seed.mean() - theirs_by_seed.mean()) < 2 * spread
    assert np.nanmean(ours[:, 0]) < 30
    assert np.nanmean(ours[:, -5:]) > 200


class GymnasiumEnvs:
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

    def step(self, actions: Actions) -> VecStep:
        observations, rewards, terminated, truncated, info = self._vector.step(actions[:, 0])
        final = observations.copy()
        for index in np.flatnonzero(terminated | truncated):
            final[index] = info["final_obs"][index]
        self._rewards.append(rewards.astype(np.float32))
        return VecStep(observations, terminated, truncated, final)

    def rewards(self) -> Rewards:
        earned, self._rewards = np.stack(self._rewards), []
        return earned

    def snapshots(self) -> tuple[bytes, ...]:
        return ()


def _curve(config: PPOConfig) -> list[float]:
    """Returns, by iteration, the mean return of the episodes that ended in it; not a number where none did."""
    envs = GymnasiumEnvs("CartPole-v1", config.num_envs, config.seed)
    spec = network_spec(config, observation=(4,), action_choices=2)
    curve = _Curve()
    with TemporaryDirectory() as folder:
        Trainer(
            Path(folder),
            init=lambda: init_state(config, spec, envs, device=CPU),
            load=lambda _: pytest.fail("nothing was interrupted"),
            collector=lambda _: _Collector(envs, config),
            metrics_log=lambda _: curve,
        ).train()
    return curve.returns


class _Collector:
    """Collects from environments that go on where they are."""

    recoveries = 0

    def __init__(self, envs: GymnasiumEnvs, config: PPOConfig) -> None:
        self._envs = envs
        self._config = config

    def collect(self, network: ActorCritic, state: CollectorState) -> tuple[RolloutBuffer, CollectorState]:
        return collect(network, self._envs, state, num_steps=self._config.num_steps)

    def close(self) -> None:
        """Holds nothing."""


class _Curve:
    """Keeps the mean return of each iteration; a `MetricsLog`."""

    def __init__(self) -> None:
        self.returns: list[float] = []

    def append(self, step: int, metrics: Mapping[str, float]) -> None:
        self.returns.append(metrics.get("episode_return", np.nan))


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
        n_steps=config.num_steps,
        batch_size=config.batch_size,
        n_epochs=config.epochs,
        gamma=config.gamma,
        gae_lambda=config.gae_lambda,
        ent_coef=config.ent_coef,
        max_grad_norm=1.0,
        learning_rate=lambda left: config.lr * 0.5 * (1 + math.cos(math.pi * (1 - left))),
        seed=config.seed,
        device="cpu",
    )
    returns = _Returns()
    model.learn(config.iterations * config.num_envs * config.num_steps, callback=returns)
    return returns.curve
