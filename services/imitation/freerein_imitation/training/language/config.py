"""What a fit of a language policy may choose."""

from dataclasses import dataclass
from typing import Literal

from freerein.learning.config import bounded
from freerein.learning.fit_config import FitConfig


@dataclass(frozen=True)
class LanguageConfig(FitConfig):
    """Everything that a fit of a language policy may choose.

    Attributes:
        policy: Which kind of policy this is.
        camera: Whose frames to learn from; empty where the dataset has one camera.
        smallest_crop: The smallest share of a frame's area that is cut out and scaled up again, at random, before it is
            learned from; 1 for whole frames.
        features: Image features.
        words: Features of the sentence.
        hidden: Units of its two layers.
        max_steps_per_goal: Control steps after which a goal is given up; 0 for as many as the longest trajectory has.
        validation_fraction: The share of each goal text's trajectories held out, to choose the best weights.
    """

    policy: Literal["language"] = "language"
    camera: str = ""
    smallest_crop: float = bounded(0.95, least=0.5, most=1.0)
    steps: int = bounded(1000, least=1, most=10_000_000)
    features: int = bounded(128, least=8, most=1024)
    words: int = bounded(32, least=1, most=1024)
    hidden: int = bounded(128, least=8, most=1024)
    max_steps_per_goal: int = bounded(0, least=0, most=1_000_000)
    validation_fraction: float = bounded(0.1, least=0.01, most=0.5)
