"""Loss and threshold of the goal recognizer, from pairs of frames some actions apart."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn import functional

from freerein.learning.trajectories import Trajectories
from freerein_imitation.methods.shared.frame_features import encode_trajectory
from freerein_imitation.methods.shared.goal_images.recognizer import GoalRecognizer, proximity_logit
from freerein_imitation.methods.shared.goal_images.relabelling import sample_recognizer_batch
from freerein_imitation.methods.shared.losses import masked_mean

_THRESHOLD_FRAMES = 256


def sampled_recognizer_loss(
    recognizer: GoalRecognizer,
    trajectories: Trajectories,
    items: Sequence[int],
    rng: np.random.Generator,
    *,
    close_steps: int,
    far_steps: int,
    device: torch.device,
) -> Tensor:
    """Returns the loss on frames sampled from some trajectories, float (); see `sample_recognizer_batch`."""
    batch = sample_recognizer_batch(trajectories, items, rng, close_steps=close_steps, device=device)
    embeddings = recognizer(batch.frames)  # (N, embedding_size)
    logits = proximity_logit(embeddings[:, None], embeddings)  # (N, N)
    return recognizer_loss(logits, *batch.pairs(close_steps=close_steps, far_steps=far_steps))


def recognizer_loss(logits: Tensor, close: Tensor, far: Tensor, other_trajectory: Tensor) -> Tensor:
    """Returns the balanced logistic loss of the goal recognizer: float ().

    Close pairs weigh as much as all others; of those, pairs of one trajectory weigh half, since else it would be enough
    to tell scenes apart.

    Args:
        logits: Logits of pairs to be close, float (N, N).
        close: Pairs a few steps apart, bool (N, N).
        far: Pairs of one trajectory that are further apart, bool (N, N).
        other_trajectory: Pairs of different trajectories, bool (N, N).
    """
    negative = functional.softplus(logits)
    others = (masked_mean(negative, far) + masked_mean(negative, other_trajectory)) / 2
    return (masked_mean(functional.softplus(-logits), close) + others) / 2


@torch.no_grad()
def reached_threshold(recognizer: GoalRecognizer, trajectories: Trajectories) -> float:
    """Returns the recognizer's median probability that frames one action apart are close.

    The threshold that best separates training's pairs is far lower, and would call a goal reached too early. Frames of
    one embedding say nothing, such as those of a robot that stands still: they count where no others do. At least one
    of the validation trajectories has 2 timesteps.
    """
    logits, differ = [], []
    for item in range(len(trajectories)):
        embeddings = encode_trajectory(recognizer, trajectories, item, most=_THRESHOLD_FRAMES)
        logits.append(proximity_logit(embeddings[1:], embeddings[:-1]).cpu().numpy())  # (T - 1,)
        differ.append((embeddings[1:] != embeddings[:-1]).any(dim=1).cpu().numpy())
    all_logits, is_counted = np.concatenate(logits), np.concatenate(differ)
    counted = all_logits[is_counted] if is_counted.any() else all_logits
    return float(np.median(1 / (1 + np.exp(-counted))))


def goals_ahead(length: int, rng: np.random.Generator, *, far_steps: int) -> npt.NDArray[np.int64]:
    """Returns a goal for each frame of a trajectory, 1 to `far_steps` ahead where there is one: int64 (T,)."""
    ahead = np.arange(length) + rng.integers(1, far_steps, length, endpoint=True)
    goals: npt.NDArray[np.int64] = np.minimum(ahead, length - 1)
    return goals


@torch.no_grad()
def recognized_ahead(
    recognizer: GoalRecognizer, trajectories: Trajectories, rng: np.random.Generator, *, far_steps: int
) -> Tensor:
    """Returns the probability that each frame is at a goal ahead of it, trajectory after trajectory: float32 (N,)."""
    reached = []
    for item, length in enumerate(trajectories.lengths().tolist()):
        embeddings = encode_trajectory(recognizer, trajectories, item)  # (T, embedding_size)
        goals = embeddings[goals_ahead(length, rng, far_steps=far_steps)]
        reached.append(proximity_logit(embeddings, goals).sigmoid())  # (T,)
    return torch.cat(reached)
