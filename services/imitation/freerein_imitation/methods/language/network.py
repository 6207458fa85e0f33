"""The language-conditioned policy of section 4.3, into which single-task policies are distilled.

The text encoder is frozen and no part of the network, which takes the codes of texts (`GoalTextReader`). Of these it
uses the principal components of the training goal texts only: along other directions there was nothing to learn from.
"""

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn import functional

from freerein.config import bounded, one_of
from freerein.learning.actor_critic.object_encoder import OBJECT_ENCODER
from freerein.learning.encoders import ENCODERS, CameraEncoders, FrameTensors
from freerein.learning.encoders.clip import ClipImageSpec
from freerein.learning.image_statistics import statistics_sizes
from freerein.learning.in_distribution import InDistribution
from freerein.learning.inputs import InputSpec
from freerein_imitation.methods.language.recognizer import GoalTextRecognizer
from freerein_imitation.methods.language.teacher_object_encoder import TeacherObjectEncoder
from freerein_imitation.methods.language.texts.goal_text_codes import PAIR, RELATIONS, TextCode, statement_size
from freerein_imitation.methods.language.texts.goal_text_reader import GoalTextReader
from freerein_imitation.model.torch_policy import PolicyNetwork

Conditioning = Literal["text", "code", "none"]
Fusion = Literal["film", "concatenate"]
"""Kinds of conditioning, and of its fusion with image features; see `LanguageConfig`."""

MAX_COMPONENTS = 64
MAX_KNOWN_TEXTS = 10_000

_LEAST_SINGULAR_VALUE = 1e-2  # as a share of the largest


@dataclass(frozen=True, kw_only=True)
class LanguageSpec(InputSpec):
    """Inputs, outputs and sizes of a network.

    Attributes:
        text_size: Size of the text encoder's embeddings.
        text_components: Principal components of the training goal texts.
        known_texts: Training goal texts.
        conditioning: As in `LanguageConfig`.
        fusion: As in `LanguageConfig`, like the next two.
        text_code: Kind of a text's code.
        unseen_objects: Whether goals may name others than its training texts do.
        eye: Sizes of the image encoder of its object encoder; None for an image encoder that is trained.
        phrases: Noun phrases that the object encoder locates.
        predicts_reached: Whether it says that the goal is reached.
        reached_steps: As in `LanguageConfig`.
        encoder: Image encoder.
        features: Image features per camera; unused with an object encoder.
        text_features: Size of the text features.
        hidden_size: Units of the two hidden layers.
    """

    text_size: int = bounded(384, least=1, most=4096)
    text_components: int = bounded(1, least=1, most=MAX_COMPONENTS)
    known_texts: int = bounded(1, least=1, most=MAX_KNOWN_TEXTS)
    conditioning: Conditioning = "text"
    fusion: Fusion = "film"
    text_code: TextCode = "statement"
    unseen_objects: bool = False
    eye: ClipImageSpec | None = None
    phrases: tuple[str, ...] = ()
    predicts_reached: bool = False
    reached_steps: int = bounded(1, least=1, most=256)
    encoder: str = one_of((OBJECT_ENCODER, *ENCODERS), "spatial")
    features: int = bounded(128, least=8, most=1024)
    text_features: int = bounded(32, least=1, most=1024)
    hidden_size: int = bounded(128, least=8, most=1024)

    @property
    def condition_size(self) -> int:
        """Size of what the network gets of a text."""
        if self.conditioning == "code":
            return self.known_texts
        return len(RELATIONS) if self.eye is not None else self.text_components


