"""Labels of trajectories by networks, and the figures of labels against the truth."""

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
import torch

from experiments.workbench.results import Outcome, Sample
from freerein import metrics
from freerein.learning.trajectories import Trajectories
from freerein.types.segmentation import NO_SKILL
from freerein_segmentation.core import decoding
from freerein_segmentation.core.decoding import smooth
from freerein_segmentation.model import SegmentationNetwork
from freerein_segmentation.objectives import OBJECTIVES
from freerein_segmentation.objectives.set_likelihood import set_likelihood
from freerein_segmentation.training import Confidence, SegmentationConfig, gather

Labels = npt.NDArray[np.int64]
Probabilities = npt.NDArray[np.float32]

FRAME_ACCURACY, DECODED_ACCURACY, KEPT_ACCURACY = "frame_accuracy", "decoded_accuracy", "kept_accuracy"
CONFIDENT_ACCURACY = "confident_kept_accuracy"
TAG_LOSS, GUESSED_TAG_LOSS = "validation_loss", "guessed_validation_loss"
"""Loss of held-out tags: of a network, and of the best scores that are the same for all timesteps."""

ACTION_LOSS = "action_loss"
"""Negative log-likelihood of held-out actions given frame and label, in nats per timestep, whatever the labels' source;
see `freerein_segmentation.training.held_out_action_loss`."""

CONFIDENCE, IS_DECIDED = "confidence", "is_decided"
"""Of held-out timesteps, before a final objective; see `freerein_segmentation.training.Confidence`."""

SMOOTHING, LEAST_SEGMENT = 2.0, 5
"""What is decoded: the Gaussian's standard deviation and the shortest segment, in timesteps. Chapter 2 rejects segments
under 5 timesteps and does not tell its Gaussian."""

LEAST_CONFIDENCE = 0.8
"""Smoothed probability under which a timestep is rejected where uncertain ones are, too; chosen in `blocks`."""

_CLAIMED = {"validation": CONFIDENT_ACCURACY, "test": DECODED_ACCURACY}
"""What claims are made of beside frame accuracy, by split."""

_BATCH, _GUESSED_STEPS = 16, 300


@torch.inference_mode()
def predict(network: SegmentationNetwork, seen: Trajectories, *, count: int) -> list[Probabilities]:
    """Returns the skills' probabilities at each timestep of the first `count` trajectories, float32 (T, K) each."""
    spec, lengths = network.spec, seen.lengths()[:count]
    predicted = [np.empty((length, len(spec.skills)), np.float32) for length in lengths]
    device = next(network.parameters()).device
    for start in range(0, count, _BATCH):
        items = range(start, min(start + _BATCH, count))
        for phase in range(spec.stride):
            batch = gather(seen, items, [phase] * len(items), spec=spec, device=device)
            scores, mask = network(batch.frames, batch.actions, batch.lengths)  # (B, T, K), (B, T)
            probabilities = scores.softmax(dim=2)[mask].cpu().numpy()  # (N, K)
            parts = np.split(probabilities, batch.lengths.cumsum(dim=0).tolist()[:-1])
            for item, part in zip(items, parts, strict=True):
                predicted[item][phase % lengths[item] :: spec.stride] = part
    return predicted


def guessed_tag_loss(config: SegmentationConfig, tags: npt.NDArray[np.bool_]) -> float:
    """Returns `GUESSED_TAG_LOSS` of tags, bool (n, K), by the loss that ends a fit of a configuration."""
    objective = OBJECTIVES[config.objective] if config.final_objective == "none" else set_likelihood
    known = torch.from_numpy(tags)
    shares = (known / known.sum(dim=1, keepdim=True)).mean(dim=0)  # (K,): best where a skill of each tag is pooled
    constant = shares.clamp(min=1e-6).log().requires_grad_()
    optimiser, mask = torch.optim.Adam([constant], lr=0.1), torch.ones(len(known), 1, dtype=torch.bool)
    losses = []
    for _ in range(_GUESSED_STEPS):
        loss = objective(constant.expand(len(known), 1, -1), mask, known).mean()
        losses.append(loss.item())
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]  # torch does not annotate it
        optimiser.step()
    return min(losses)


def decode(probabilities: Probabilities) -> Labels:
    """Returns labels int64 (T,) as the service decodes them: smoothed, short segments merged."""
    smoothed = smooth(probabilities, sigma=SMOOTHING)
    return decoding.merge_short(smoothed.argmax(axis=1), smoothed, min_segment=LEAST_SEGMENT)


def reject_short(labels: Labels) -> Labels:
    """Returns labels (T,) with -1 in place of segments that are too short."""
    return decoding.reject_short(labels, min_kept=LEAST_SEGMENT)


