"""Exploration out of curiosity: PPO is rewarded for what a model did not foresee, and the model learns it meanwhile.

In each iteration every environment makes `steps` steps. What surprises is rewarded; then the policy learns from it, and
then curiosity, so that the same will surprise less. What was seen and done is cut into trajectories where episodes end.
"""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields, replace
from itertools import pairwise
from typing import Any, cast

import torch
from torch import Tensor

from freerein.errors import InvalidInput
from freerein.learning import train_state
from freerein.learning.checkpoints import JSON, Checkpoint
from freerein.learning.train_state import FitLoopState
from freerein.types.common import Trajectory
from freerein_orchestrator import curiosity, ppo_training
from freerein_orchestrator.curiosity import Curiosity, CuriosityConfig, Transitions
from freerein_orchestrator.ppo import learn
from freerein_orchestrator.ppo_training import Outset, PPOTraining, frozen
from freerein_orchestrator.reward_scale import RewardScale
from freerein_orchestrator.rollout import Rollout

_CURIOSITY, _SCALE = "curiosity/", "scale/"


@dataclass(frozen=True, eq=False)
class Exploration:
    """Everything that the next iteration depends on.

    Attributes:
        config: Of curiosity.
        training: The policy's, and where the next rollout begins.
        curiosity: What it has learnt so far.
        scale: What surprise is divided by, before it rewards.
        recorded: Trajectories made so far.
    """

    config: CuriosityConfig
    training: PPOTraining
    curiosity: FitLoopState[Curiosity]
    scale: RewardScale
    recorded: int = 0


def begin(training: PPOTraining, config: CuriosityConfig) -> Exploration:
    """Returns an exploration before its first iteration, by a policy that is before its own.

    Args:
        training: The policy's; it sees frames. Curiosity takes its calibration over.
        config: Of curiosity.

    Raises:
        InvalidInput: The policy sees no frames.
    """
    exploration = _untaught(training, config)
    if training.network.image is None:
        raise InvalidInput("Curiosity must see frames; got vectors.", hint="Explore a task that has a camera.")
    exploration.curiosity.state.network.calibrate(training.network.image)
    return exploration


def advance(
    exploration: Exploration,
    rollout: Rollout,
    reached: Tensor,
    outset: Outset,
    *,
    interrupt: Callable[[], None] = lambda: None,
) -> Exploration:
    """Returns the exploration after an iteration; networks are changed in place.

    Args:
        exploration: Before it.
        rollout: Of its policy, rewarded for nothing.
        reached: What each step came to, uint8 (T, N, H, W, C): where it ended an episode, the last frame of that one.
        outset: Of the next rollout.
        interrupt: Called before each update of the policy; what it raises ends them.

    Raises:
        Rejected: A number is not finite.
    """
    training, config = exploration.training, exploration.training.config
    steps = transitions(rollout, reached)
    felt = curiosity.surprise(exploration.curiosity.state.network, steps, scale=exploration.config.scale)
    rewards, scale = _scaled(felt.view(rollout.ends.shape), rollout.ends, exploration.scale, discount=config.discount)
    rewarded = replace(rollout, rewards=rollout.rewards + rewards)
    progress, metrics = learn(training.progress, rewarded, config, interrupt=interrupt)
    known, errors = curiosity.learn(exploration.curiosity, steps, exploration.config)
    metrics = {**metrics, **errors, "surprise": felt.mean().item()}
    after = replace(training, progress=progress, actor=frozen(progress.state.network), outset=outset, metrics=metrics)
    recorded = exploration.recorded + len(stretches(rollout))
    return Exploration(exploration.config, after, known, scale, recorded)


def transitions(rollout: Rollout, reached: Tensor) -> Transitions:
    """Returns the T * N steps of a rollout, by time; `reached` as of `advance`."""
    actions = rollout.actions.clamp(-1, 1) if rollout.actions.is_floating_point() else rollout.actions
    return Transitions(rollout.observations.flatten(end_dim=1), actions.flatten(end_dim=1), reached.flatten(end_dim=1))


def trajectories(rollout: Rollout, camera: str) -> list[Trajectory]:
    """Returns what each environment saw and did, cut where an episode ended, in order of the last timestep.

    Args:
        rollout: Of frames.
        camera: That showed them.
    """
    steps = transitions(rollout, rollout.observations)
    actions = steps.actions.reshape(rollout.actions.shape).numpy()
    frames = rollout.observations.numpy()
    parts = stretches(rollout)
    return [Trajectory({camera: frames[begin:end, env]}, actions[begin:end, env]) for end, env, begin in parts]


def stretches(rollout: Rollout) -> list[tuple[int, int, int]]:
    """Returns, for each stretch of an episode in a rollout, the timestep after it, its environment and its first."""
    found = []
    for env, ends in enumerate(rollout.ends.T):
        marks = [0, *(ends[:-1].nonzero()[:, 0] + 1).tolist(), len(ends)]
        found += [(end, env, begin) for begin, end in pairwise(marks)]
    return sorted(found)


def snapshot(exploration: Exploration) -> Checkpoint:
    """Returns a copy of an exploration, which nothing that follows changes; to be saved."""
    made, identity = ppo_training.snapshot(exploration.training), cast(JSON, asdict(exploration.config))
    known = train_state.to_checkpoint(exploration.curiosity, {"config": identity})
    copies = {_CURIOSITY + name: tensor.detach().clone() for name, tensor in known.tensors.items()}
    document = {"step": known.step, "recorded": exploration.recorded, **known.document}
    scale = {_SCALE + each.name: getattr(exploration.scale, each.name).clone() for each in fields(RewardScale)}
    return replace(made, tensors={**made.tensors, **copies, **scale}, document={**made.document, "curiosity": document})


def restore(training: PPOTraining, checkpoint: Checkpoint, config: CuriosityConfig) -> Exploration:
    """Returns the exploration that a snapshot is of.

    Args:
        training: The policy's, restored from the same snapshot.
        checkpoint: From `snapshot`.
        config: As the exploration was begun with.

    Raises:
        FailedPrecondition: It was begun with another.
    """
    document = cast(Mapping[str, Any], checkpoint.document["curiosity"])
    fresh = _untaught(training, config)
    known = Checkpoint(document["step"], _under(_CURIOSITY, checkpoint.tensors), document)
    learnt = train_state.from_checkpoint(known, fresh.curiosity, {"config": cast(JSON, asdict(config))})
    scale = RewardScale(**_under(_SCALE, checkpoint.tensors))
    return Exploration(config, training, learnt, scale, document["recorded"])


def _untaught(training: PPOTraining, config: CuriosityConfig) -> Exploration:
    count, device = training.config.num_envs, next(training.network.parameters()).device
    untaught = curiosity.begin(config, training.network.spec, transitions=count * training.config.steps, device=device)
    return Exploration(config, training, untaught, RewardScale.begin(count))


def _scaled(felt: Tensor, ends: Tensor, scale: RewardScale, *, discount: float) -> tuple[Tensor, RewardScale]:
    """Returns surprise, float32 (T, N), as it rewards, and the scale thereafter."""
    rewards = []
    for each, ended in zip(felt, ends, strict=True):
        scale = scale.observe(each, discount=discount)
        rewards.append(scale.apply(each))
        scale = scale.end(ended)
    return torch.stack(rewards), scale


def _under(prefix: str, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): tensor for name, tensor in tensors.items() if name.startswith(prefix)}
