"""Features, and image statistics, of many frames; and the in-distribution score that is fitted to them."""

import sys

import torch
from torch import Tensor, nn

from freerein.learning.augmentation import augment_camera
from freerein.learning.image_statistics import image_statistics
from freerein.learning.in_distribution import KNOWN_FRAMES
from freerein.learning.trajectories import Trajectories
from freerein_imitation.methods.shared.views import SharedView
from freerein_imitation.model.torch_policy import PolicyNetwork, confidence

_ENCODE_BATCH = 256


@torch.no_grad()
def encode_trajectory(
    encoder: nn.Module,
    trajectories: Trajectories,
    item: int,
    *,
    most: int = sys.maxsize,
    view: SharedView | None = None,
) -> Tensor:
    """Returns the features of a trajectory's first `most` frames in a view, float32 (T, D), on the encoder's device."""
    device, length = next(encoder.buffers()).device, min(len(trajectories.actions[item]), most)
    parts = []
    for start in range(0, length, _ENCODE_BATCH):
        frames = {
            camera: torch.tensor(each[item][start : min(start + _ENCODE_BATCH, length)], device=device)
            for camera, each in trajectories.frames.items()
        }
        parts.append(encoder(view.of(frames) if view else frames))
    return torch.cat(parts)


def sampled_statistics(trajectories: Trajectories, *, augmentation: float = 0.0, seed: int = 0) -> Tensor:
    """Returns image statistics of about `KNOWN_FRAMES` frames, float32 (N, D), as fits with augmentation see them."""
    generator, sampled = torch.Generator().manual_seed(seed), trajectories.sample_frames(KNOWN_FRAMES)
    takes = torch.arange(len(next(iter(sampled.values()))))
    return image_statistics(
        {
            camera: augment_camera(each, takes, strength=augmentation, generator=generator)
            for camera, each in sampled.items()
        }
    )


def trajectory_statistics(trajectories: Trajectories) -> Tensor:
    """Returns image statistics of every frame, trajectory after trajectory, float32 (N, D)."""
    return torch.cat(
        [
            image_statistics({name: torch.tensor(each[item]) for name, each in trajectories.frames.items()})
            for item in range(len(trajectories))
        ]
    )


def fit_in_distribution(
    network: PolicyNetwork,
    training: Trajectories,
    validation: Trajectories,
    reached: Tensor,
    device: torch.device,
    *,
    augmentation: float = 0.0,
    seed: int = 0,
) -> None:
    """Fits a network's in-distribution score, to some training frames as they were seen and to all held-out ones.

    `reached`, float32 (N,), are the probabilities that each held-out frame is at its goal.
    """
    known = sampled_statistics(training, augmentation=augmentation, seed=seed).to(device)
    held_out = trajectory_statistics(validation).to(device)
    network.in_distribution.fit(known, held_out, confidence(reached), trajectories=len(validation))