def reject_uncertain(smoothed: Probabilities) -> Labels:
    """Returns the most probable skills of smoothed probabilities (T, K), with -1 where none is probable enough."""
    confidence = smoothed.max(axis=1)
    return decoding.reject_uncertain(smoothed.argmax(axis=1), confidence, min_confidence=LEAST_CONFIDENCE)


def score_guess(predicted: Sequence[Labels], truth: Sequence[Labels], *, split: str) -> Outcome:
    """Returns the figures of labels, int64 (T,) per trajectory; names begin with the split's.

    Frame accuracy and balanced accuracy are over all timesteps, the edit score and F1@50 are means over trajectories.
    """
    accuracy = _accuracy(predicted, truth)
    figures = {FRAME_ACCURACY: accuracy.mean, **_segment_figures(predicted, truth)}
    balanced = metrics.balanced_accuracy(np.concatenate(predicted), np.concatenate(truth))
    return _named(split, {**figures, "balanced_accuracy": balanced}, {FRAME_ACCURACY: accuracy})


def score(
    predicted: Sequence[Probabilities], decoded: Sequence[Labels], truth: Sequence[Labels], *, split: str
) -> Outcome:
    """Returns the figures of probabilities, float32 (T, K) per trajectory, and of what they are decoded to.

    They are of the most probable skills, as in `score_guess`, of decoded labels, and of what is kept when short
    segments are rejected, after smoothing and without, and when uncertain timesteps are rejected first.
    """
    raw = [each.argmax(axis=1) for each in predicted]
    found = score_guess(raw, truth, split=split)
    accuracy = _accuracy(decoded, truth)
    segments = {f"decoded_{name}": value for name, value in _segment_figures(decoded, truth).items()}
    smoothed = [smooth(each, sigma=SMOOTHING) for each in predicted]
    kept, kept_figures = _kept([reject_short(each.argmax(axis=1)) for each in smoothed], truth)
    confident, confident_figures = _kept([reject_short(reject_uncertain(each)) for each in smoothed], truth)
    unsmoothed, unsmoothed_figures = _kept([reject_short(each) for each in raw], truth)
    figures = {DECODED_ACCURACY: accuracy.mean, **segments, KEPT_ACCURACY: kept.mean, **kept_figures}
    figures |= {CONFIDENT_ACCURACY: confident.mean}
    figures |= {f"confident_{name}": value for name, value in confident_figures.items()}
    figures |= {f"unsmoothed_{KEPT_ACCURACY}": unsmoothed.mean}
    figures |= {f"unsmoothed_{name}": value for name, value in unsmoothed_figures.items()}
    samples = {DECODED_ACCURACY: accuracy, CONFIDENT_ACCURACY: confident}
    more = _named(split, figures, {name: each for name, each in samples.items() if name == _CLAIMED.get(split)})
    return Outcome({**found.figures, **more.figures}, {**found.samples, **more.samples})


def score_confidence(confidence: Confidence) -> Outcome:
    """Returns the figures of a network's confidence, which are label-free."""
    return Outcome({CONFIDENCE: round(confidence.mean, 6), IS_DECIDED: float(confidence.is_decided)}, {})


def _accuracy(predicted: Sequence[Labels], truth: Sequence[Labels]) -> Sample:
    return Sample.of_flags(ours == theirs for ours, theirs in zip(predicted, truth, strict=True))


def _segment_figures(predicted: Sequence[Labels], truth: Sequence[Labels]) -> dict[str, float]:
    pairs = list(zip(predicted, truth, strict=True))
    return {
        "edit_score": float(np.mean([metrics.edit_score(*pair) for pair in pairs])),
        "f1_at_50": float(np.mean([metrics.f1_at(*pair, overlap=0.5) for pair in pairs])),
    }


def _kept(labels: Sequence[Labels], truth: Sequence[Labels]) -> tuple[Sample, dict[str, float]]:
    """Returns the accuracy of labels that are not rejected, over trajectories with any, and how many are kept.

    These are the shares of all timesteps, and of those of the skill that loses most.
    """
    pairs = list(zip(labels, truth, strict=True))
    some = [(ours, theirs) for ours, theirs in pairs if (ours != NO_SKILL).any()]
    correct = [int((ours == theirs).sum()) for ours, theirs in some]
    sample = Sample(correct or [0], [int((ours != NO_SKILL).sum()) for ours, _ in some] or [1])
    all_kept, all_truth = np.concatenate(labels) != NO_SKILL, np.concatenate(truth)
    by_skill = [float(all_kept[all_truth == skill].mean()) for skill in np.unique(all_truth)]
    return sample, {"kept_share": float(all_kept.mean()), "least_kept_share": min(by_skill)}


def _named(split: str, figures: Mapping[str, float], samples: Mapping[str, Sample]) -> Outcome:
    return Outcome(
        {f"{split}.{name}": round(value, 6) for name, value in figures.items()},
        {f"{split}.{name}": sample for name, sample in samples.items()},
    )
