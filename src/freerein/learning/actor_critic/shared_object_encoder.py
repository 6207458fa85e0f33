"""The object encoder of a policy of many goals: a teacher's, which gives the keypoints of any two phrases.

<dataset>/eye/   the object encoder of the policies that acted in a dataset, as a model
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from freerein.config import bounded
from freerein.errors import InvalidInput
from freerein.learning import model_files
from freerein.learning.actor_critic.object_encoder import ObjectEncoder, ObjectEncoderSpec
from freerein.learning.actor_critic.policy_files import StoredPolicy
from freerein.learning.encoders.clip import ClipImageSpec

FOLDER = "eye"


@dataclass(frozen=True)
class SharedObjectEncoderSpec:
    """Phrases, frame size and sizes of an object encoder.

    Attributes:
        image: Sizes of the reward model's image encoder.
        phrases: The noun phrases that the encoder locates, in order.
        height: Frame height in pixels.
        width: Frame width in pixels.
        action_size: Numbers per action.

    Raises:
        InvalidInput: The encoder locates another number of phrases.
    """

    image: ClipImageSpec
    phrases: tuple[str, ...]
    height: int = bounded(64, least=4, most=1024)
    width: int = bounded(64, least=4, most=1024)
    action_size: int = bounded(1, least=1, most=256)

    def __post_init__(self) -> None:
        if len(self.phrases) != self.image.phrases:
            raise InvalidInput(
                f"An object encoder must have {self.image.phrases} phrases, as its weights; got {len(self.phrases)}.",
                hint="Restore its folder from a copy.",
            )


class SharedObjectEncoder(nn.Module):
    """Encodes frames as keypoints of body and phrases, and those of two phrases as features; frozen.

    Attributes:
        spec: Phrases and sizes.
        size: Numbers per frame.
        pair_size: Features of two phrases.
    """

    def __init__(self, spec: SharedObjectEncoderSpec) -> None:
        super().__init__()
        self.spec = spec
        self.eye = ObjectEncoder(
            ObjectEncoderSpec(spec.image), height=spec.height, width=spec.width, action_size=spec.action_size
        )
        self.size = spec.action_size + 3 * len(spec.phrases)
        self.pair_size = self.eye.size

    @torch.no_grad()
    def forward(self, frames: Tensor) -> Tensor:
        """Returns the body's position and those of all phrases, and their presences, float32 (N, size).

        Args:
            frames: uint8 (N, height, width, 3).
        """
        keypoints, presence = self.eye.locate_all(frames)
        return torch.cat([self.eye.body(frames), keypoints.flatten(start_dim=1), presence], dim=1)

    def of_pair(self, seen: Tensor, pairs: Tensor) -> Tensor:
        """Returns `ObjectEncoder`'s features of two phrases, float32 (N, pair_size).

        Args:
            seen: From `forward`.
            pairs: Numbers of the first and the second phrase, int64 (N, 2).
        """
        count = len(self.spec.phrases)
        body, keypoints, presence = torch.split(seen, [self.spec.action_size, 2 * count, count], dim=1)
        rows = torch.arange(seen.shape[0], device=seen.device)[:, None]
        return self.eye.features(body, keypoints.view(-1, count, 2)[rows, pairs], presence[rows, pairs])


def save_object_encoder(policy: StoredPolicy, *, phrases: tuple[str, ...], folder: Path) -> None:
    """Writes the object encoder of a policy as a folder; its card names the reward model whose encoder it has.

    Args:
        policy: The policy.
        phrases: The phrases that the encoder locates.
        folder: Made when missing.

    Raises:
        InvalidInput: The policy has no object encoder, or one of what is pushed.
    """
    spec, encoder = policy.network.spec, policy.network.eye
    if spec.eye is None or encoder is None:
        raise no_object_encoder()
    if spec.eye.pushed:
        raise InvalidInput(
            "The student of several teachers sees things as those do that carry them; its first teacher pushes.",
            field="config.encoder",
            hint="Choose an image encoder for the student, such as `spatial`.",
        )
    shared = SharedObjectEncoder(
        SharedObjectEncoderSpec(spec.eye.image, phrases, spec.height, spec.width, spec.action_size)
    )
    shared.eye.load_state_dict(encoder.state_dict())
    model_files.save_model(shared, folder, card={"model": policy.card["eye"], "camera": policy.cameras[0]})


def load_object_encoder(folder: Path) -> tuple[SharedObjectEncoder, dict[str, Any]]:
    """Returns the object encoder in a folder, and its card, which are read as untrusted.

    Raises:
        InvalidInput: A file is missing or malformed.
    """
    encoder = model_files.load_model(folder, SharedObjectEncoderSpec, SharedObjectEncoder, device="cpu")
    return encoder, model_files.read_card(folder)


def no_object_encoder() -> InvalidInput:
    """Returns the error of a student of `goal_eye` whose teachers have no object encoder."""
    return InvalidInput(
        "The student takes the object encoder of its first teacher, which must have one; it has an image encoder.",
        field="config.encoder",
        hint="Train the teacher with `encoder=goal_eye`, or choose an image encoder for the student.",
    )
