"""Reward `vice`: 1 where a fixed classifier takes a frame for success, else 0 (section 4.3 of the dissertation).

Variational inverse control with events (Fu et al. 2018) goes on training its classifier, against the policy's frames.
That of the dissertation is trained once: last frames of trajectories that end in success, against earlier ones.
"""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from freerein.data import Dataset
from freerein.data.lookup import open_dataset
from freerein.errors import InvalidInput
from freerein.learning import weights
from freerein.learning.checkpoints import Checkpoint
from freerein.learning.encoders import SpatialEncoder
from freerein.learning.optimiser import optimiser_step
from freerein.learning.train_state import TrainState
from freerein.types.common import Camera
from freerein_orchestrator.rewards.entry import RewardEntry, RewardSetting
from freerein_orchestrator.rl.reward import Reward
from freerein_orchestrator.rl.vec_env import CameraFrames, Rewards, join_cameras

_STEPS, _BATCH_SIZE, _LR = 150, 16, 1e-3
_FEATURES = 64
_FAILURES = 4
"""Frames of failure per trajectory."""


class SuccessClassifier(nn.Module):
    """Tells frames of success, uint8 (N, H, W, C), from others: logits, float32 (N,)."""

    def __init__(self, height: int, width: int, channels: int) -> None:
        super().__init__()
        self.image = SpatialEncoder(height=height, width=width, channels=channels, features=_FEATURES)
        self.head = nn.Linear(_FEATURES, 1)

    def forward(self, frames: Tensor) -> Tensor:
        """Returns the logits."""
        logits: Tensor = self.head(self.image(frames))[:, 0]
        return logits


def fit(network: SuccessClassifier, successes: Tensor, failures: Tensor, generator: torch.Generator) -> None:
    """Trains a classifier on frames, uint8 (N, H, W, C) each; as many of both are drawn for a minibatch."""
    weights.initialise(network, generator=generator)
    network.image.fit_normalisation(torch.cat([successes, failures]))
    state = TrainState.with_adam(network, _LR, generator=generator)
    labels = torch.ones(2 * _BATCH_SIZE)
    labels[_BATCH_SIZE:] = 0
    for _ in range(_STEPS):
        drawn = [each[torch.randint(len(each), (_BATCH_SIZE,), generator=generator)] for each in (successes, failures)]
        loss = functional.binary_cross_entropy_with_logits(network(torch.cat(drawn)), labels)
        state = optimiser_step(state, loss, lr=_LR)


def examples(dataset: Dataset, cameras: Sequence[Camera]) -> tuple[Tensor, Tensor]:
    """Returns frames of success and of failure, those of all cameras on the channels, uint8 (N, H, W, C) each.

    The last frame of a trajectory is taken for success: one that was recorded with `settle` shows it.

    Raises:
        InvalidInput: The dataset lacks a camera, or has no trajectory of two timesteps.
    """
    for camera in cameras:
        size = (camera.height, camera.width, camera.channels)
        if dataset.spec.cameras.get(camera.name) != size:
            raise InvalidInput(
                f"Examples of success must be of the camera {camera.name}, {size}; these are of "
                f"{dataset.spec.cameras}.",
                field="config.dataset",
                hint="Record them in this task, with frames of the camera's own size.",
            )
    names = [camera.name for camera in cameras]
    seen = [frames for each in dataset if len(frames := join_cameras(each.frames, names)) > 1]
    if not seen:
        raise InvalidInput("Examples of success need trajectories of two timesteps; got none.", field="config.dataset")
    first_half = [frames[np.linspace(0, len(frames) // 2 - 1, _FAILURES).astype(int)] for frames in seen]
    return torch.from_numpy(np.stack([frames[-1] for frames in seen])), torch.from_numpy(np.concatenate(first_half))


class ViceReward(Reward):
    """The classifier's decision. It stays as it was before the first rollout, and is saved with the training."""

    def __init__(self, setting: RewardSetting) -> None:
        self._setting = setting
        first, *_ = setting.cameras
        channels = sum(camera.channels for camera in setting.cameras)
        self._network = SuccessClassifier(first.height, first.width, channels)

    def begin(self) -> None:
        """Trains the classifier.

        Raises:
            NotFound: There is no such dataset.
            InvalidInput: It has no such examples.
        """
        setting = self._setting
        successes, failures = examples(open_dataset(setting.data_dir, setting.dataset), setting.cameras)
        fit(self._network, successes, failures, torch.Generator().manual_seed(setting.config.seed))

    @torch.no_grad()
    def of_frames(self, frames: CameraFrames, _true_rewards: Rewards | None = None) -> Rewards:
        """Returns 1 where success is more likely than not, else 0."""
        seen = torch.from_numpy(join_cameras(frames, [camera.name for camera in self._setting.cameras]))
        rewards: Rewards = (self._network(seen) > 0).numpy().astype(np.float32)
        return rewards

    def snapshot(self) -> Checkpoint:
        """Returns the classifier."""
        return Checkpoint(0, self._network.state_dict(), {})

    def restore(self, checkpoint: Checkpoint) -> None:
        """Takes over the classifier of a snapshot."""
        self._network.load_state_dict(checkpoint.tensors)


VICE = RewardEntry(
    lambda setting, _: ViceReward(setting),
    "images of success, chosen by true states, which is privileged: to compare with",
    frozenset({"frames", "success_examples"}),
    privileged=True,
    own_cameras=True,
)
