"""What a grounding model's heat means, and how well it tells nouns: measured on pictures of single objects."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import torch

from freerein_reward.model import DualEncoder, contrast
from freerein_reward.training import objects
from freerein_reward.training.grounding import GroundingLearner

_GROUP = 4
_GROUPS = 10
_LEVELS = 200


def calibrate(network: DualEncoder, learner: GroundingLearner) -> None:
    """Sets the heat at which a thing is as likely there as not: where held-out pictures are told best.

    Each picture is asked for a few colours at a time, as a user asks for a few things.
    """
    peaks, shown = _peaks(network, learner)
    levels = np.quantile(peaks, np.linspace(0, 1, _LEVELS))
    told = [(peaks[shown] > level).mean() + (peaks[~shown] <= level).mean() for level in levels]
    network.spec = replace(network.spec, presence_at=float(max(levels[int(np.argmax(told))], 1e-6)))


def measure(network: DualEncoder, learner: GroundingLearner) -> dict[str, float]:
    """Returns how well held-out pictures are told: the share of colours, of shapes, and of what is there and not."""
    peaks, shown = _peaks(network, learner)
    told = peaks > network.spec.presence_at
    return {
        "colour_accuracy": _accuracy(network, learner, objects.COLOURS, "colour"),
        "shape_accuracy": _accuracy(network, learner, objects.SHAPES, "shape"),
        "presence_accuracy": float((told[shown].mean() + 1 - told[~shown].mean()) / 2),
    }


@torch.no_grad()
def _peaks(network: DualEncoder, learner: GroundingLearner) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
    """Returns the peaks of own heat, and whether what was asked for is there: both (groups, N, 4), all as one axis."""
    rng = np.random.default_rng(learner.config.seed)
    said = network.image.attention.cells(network.image.maps(learner.held_out.images[:, 0]))  # (N, S, D)
    peaks, shown = [], []
    for _ in range(_GROUPS):
        colours = [objects.COLOURS[place] for place in rng.permutation(len(objects.COLOURS))[:_GROUP]]
        directions = contrast(_embed(network, [f"a {colour} thing" for colour in colours]))
        heat = said @ directions.T  # (N, S, 4)
        own = heat.where(heat == heat.amax(dim=2, keepdim=True), 0.0)
        peaks.append(own.amax(dim=1).cpu().numpy())
        shown.append(
            [[thing is not None and thing.colour == colour for colour in colours] for thing in learner.held_out.shown]
        )
    return np.concatenate(peaks).ravel(), np.array(shown).ravel()


@torch.no_grad()
def _accuracy(network: DualEncoder, learner: GroundingLearner, names: Sequence[str], attribute: str) -> float:
    """Returns the share of held-out pictures of which the right name fits best."""
    images, shown = learner.held_out.images, learner.held_out.shown
    nouns = [f"a {name} thing" if attribute == "colour" else f"a {name}" for name in names]
    winners = (network.embed_images(images) @ _embed(network, nouns).T).argmax(dim=1).tolist()
    return float(
        np.mean([names[best] == getattr(thing, attribute) for best, thing in zip(winners, shown, strict=True) if thing])
    )


def _embed(network: DualEncoder, texts: Sequence[str]) -> torch.Tensor:
    ids = torch.from_numpy(network.tokenizer(texts).ids).to(network.temperature.log_scale.device)
    return network.embed_texts(ids)
