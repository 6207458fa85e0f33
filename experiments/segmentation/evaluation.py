"""Labels of trajectories by networks and by guessing, and their figures against the truth."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import torch

from experiments.workbench.results import Outcome, Sample
from freerein import metrics
from freerein.learning.trajectories import Trajectories
from freerein_segmentation.model import SegmentationNetwork
from freerein_segmentation.training import gather

Labels = npt.NDArray[np.int64]

_BATCH = 128
FRAME_ACCURACY = "frame_accuracy"


@torch.inference_mode()
def predict(network: SegmentationNetwork, seen: Trajectories, *, count: int) -> list[Labels]:
    """Returns the most probable skill at each timestep of the first `count` trajectories, int64 (T,) each."""
    predicted: list[Labels] = []
    device = next(network.parameters()).device
    for start in range(0, count, _BATCH):
        items = range(start, min(start + _BATCH, count))
        batch = gather(seen, items, [0] * len(items), spec=network.spec, device=device)
        scores, mask = network(batch.frames, batch.actions, batch.lengths)  # (B, T, K), (B, T)
        labels = scores.argmax(dim=2)[mask].cpu().numpy()  # (N,)
        predicted += np.split(labels, batch.lengths.cumsum(dim=0).tolist()[:-1])
    return predicted


def guess_skill(truth: Labels, *, skills: int, rng: np.random.Generator) -> Labels:
    """Returns a random skill for each timestep, int64 (T,): the dissertation's Random."""
    return rng.integers(skills, size=len(truth))


def guess_tag(truth: Labels, *, skills: int, rng: np.random.Generator) -> Labels:
    """Returns a random one of the trajectory's skills for each timestep, int64 (T,): the dissertation's Random-Cls."""
    return rng.choice(np.unique(truth), size=len(truth))


def guess_majority(truth: Labels, *, skills: int, rng: np.random.Generator) -> Labels:
    """Returns the trajectory's longest skill for all timesteps, int64 (T,); it knows which that is."""
    return np.full(len(truth), np.bincount(truth).argmax())


def score(predicted: Sequence[Labels], truth: Sequence[Labels], *, split: str) -> Outcome:
    """Returns the figures of predicted labels, int64 (T,) per trajectory; names begin with the split's.

    Frame accuracy and balanced accuracy are over all timesteps, the edit score and F1@50 are means over trajectories.
    """
    pairs = list(zip(predicted, truth, strict=True))
    correct = [int((ours == theirs).sum()) for ours, theirs in pairs]
    accuracy = Sample(correct, [len(each) for each in truth])
    figures = {
        FRAME_ACCURACY: accuracy.mean,
        "balanced_accuracy": metrics.balanced_accuracy(np.concatenate(predicted), np.concatenate(truth)),
        "edit_score": float(np.mean([metrics.edit_score(*pair) for pair in pairs])),
        "f1_at_50": float(np.mean([metrics.f1_at(*pair, overlap=0.5) for pair in pairs])),
    }
    return Outcome(
        {f"{split}.{name}": round(value, 6) for name, value in figures.items()}, {f"{split}.{FRAME_ACCURACY}": accuracy}
    )
