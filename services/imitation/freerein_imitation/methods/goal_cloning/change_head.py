"""Training of a recognizer's head for changes, on the features of whole trajectories once their encoder is trained.

Batches that also train an encoder are a few windows. With features at hand a batch is drawn from all frames, so that
each frame has partners at its own place in its trajectory, and in others.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn import functional

from freerein.learning import weights
from freerein_imitation.methods.goal_cloning.odometry_recognizer import OdometryRecognizer

_LR = 1e-3
_CALIBRATION_BATCHES = 20
_ANCHORS = 384
_CANDIDATES = 48
_LEAST_CLOSE_STEPS_OF_HEAD = 5  # sooner, fingers have hardly moved, and tell that little time has passed
_FAR_FROM = 0.3  # share of the updates before far pairs take part
_LEAST_ALIKE_SHARE_OF_HEAD = 0.01  # of close pairs that look less alike than a changed scene


@dataclass(frozen=True, eq=False)
class ChangeData:
    """N frames of trajectories, one trajectory after the other.

    Attributes:
        features: float32 (N, D).
        places: In units of the largest distance of nearby ones, 0 along axes that do not count, float32 (N, A).
        trajectories: Trajectory of each frame, int64 (N,), from 0.
    """

    features: Tensor
    places: npt.NDArray[np.float32]
    trajectories: npt.NDArray[np.int64]


@torch.no_grad()
def change_data(recognizer: OdometryRecognizer, features: Sequence[Tensor]) -> ChangeData:
    """Returns the data of trajectories, by the features of each, float32 (T, D)."""
    every = torch.cat(list(features))
    places = (recognizer.places(every) / recognizer.tolerance).where(recognizer.counts, 0.0)
    lengths = [len(each) for each in features]
    return ChangeData(every, places.cpu().numpy(), np.repeat(np.arange(len(lengths)), lengths))


def fit_change_head(
    recognizer: OdometryRecognizer,
    views: Sequence[ChangeData],
    *,
    updates: int,
    close_steps: int,
    far_steps: int,
    seed: int,
) -> None:
    """Trains the head anew: pairs close in time are unchanged, pairs of two trajectories are not.

    `views` are the same trajectories as they were recorded, then augmented: in every second update the frames of all
    pairs are in one of them. Later, pairs far in time count as changed where they look less alike than nearly all that
    are close in time. The recognizer's odometry is trained. `close_steps` and `far_steps` are the most and the fewest
    actions between frames that are close and far in time.
    """
    weights.initialise(recognizer.change, generator=torch.Generator().manual_seed(seed))
    rng, optimiser = np.random.default_rng(seed), torch.optim.Adam(recognizer.change.parameters(), _LR)
    for update in range(updates):
        is_augmented = update % 2 == 1 and len(views) > 1
        data = views[int(rng.integers(len(views)))] if is_augmented else views[0]
        pairs = sample_time_pairs(data, rng, close_steps=close_steps, far_steps=far_steps)
        close, far, strangers = (_logits(recognizer, data, each) for each in pairs)
        if not len(close):
            continue
        changed = strangers
        if update >= _FAR_FROM * updates:
            changed = torch.cat([strangers, far[far.detach() < close.detach().quantile(_LEAST_ALIKE_SHARE_OF_HEAD)]])
        logits, unchanged = torch.cat([close, changed]), torch.zeros(len(close) + len(changed), device=close.device)
        unchanged[: len(close)] = 1
        for group in optimiser.param_groups:
            group["lr"] = _LR * min(1.0, 2 * (1 - update / updates))
        optimiser.zero_grad()
        functional.binary_cross_entropy_with_logits(logits, unchanged).backward()  # type: ignore[no-untyped-call]
        optimiser.step()


@torch.no_grad()
def time_logits(
    recognizer: OdometryRecognizer, data: ChangeData, *, close_steps: int, far_steps: int, seed: int
) -> tuple[Tensor, Tensor]:
    """Returns logits that nothing changed, float32 (P,), of pairs close in time, and of pairs far in time."""
    rng = np.random.default_rng(seed)
    batches = [
        sample_time_pairs(data, rng, close_steps=close_steps, far_steps=far_steps)[:2]
        for _ in range(_CALIBRATION_BATCHES)
    ]
    close, far = (_logits(recognizer, data, np.concatenate(each, axis=1)) for each in zip(*batches, strict=True))
    return close, far


def sample_time_pairs(
    data: ChangeData, rng: np.random.Generator, *, close_steps: int, far_steps: int
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Returns pairs of frames at nearby places: close in time, far in time, of two trajectories; int64 (2, P) each."""
    count = len(data.trajectories)
    anchors = rng.integers(count, size=(_ANCHORS, 1))
    shape = _ANCHORS, _CANDIDATES
    steps = rng.integers(min(_LEAST_CLOSE_STEPS_OF_HEAD, close_steps), close_steps, shape, endpoint=True)
    soon = anchors + steps * rng.choice((-1, 1), shape)
    own = data.trajectories[anchors]
    starts, ends = (np.searchsorted(data.trajectories, own, side=side) for side in ("left", "right"))
    later = starts + (rng.random(shape) * (ends - starts)).astype(np.int64)
    others = rng.integers(count, size=shape)
    return (
        _choose(data, rng, anchors, soon, (soon >= starts) & (soon < ends)),
        _choose(data, rng, anchors, later, np.abs(later - anchors) >= far_steps),
        _choose(data, rng, anchors, others, data.trajectories[others] != own),
    )


def _choose(
    data: ChangeData,
    rng: np.random.Generator,
    anchors: npt.NDArray[np.int64],
    candidates: npt.NDArray[np.int64],
    counts: npt.NDArray[np.bool_],
) -> npt.NDArray[np.int64]:
    """Returns, of each anchor that has some, a random candidate that counts at a nearby place: int64 (2, P)."""
    candidates = np.where(counts, candidates, anchors)
    is_near = np.abs(data.places[candidates] - data.places[anchors]).max(axis=2) <= 1
    usable = counts & is_near
    chosen = np.where(usable, rng.random(usable.shape), -1.0).argmax(axis=1)
    kept = usable.any(axis=1)
    return np.stack([anchors[kept, 0], candidates[kept, chosen[kept]]])


def _logits(recognizer: OdometryRecognizer, data: ChangeData, pairs: npt.NDArray[np.int64]) -> Tensor:
    first, second = (data.features[torch.from_numpy(each).to(data.features.device)] for each in pairs)
    return recognizer.unchanged_logit(first, second)
