"""An entry of the registry of rewards in `__init__.py`."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from freerein.clients import SyncClient
from freerein.learning.actor_critic.networks import ActorCritic
from freerein.types.common import Camera, ModelRef
from freerein_orchestrator.rl.config import PPOConfig
from freerein_orchestrator.rl.reward import Reward

Sight = Literal["frames", "actions", "success_examples", "true_rewards"]


@dataclass(frozen=True)
class RewardSetting:
    """The setting of a training's reward.

    Attributes:
        config: Hyperparameters of the training.
        goal_text: The goal in words.
        caption: The goal as the reward model of the policy's object encoder reads it; empty without an object encoder.
        cameras: The cameras of the frames, and their sizes.
        model: The reward model; without a version until the training begins.
        service: Client of the reward service.
        data_dir: The data directory.
        dataset: The dataset in it whose trajectories end in success; empty unless the reward sees such examples.
    """

    config: PPOConfig
    goal_text: str
    caption: str
    cameras: tuple[Camera, ...]
    model: ModelRef
    service: SyncClient
    data_dir: Path
    dataset: str = ""


@dataclass(frozen=True)
class RewardEntry:
    """A reward that a configuration may name.

    Attributes:
        make: Returns the untrained reward of a training, given the policy's network.
        supervision: Its supervision, for the cards of policies.
        sees: Its inputs.
        privileged: Whether it knows what no learner may see. Only then is it given the true rewards that it sees.
        needs_object_encoder: Whether the policy must see by an object encoder, or must not; None for either.
        own_cameras: Whether the frames that it sees may be of other cameras than the policy's.
        resolve_model: Returns the version of the reward model that it is bound to; without a name where it needs none.
        encodes_objects: Whether an object encoder may have the encoder of its reward model.
    """

    make: Callable[[RewardSetting, ActorCritic], Reward]
    supervision: str
    sees: frozenset[Sight]
    privileged: bool = False
    needs_object_encoder: bool | None = None
    own_cameras: bool = False
    resolve_model: Callable[[RewardSetting], ModelRef] = lambda _: ModelRef()
    encodes_objects: bool = True

    @property
    def gets_true_rewards(self) -> bool:
        """Whether its sessions are privileged."""
        return self.privileged and "true_rewards" in self.sees
