"""Hyperparameters of PPO."""

from dataclasses import dataclass

from freerein.config import bounded, bounded_or_none
from freerein.errors import InvalidInput

_MAX_ROLLOUT = 131_072

_LR_FALL = 0.8


@dataclass(frozen=True)
class Schedule:
    """Schedule of a training: learning rate and noise fall linearly, and keep their last values afterwards.

    Attributes:
        iterations: Iterations over which they fall.
        before: Iterations done before the training's own first one, by the trainings that it goes on with.
    """

    iterations: int
    before: int = 0

    def lr(self, config: "PPOConfig", step: int) -> float:
        """Returns the learning rate of the training's optimiser step, counted from 0."""
        steps = self.iterations * config.steps_per_iteration
        done = self.before * config.steps_per_iteration + step
        return config.lr * (1 - _LR_FALL * min(done, steps) / steps)

    def log_std(self, config: "PPOConfig", iteration: int) -> float:
        """Returns the log standard deviation of continuous actions in the training's iteration, counted from 0."""
        final = config.init_log_std if config.final_log_std is None else config.final_log_std
        last = self.iterations - 1
        fallen = min(self.before + iteration, last)
        return config.init_log_std + (final - config.init_log_std) * fallen / max(1, last)


@dataclass(frozen=True)
class PPOConfig:
    """Hyperparameters of PPO; the defaults suit rewards of 0 and 1, and actions of which 1 is a large one.

    Attributes:
        iterations: Number of rollouts, each followed by `epochs` passes over it.
        num_envs: Number of parallel environments.
        num_steps: Actions per environment and rollout.
        epochs: Passes over each rollout.
        batch_size: Actions per minibatch. Divides `num_envs * num_steps`; a multiple of `num_steps` for a recurrent
            policy, which learns from whole sequences.
        lr: Initial learning rate of Adam; falls linearly to a fifth.
        gamma: Discount factor.
        gae_lambda: Lambda of generalised advantage estimation.
        clip_range: PPO's clipping range of the probability ratio.
        ent_coef: Coefficient of the entropy bonus.
        vf_coef: Coefficient of the value loss.
        recurrent: Whether the policy has an LSTM.
        normalise_rewards: Whether rewards are divided by the running standard deviation of the discounted return.
        feature_size: Image features.
        hidden_size: Units per hidden layer, and of the LSTM.
        layer_norm: Whether each hidden layer is normalised.
        init_log_std: Initial log standard deviation of continuous actions.
        final_log_std: The last iteration's, which falls to it linearly; None for one that is learned.
        approach_weight: Weight of potential-based shaping by how near the body is to the goal's first object, or to
            where it would push that, in object widths; unused without an object encoder.
        carry_weight: The same by how near the goal's first object is to where the goal has it, along a way over the top
            of the second.
        explorations: Short sequences of random actions in each environment that an object encoder is fitted to; unused
            without one.
        augmentation: Strength of the augmentation of their frames, by light and things that come and go; 0 for none.
        seed: Seed of the learner and of the environments.
        threads: Torch threads on the CPU.

    Raises:
        InvalidInput: A rollout is too large, or `batch_size` does not divide it.
    """

    iterations: int = bounded(92, least=1, most=1_000_000)
    num_envs: int = bounded(16, least=1, most=1024)
    num_steps: int = bounded(64, least=2, most=65_536)
    epochs: int = bounded(10, least=1, most=100)
    batch_size: int = bounded(256, least=2, most=1_048_576)
    lr: float = bounded(1e-3, least=1e-7, most=1.0)
    gamma: float = bounded(0.98, least=0.0, most=1.0)
    gae_lambda: float = bounded(0.95, least=0.0, most=1.0)
    clip_range: float = bounded(0.2, least=0.01, most=1.0)
    ent_coef: float = bounded(0.0, least=0.0, most=1.0)
    vf_coef: float = bounded(0.5, least=0.0, most=10.0)
    recurrent: bool = False
    normalise_rewards: bool = True
    feature_size: int = bounded(128, least=8, most=1024)
    hidden_size: int = bounded(128, least=2, most=1024)
    layer_norm: bool = True
    init_log_std: float = bounded(-1.2, least=-5.0, most=2.0)
    final_log_std: float | None = bounded_or_none(-2.0, least=-5.0, most=2.0)
    approach_weight: float = bounded(1.0, least=0.0, most=100.0)
    carry_weight: float = bounded(0.0, least=0.0, most=100.0)
    explorations: int = bounded(40, least=1, most=1000)
    augmentation: float = bounded(1.0, least=0.0, most=1.0)
    seed: int = bounded(0, least=0, most=2**31 - 1)
    threads: int = bounded(1, least=1, most=256)

    def __post_init__(self) -> None:
        if self.rollout_size > _MAX_ROLLOUT:
            raise InvalidInput(
                f"num_envs * num_steps must be at most {_MAX_ROLLOUT}; got {self.rollout_size}.",
                field="config.num_steps",
                hint="Use more iterations of fewer steps.",
            )
        if self.rollout_size % self.batch_size or self.batch_size % self.sequence_length:
            raise InvalidInput(
                f"`batch_size` must divide num_envs * num_steps = {self.rollout_size} and be a multiple of "
                f"{self.sequence_length}; got {self.batch_size}.",
                field="config.batch_size",
                hint=f"Choose {self.rollout_size // next(n for n in (4, 2, 1) if self.num_envs % n == 0)}.",
            )

    @property
    def rollout_size(self) -> int:
        """Actions per rollout, over all environments."""
        return self.num_envs * self.num_steps

    @property
    def sequence_length(self) -> int:
        """Actions per training sequence: a whole rollout's for a recurrent policy, else 1."""
        return self.num_steps if self.recurrent else 1

    @property
    def steps_per_iteration(self) -> int:
        """Optimiser steps per iteration."""
        return self.epochs * self.rollout_size // self.batch_size