class LanguageNetwork(PolicyNetwork):
    """pi(a_t | x_t, text): image features modulated by the text (FiLM), two hidden layers, action head.

    With an object encoder, image features are the keypoints of the two things that the text names, and the text's code
    is the relation alone. Without a text they are those of all things.

    Attributes:
        reader: Reads goal texts; trained before, on text alone.
        recognizer: Says whether the modulated features show the goal; None where the network does not.
    """

    spec: LanguageSpec
    text_mean: Tensor
    text_basis: Tensor
    known_texts: Tensor
    known_statements: Tensor

    def __init__(self, spec: LanguageSpec) -> None:
        super().__init__()
        self.spec = spec
        self.encoder = _encoder(spec)
        view_size = self._view_size
        self.text_layer = nn.Linear(spec.condition_size, spec.text_features)
        if spec.fusion == "film":
            self.film = nn.Linear(spec.text_features, 2 * view_size)
        else:
            view_size += spec.text_features
        self.hidden1 = nn.Linear(view_size, spec.hidden_size)
        self.hidden2 = nn.Linear(spec.hidden_size, spec.hidden_size)
        self.action_head = nn.Linear(spec.hidden_size, spec.encoded_action_size)
        self.in_distribution = InDistribution(*statistics_sizes(spec.cameras))
        self.reader = GoalTextReader(spec.text_size).requires_grad_(False)
        self.recognizer = GoalTextRecognizer(view_size, spec.hidden_size) if spec.predicts_reached else None
        self.register_buffer("text_mean", torch.zeros(self.reader.code_size))
        self.register_buffer("text_basis", torch.zeros(self.reader.code_size, spec.text_components))
        self.register_buffer("known_texts", torch.zeros(spec.known_texts, spec.text_components))
        if spec.eye is not None:
            self.register_buffer("known_statements", torch.zeros(spec.known_texts, statement_size(spec.phrases)))

    @property
    def _view_size(self) -> int:
        """Numbers that the layers get of frames, before the text modulates them."""
        if isinstance(self.encoder, TeacherObjectEncoder) and self.spec.conditioning != "none":
            return self.encoder.shared.pair_size
        return self.encoder.size

    @torch.no_grad()
    def fit_normalisation(self, frames: FrameTensors, texts: Tensor, *, generator: torch.Generator) -> None:
        """Sets what is not trained of the encoder, and mean and principal components of the goal texts.

        Args:
            frames: Training frames by camera, uint8 (N, H, W, C).
            texts: Codes of the distinct goal texts, float32 (known_texts, code size).
            generator: On the CPU.
        """
        self.encoder.fit_normalisation(frames, generator=generator)
        read = texts[:, : self.reader.code_size]
        self.text_mean.copy_(read.mean(dim=0))
        self.text_basis.copy_(principal_components(read))
        self.known_texts.copy_(self._components(texts))
        if self.spec.eye is not None:
            self.known_statements.copy_(texts[:, self.reader.code_size :])

    def forward(self, frames: FrameTensors, texts: Tensor) -> Tensor:
        """Returns actions, float32 (B, A), not clipped, or logits of discrete ones, (B, 1, choices).

        Args:
            frames: By camera, uint8 (B, H, W, C).
            texts: Codes of texts, float32 (B, code size).
        """
        return self.act(self.encoder(frames), texts)

    def knows(self, texts: Tensor) -> Tensor:
        """Returns which texts are near a training goal text in what the network uses of their codes.

        Near is less than half of these texts' mean distance from their centre.

        Args:
            texts: Codes of texts, float32 (B, code size).

        Returns:
            bool (B,).
        """
        distance = self._distances(texts).amin(dim=1)  # (B,)
        near: Tensor = distance <= self.known_texts.norm(dim=1).mean() / 2
        return near

    def _condition(self, texts: Tensor) -> Tensor:
        """Returns the conditioning vectors of texts, float32 (B, condition_size)."""
        if self.spec.conditioning == "code":
            return functional.one_hot(self._nearest(texts), self.spec.known_texts).to(texts.dtype)
        if self.spec.eye is None:
            return self._components(texts)
        relation = texts[:, self.reader.code_size + PAIR :]
        return relation if self.spec.conditioning == "text" else torch.zeros_like(relation)

    def _view(self, features: Tensor, texts: Tensor) -> Tensor:
        """Returns the layers' input, float32 (B, view size), from the encoder's features, conditioned on texts."""
        if not isinstance(self.encoder, TeacherObjectEncoder) or self.spec.conditioning == "none":
            return features
        is_code = self.spec.conditioning == "code"
        said = self.known_statements[self._nearest(texts)] if is_code else texts[:, self.reader.code_size :]
        return self.encoder.shared.of_pair(features, said[:, :PAIR].long())

    def _nearest(self, texts: Tensor) -> Tensor:
        """Returns which training text is nearest to each of some, int64 (B,)."""
        return self._distances(texts).argmin(dim=1)

    def _distances(self, texts: Tensor) -> Tensor:
        return torch.cdist(self._components(texts), self.known_texts)  # (B, known_texts)

    def _components(self, texts: Tensor) -> Tensor:
        return (texts[:, : self.reader.code_size] - self.text_mean) @ self.text_basis

    def act(self, features: Tensor, texts: Tensor) -> Tensor:
        """Returns actions as `forward` does, of frames with features float32 (B, D), from `encoder`."""
        return self.act_on(self.modulate(features, texts))

    def modulate(self, features: Tensor, texts: Tensor) -> Tensor:
        """Returns features, float32 (B, D), from `encoder`, as codes of texts, (B, code size), modulate them.

        Where they are not to be modulated, the text's features stand beside them.
        """
        text, view = functional.relu(self.text_layer(self._condition(texts))), self._view(features, texts)
        if self.spec.fusion == "concatenate":
            return torch.cat([view, text], dim=1)
        scale, shift = self.film(text).chunk(2, dim=1)  # (B, view size) each
        modulated: Tensor = view * (1 + scale) + shift
        return modulated

    def act_on(self, modulated: Tensor) -> Tensor:
        """Returns actions as `forward` does, of modulated features, float32 (B, D)."""
        hidden = functional.relu(self.hidden2(functional.relu(self.hidden1(modulated))))  # (B, hidden_size)
        action: Tensor = self.action_head(hidden)  # (B, A or choices)
        return action[:, None] if self.spec.action.choices else action


def _encoder(spec: LanguageSpec) -> CameraEncoders | TeacherObjectEncoder:
    if spec.eye is None:
        return CameraEncoders(ENCODERS[spec.encoder], spec.cameras, features=spec.features)
    return TeacherObjectEncoder(spec.eye, spec.phrases, camera=spec.cameras[0], action_size=spec.action.size)


def principal_components(embeddings: Tensor) -> Tensor:
    """Returns the directions in which embeddings differ, scaled to a mean coordinate of about 1.

    Args:
        embeddings: float32 (n, W), n >= 1.

    Returns:
        float32 (W, D), D from 1 to `MAX_COMPONENTS`; one direction of zeros where nothing differs.
    """
    centred = embeddings - embeddings.mean(dim=0)  # (n, W)
    _, singular_values, directions = torch.linalg.svd(centred, full_matrices=False)  # (D,), (D, W)
    count = min(MAX_COMPONENTS, int((singular_values > _LEAST_SINGULAR_VALUE * singular_values[0]).sum()))
    if not count or singular_values[0] <= torch.finfo(embeddings.dtype).eps * len(embeddings):
        return embeddings.new_zeros(embeddings.shape[1], 1)
    length: Tensor = torch.linalg.vector_norm(centred, dim=1).mean()
    basis: Tensor = directions[:count].T * (count**0.5 / length)
    return basis
