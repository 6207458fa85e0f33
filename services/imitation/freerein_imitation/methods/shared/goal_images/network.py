"""Networks that follow goal images: what they share."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor, nn

from freerein.config import bounded, one_of
from freerein.learning.encoders import ENCODERS, CameraEncoders, FrameTensors
from freerein.learning.image_statistics import statistics_sizes
from freerein.learning.in_distribution import InDistribution
from freerein.learning.inputs import InputSpec
from freerein_imitation.methods.shared.action_heads import AUTO, HEADS, ActionHead, head_of
from freerein_imitation.methods.shared.goal_images.pair_encoder import PairEncoder
from freerein_imitation.methods.shared.goal_images.recognizer import (
    GoalRecognizer,
    check_embedding_size,
    proximity_logit,
)
from freerein_imitation.model.torch_policy import PolicyNetwork


@dataclass(frozen=True, kw_only=True)
class GoalImagesSpec(InputSpec):
    """Inputs, outputs and sizes of the networks.

    Attributes:
        encoder: Image encoder of the policy and of the recognizer, which share no weights.
        features: Image features per camera of the policy.
        hidden_size: Units of the policy's hidden layers.
        embedding_size: Size of the recognizer's embeddings, and its image features per camera.
        recognizer_encoder: Image encoder of the recognizer; empty for `encoder`.
        head: Action head; `auto` for `categorical` where actions are choices, else `bins`.
        temperature: Divisor of logits before actions are drawn; 0 for the likeliest actions.
        fusion: Whether the policy sees the features of observation and goal alone, `late`, or those of both images
            together, too, `early`.

    Raises:
        InvalidInput: Cameras, actions or `embedding_size` are out of bounds; an encoder may need more features. Or the
            head is of other actions.
    """

    encoder: str = one_of(ENCODERS, "spatial")
    features: int = bounded(128, least=8, most=1024)
    hidden_size: int = bounded(128, least=8, most=1024)
    embedding_size: int = bounded(64, least=2, most=1024)
    recognizer_encoder: str = one_of(("", *ENCODERS), "")
    head: str = one_of((AUTO, *HEADS), AUTO)
    temperature: float = bounded(0.0, least=0.0, most=100.0)
    fusion: Literal["late", "early"] = "late"

    def __post_init__(self) -> None:
        super().__post_init__()
        head_of(self.head, self.action)
        check_embedding_size(self.recognizer_encoder or self.encoder, self.embedding_size)

    def make_head(self, hidden: int) -> ActionHead:
        """Returns an untrained action head for H hidden features."""
        return head_of(self.head, self.action)(hidden, self.action, self.cameras)


class ActionNetwork(nn.Module, ABC):
    """Base of the networks that choose actions.

    Attributes:
        encoder: Encodes observations and goals.
        pair_encoder: Encodes both together; None with late fusion.
        action_head: Turns contexts into actions.
        stop_head: Turns contexts into the logit that the goal is reached; None where a recognizer tells.
        seen_size: Numbers of `seen`.
        recurrent_size: R, numbers of recurrent state.
    """

    action_head: ActionHead
    recurrent_size = 0

    def __init__(self, spec: GoalImagesSpec) -> None:
        super().__init__()
        self.stop_head: nn.Linear | None = None
        self.encoder = CameraEncoders(ENCODERS[spec.encoder], spec.cameras, features=spec.features)
        self.pair_encoder = PairEncoder(spec.cameras, features=spec.features) if spec.fusion == "early" else None
        self.seen_size = 2 * self.encoder.size + (0 if self.pair_encoder is None else self.pair_encoder.size)

    @property
    def code_size(self) -> int:
        """Numbers of the code of a frame: D of its features, what the head adds, and what early fusion does."""
        return self._before_pairs + (0 if self.pair_encoder is None else self.pair_encoder.code_size)

    def encode(self, frames: FrameTensors) -> Tensor:
        """Returns codes, float32 (N, code size), of frames uint8 (N, H, W, C) by camera."""
        parts = [self.encoder(frames)]
        if self.action_head.code_size:
            parts.append(self.action_head.encode(frames))
        if self.pair_encoder is not None:
            parts.append(self.pair_encoder.encode(frames))
        return torch.cat(parts, dim=1)

    def seen(self, codes: Tensor, goals: Tensor) -> Tensor:
        """Returns what hidden layers see of observations and goals, (..., seen_size), of codes (..., code size)."""
        parts = [each[..., : self.encoder.size] for each in (codes, goals)]
        if self.pair_encoder is not None:
            parts.append(self.pair_encoder(*(each[..., self._before_pairs :] for each in (codes, goals))))
        return torch.cat(parts, dim=-1)

    @property
    def _before_pairs(self) -> int:
        return self.encoder.size + self.action_head.code_size

    def context(self, hidden: Tensor, codes: Tensor, goals: Tensor) -> Tensor:
        """Returns the heads' inputs: hidden features (..., H), and the head's own part of codes (..., code size)."""
        added = [each[..., self.encoder.size : self._before_pairs] for each in (codes, goals)]
        return torch.cat([hidden, *added], dim=-1) if self.action_head.code_size else hidden

    @abstractmethod
    def step(self, codes: Tensor, goals: Tensor, previous: Tensor, recurrent: Tensor) -> tuple[Tensor, Tensor]:
        """Returns contexts, float32 (B, C), and the next recurrent states.

        Args:
            codes: Of observations, float32 (B, code size).
            goals: Of goals, float32 (B, code size).
            previous: a_{t-1}, float32 (B, A), zeros for no action, or int64 (B, 1), -1 for no action.
            recurrent: Recurrent states, float32 (B, R).
        """


class GoalImagesNetwork(PolicyNetwork):
    """Base of the networks: an action network and a goal recognizer, which share no weights.

    Attributes:
        recognizer: None where the action network's `stop_head` tells that a goal is reached.
    """

    spec: GoalImagesSpec

    def __init__(self, spec: GoalImagesSpec, policy: ActionNetwork) -> None:
        super().__init__()
        self.spec = spec
        self.policy = policy
        encoder = spec.recognizer_encoder or spec.encoder
        self.recognizer = (
            GoalRecognizer(encoder, spec.cameras, embedding_size=spec.embedding_size)
            if policy.stop_head is None
            else None
        )
        self.in_distribution = InDistribution(*statistics_sizes(spec.cameras))

    def fit_normalisation(self, frames: FrameTensors, *, generator: torch.Generator) -> None:
        """Sets what is not trained of the encoders from training frames, uint8 (N, H, W, C) by camera."""
        self.policy.encoder.fit_normalisation(frames, generator=generator)
        if self.policy.pair_encoder is not None:
            self.policy.pair_encoder.fit_normalisation(frames)
        if self.recognizer is not None:
            self.recognizer.encoder.fit_normalisation(frames, generator=generator)

    def forward(self, frames: FrameTensors) -> Tensor:
        """Returns the policy's codes of frames beside the recognizer's embeddings, if any: float32 (N, G)."""
        codes = self.policy.encode(frames)
        return codes if self.recognizer is None else torch.cat([codes, self.recognizer(frames)], dim=1)

    def reached(self, context: Tensor, codes: Tensor, goals: Tensor) -> Tensor:
        """Returns probabilities that goals are reached, float32 (B,).

        Args:
            context: Of the action network, float32 (B, C).
            codes: Of observations, from `forward`, float32 (B, G).
            goals: Of goals, likewise.
        """
        if self.policy.stop_head is not None:
            logits: Tensor = self.policy.stop_head(context)[:, 0]
        else:
            size = self.policy.code_size
            logits = proximity_logit(codes[:, size:], goals[:, size:])
        return logits.sigmoid()
