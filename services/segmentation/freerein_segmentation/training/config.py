"""Configuration of a segmentation fit."""

from dataclasses import dataclass
from typing import Literal

from freerein.config import bounded, bounded_or_all, one_of
from freerein.data.batch_memory import DEFAULT_BATCH_SIZE, DEFAULT_STEPS
from freerein.errors import InvalidInput
from freerein.learning.encoders import ENCODERS
from freerein.learning.fit_config import DatasetFitConfig
from freerein_segmentation.model import MAX_CONTEXT, Context
from freerein_segmentation.objectives import OBJECTIVES
from freerein_segmentation.training.algorithms import ALGORITHMS


@dataclass(frozen=True)
class SegmentationConfig(DatasetFitConfig):
    """Configuration of a segmentation fit; the rest is the network of section 2.3.

    Attributes:
        objective: Loss of scores against tags.
        final_objective: What replaces it at the end of a fit: `none`, `set_likelihood`, which leaves shares of skills
            free, or `self_training` on labels within the tags.
        final_share: Share of the optimiser steps that the final objective takes.
        rounds: Rounds of self-training, each with labels by the network as it was at its start.
        switching_cost: Cost of each change of the skill in these labels, in nats.
        action_evidence: Weight of what each skill's actions tell of the labels; 0 for none.
        context: Future timesteps, one stride apart, that scores depend on, or all; 0 is the dissertation's. A finite
            number makes streams possible.
        tag_context: Most future timesteps, one stride apart, that they depend on before the final objective, while the
            tags alone are learned. A network that sees how a trajectory ends knows its tags before the skills begin.
        encoder: Image encoder.
        use_actions: Whether executed actions are an input.
        augmentation: Strength of the camera augmentation; 0 for none, as for worlds that are drawn without a camera.
        stride: Temporal stride in timesteps: 1 where skills may be short; more where they are long, to see more
            trajectories in the same time.
        batch_size: Trajectories per optimiser step.
        features: Number of image features.
        hidden_size: LSTM units per direction.
    """

    objective: str = one_of(OBJECTIVES, "lse_per_timestep")
    final_objective: str = one_of(ALGORITHMS, "none")
    final_share: float = bounded(0.5, least=0.01, most=0.99)
    rounds: int = bounded(3, least=1, most=100)
    switching_cost: float = bounded(1.0, least=0.0, most=100.0)
    action_evidence: float = bounded(0.0, least=0.0, most=10.0)
    context: int | Literal["all"] = bounded_or_all("all", least=0, most=MAX_CONTEXT)
    tag_context: int | Literal["all"] = bounded_or_all("all", least=0, most=MAX_CONTEXT)
    encoder: str = one_of(ENCODERS, "patch")
    use_actions: bool = True
    augmentation: float = bounded(1.0, least=0.0, most=1.0)
    stride: int = bounded(1, least=1, most=100)
    steps: int = bounded(DEFAULT_STEPS, least=1, most=10_000_000)
    batch_size: int = bounded(DEFAULT_BATCH_SIZE, least=1, most=1024)
    features: int = bounded(64, least=8, most=1024)
    hidden_size: int = bounded(100, least=8, most=1024)
    evaluate_every: int = bounded(100, least=1, most=1_000_000)

    def __post_init__(self) -> None:
        """Raises InvalidInput where a key has no effect."""
        if self.action_evidence and self.final_objective != "self_training":
            raise InvalidInput(
                f"`action_evidence` is of self-training; got it with final_objective {self.final_objective}.",
                field="config.action_evidence",
                hint="Set final_objective=self_training.",
            )
        if self.tag_context != "all" and self.final_objective == "none":
            raise InvalidInput(
                "`tag_context` is of fits with a final objective; got it with final_objective none.",
                field="config.tag_context",
                hint="Set `context` alone, or a final_objective.",
            )

    @property
    def context_before_final(self) -> Context:
        """Future timesteps that scores depend on before the final objective."""
        if self.tag_context == "all" or self.context == "all":
            return self.context if self.tag_context == "all" else self.tag_context
        return min(self.tag_context, self.context)
