"""Configuration of fits to goal images."""

from dataclasses import dataclass
from typing import Literal

from freerein.config import bounded, one_of
from freerein.errors import InvalidInput
from freerein.learning.encoders import ENCODERS
from freerein.learning.fit_config import DatasetFitConfig
from freerein_imitation.methods.shared.action_heads import AUTO, HEADS


@dataclass(frozen=True)
class GoalImagesConfig(DatasetFitConfig):
    """Base configuration of a fit to goal images; validation trajectories choose the reached threshold, too.

    Attributes:
        encoder: Image encoder of the policy, and of a goal recognizer that is trained with it.
        min_goal_steps: Fewest actions from a slice's first frame to its goal.
        max_goal_steps: Most actions from a slice's first frame to its goal.
        close_steps: Frames at most so many actions apart are positive pairs of a goal recognizer that is trained.
        far_steps: Frames of one trajectory more actions apart than that are negative pairs.
        batch_size: Windows per update; each is cut into many slices.
        features: Image features per camera of the policy.
        hidden_size: Units of the policy's hidden layers.
        embedding_size: Size of such a recognizer's embeddings, and its image features per camera.
        head: Action head: `categorical` for choices; `bins` for numbers; for pick and place `autoregressive` or `map`,
            too; `auto` for the first of these that fits.
        temperature: Divisor of logits before actions are drawn; 0 for the likeliest actions.
        fusion: Whether the policy sees the features of observation and goal alone, `late`, or those of both images
            together, too, `early`: it learns sooner to act for the goal, where cameras move.
        recognizer: Model of the method `goal_recognizer` whose goal recognizer is copied; empty to train one, too.
        recognizer_version: Its version; empty for the active one.

    Raises:
        InvalidInput: A minimum is above its maximum, or a key of a recognizer's training is given beside `recognizer`.
    """

    encoder: str = one_of(ENCODERS, "spatial")
    min_goal_steps: int = bounded(5, least=1, most=1000)
    max_goal_steps: int = bounded(15, least=1, most=1000)
    close_steps: int = bounded(2, least=1, most=1000)
    far_steps: int = bounded(15, least=1, most=10_000)
    steps: int = bounded(300, least=1, most=10_000_000)
    batch_size: int = bounded(24, least=1, most=1024)
    lr: float = bounded(6e-3, least=1e-7, most=1.0)
    features: int = bounded(128, least=8, most=1024)
    hidden_size: int = bounded(128, least=8, most=1024)
    embedding_size: int = bounded(64, least=2, most=1024)
    evaluate_every: int = bounded(50, least=1, most=1_000_000)
    head: str = one_of((AUTO, *HEADS), AUTO)
    temperature: float = bounded(0.0, least=0.0, most=100.0)
    fusion: Literal["late", "early"] = "late"
    recognizer: str = ""
    recognizer_version: str = ""

    def __post_init__(self) -> None:
        for less, more in (("min_goal_steps", "max_goal_steps"), ("close_steps", "far_steps")):
            if getattr(self, less) > getattr(self, more):
                raise InvalidInput(
                    f"`{less}` must not be above `{more}`; got {getattr(self, less)} and {getattr(self, more)}.",
                    field=f"config.{less}",
                )
        own = [key for key in ("close_steps", "embedding_size") if getattr(self, key) != getattr(type(self), key)]
        if self.recognizer and own:
            raise InvalidInput(
                f"`{own[0]}` is of fits that train a goal recognizer; got it with the recognizer that is to be copied.",
                field=f"config.{own[0]}",
                hint=f"Leave out {own[0]}, or fit a recognizer with it.",
            )
