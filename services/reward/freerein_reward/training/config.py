"""What a training may choose."""

from dataclasses import dataclass

from freerein.learning.config import bounded
from freerein.learning.fit_config import FitConfig


@dataclass(frozen=True)
class GroundingConfig(FitConfig):
    """Everything that the grounding model's training may choose.

    Attributes:
        images: How many different pictures there are to learn from; each is drawn anew from its number.
        held_out: How many others choose the best weights.
        batch_size: Pictures per update.
        width: Channels of the image tower's stem.
        depth: Bottlenecks per stage.
        features: How many numbers an embedding has.
    """

    images: int = bounded(100_000, least=1, most=100_000_000)
    held_out: int = bounded(512, least=2, most=100_000)
    steps: int = bounded(1200, least=1, most=10_000_000)
    batch_size: int = bounded(64, least=2, most=4096)
    lr: float = bounded(3e-3, least=1e-7, most=1.0)
    warmup_steps: int = bounded(50, least=1, most=1_000_000)
    width: int = bounded(8, least=8, most=128)
    depth: int = bounded(1, least=1, most=8)
    features: int = bounded(64, least=8, most=1024)
    evaluate_every: int = bounded(200, least=1, most=1_000_000)


@dataclass(frozen=True)
class RewardConfig(FitConfig):
    """Everything that a fit of a reward model may choose.

    Attributes:
        cameras: Whose frames to learn from; none where the dataset has one camera. Captions are told from the first.
        phrases: The noun phrases that goals will be made of.
        epsilon: How near counts as near: the things' width as a share of the image's.
        presence: How sure the grounding model must be that an image shows a thing for a caption to name it.
        batch_size: Images per update.
        further_heads: How many things the image tower asks the places of, beside those that the phrases name.
        hidden: Units of each of the two layers after it has places.
        features: How many numbers an embedding has.
        validation_fraction: The share of trajectories held out to choose the best weights, by their captions alone.
    """

    cameras: tuple[str, ...] = ()
    phrases: tuple[str, ...] = ("a red block", "a green block", "a yellow block", "a blue block")
    epsilon: float = bounded(0.1, least=0.001, most=0.5)
    presence: float = bounded(0.95, least=0.0, most=1.0)
    batch_size: int = bounded(128, least=2, most=4096)
    lr: float = bounded(3e-3, least=1e-7, most=1.0)
    warmup_steps: int = bounded(50, least=1, most=1_000_000)
    further_heads: int = bounded(12, least=0, most=256)
    hidden: int = bounded(256, least=1, most=4096)
    features: int = bounded(64, least=8, most=1024)
    validation_fraction: float = bounded(0.1, least=0.01, most=0.5)
