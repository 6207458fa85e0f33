"""What a training by PPO may choose."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, Self, TypeAlias

from freerein.errors import InvalidInput
from freerein.learning.config import bounded, parse

_MOST_COLLECTED = 131_072

RewardForm: TypeAlias = Literal["learned", "base", "oracle"]


@dataclass(frozen=True)
class PPOConfig:
    """Everything that a training may choose; the defaults suit frames, and rewards of 0 and 1.

    Attributes:
        iterations: Times that experience is collected and learnt from.
        num_envs: Environments that step together.
        steps: Timesteps of each environment per iteration.
        epochs: Times that each timestep is learnt from.
        batch_size: Timesteps per update. It divides `num_envs * steps`; with a memory, whole sequences are learnt from,
            and it is a multiple of `steps`.
        lr: Of Adam, before the first update; it falls to zero as half a cosine.
        discount: Of rewards, per timestep (gamma).
        trace_decay: Between one-step advantages, 0, and whole returns, 1 (lambda).
        clip: How far the probability of an action may move from 1, as a ratio, before its gradient is cut off.
        entropy_weight: Of the entropy, which is raised.
        value_weight: Of the value's squared error.
        overlap: Whether experience is collected while the last is learnt from, with the weights from before; else
            with those from after, one after the other.
        is_recurrent: Whether the networks have a memory.
        scale_rewards: Whether rewards are divided by the running spread of their discounted sums.
        features: Image features.
        hidden: Units of each hidden layer, and of the memory.
        log_std: Of continuous actions, before the first update.
        seed: Of every random draw of the learner; environments have their own.
        threads: Of torch on the CPU.

    Raises:
        InvalidInput: Too much is to be collected at once, or `batch_size` does not divide it.
    """

    iterations: int = bounded(100, least=1, most=1_000_000)
    num_envs: int = bounded(16, least=1, most=1024)
    steps: int = bounded(32, least=2, most=65_536)
    epochs: int = bounded(4, least=1, most=100)
    batch_size: int = bounded(256, least=2, most=1_048_576)
    lr: float = bounded(1e-3, least=1e-7, most=1.0)
    discount: float = bounded(0.98, least=0.0, most=1.0)
    trace_decay: float = bounded(0.95, least=0.0, most=1.0)
    clip: float = bounded(0.2, least=0.01, most=1.0)
    entropy_weight: float = bounded(0.0, least=0.0, most=1.0)
    value_weight: float = bounded(0.5, least=0.0, most=10.0)
    overlap: bool = True
    is_recurrent: bool = False
    scale_rewards: bool = True
    features: int = bounded(128, least=8, most=1024)
    hidden: int = bounded(64, least=2, most=1024)
    log_std: float = bounded(-0.5, least=-5.0, most=2.0)
    seed: int = bounded(0, least=0, most=2**31 - 1)
    threads: int = bounded(1, least=1, most=256)

    def __post_init__(self) -> None:
        collected = self.num_envs * self.steps
        if collected > _MOST_COLLECTED:
            raise InvalidInput(
                f"num_envs * steps must be at most {_MOST_COLLECTED}, which are kept in memory; got {collected}.",
                field="steps",
                hint="Make more iterations of fewer steps.",
            )
        whole = self.steps if self.is_recurrent else 1
        if collected % self.batch_size or self.batch_size % whole:
            raise InvalidInput(
                f"`batch_size` must divide num_envs * steps = {collected} and be a multiple of {whole}; "
                f"got {self.batch_size}.",
                field="batch_size",
                hint=f"Choose {collected // next(n for n in (4, 2, 1) if self.num_envs % n == 0)}.",
            )

    @classmethod
    def from_mapping(cls, values: Mapping[str, object]) -> Self:
        """Returns the configuration that `values` describe; what is left out has its default.

        Raises:
            InvalidInput: A key is unknown, a value is of the wrong type or out of bounds, or two do not fit together.
        """
        return parse(cls, values)

    @property
    def sequence(self) -> int:
        """Timesteps that are learnt from together and in order: a rollout's with a memory, else 1."""
        return self.steps if self.is_recurrent else 1

    @property
    def sequences(self) -> int:
        """Sequences per iteration."""
        return self.num_envs * self.steps // self.sequence

    @property
    def updates(self) -> int:
        """Updates per iteration."""
        return self.epochs * self.num_envs * self.steps // self.batch_size


@dataclass(frozen=True, kw_only=True)
class PPORunConfig(PPOConfig):
    """What a run of this kind may choose, beside how it learns.

    Attributes:
        task: The task's name.
        goal_text: What is to be seen; empty for the task's own.
        camera: Whose frames the policy and the reward see; empty for the task's first.
        reward: `learned`, 1 where a reward model sees the goal text rather than its rivals; `base`, the similarity that
            the grounding model has between goal text and frame; `oracle`, what is true, to compare with.
        reward_model: The name of the model that judges; empty for the service's default, for `base` `grounding`. The
            version that is active when the run begins judges to its end.
        start_from: Whose weights to begin with: a run's id, the name of an earlier step of the same pipeline, or that
            of a policy among the models of the orchestrator; empty for weights that know nothing.
    """

    task: str
    goal_text: str = ""
    camera: str = ""
    reward: RewardForm = "learned"
    reward_model: str = ""
    start_from: str = ""
