"""The eye of a policy that follows many goals: a teacher's, which gives the places of any two phrases that it locates.

<dataset>/eye/   the eye of the policies that acted in a dataset, as a model
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from freerein.config import bounded
from freerein.errors import InvalidInput
from freerein.learning import model_files
from freerein.learning.actor_critic.eye import EyeSpec, GoalEye
from freerein.learning.actor_critic.policy_files import StoredPolicy
from freerein.learning.encoders.clip import ClipImageSpec

FOLDER = "eye"


@dataclass(frozen=True)
class SharedEyeSpec:
    """What an eye locates, and where.

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
                f"An eye must have the {self.image.phrases} phrases that its encoder locates; got {len(self.phrases)}.",
                hint="Restore its folder from a copy.",
            )


class SharedEye(nn.Module):
    """Turns frames into what is seen, and that into the features of two phrases; frozen.

    Attributes:
        spec: What it locates.
        size: Numbers of what is seen of a frame.
        pair_size: Numbers of the features of two phrases.
    """

    def __init__(self, spec: SharedEyeSpec) -> None:
        super().__init__()
        self.spec = spec
        self.eye = GoalEye(EyeSpec(spec.image), height=spec.height, width=spec.width, action_size=spec.action_size)
        self.size = spec.action_size + 3 * len(spec.phrases)
        self.pair_size = self.eye.size

    @torch.no_grad()
    def forward(self, frames: Tensor) -> Tensor:
        """Returns the body's place and those of all phrases, and their presences, float32 (N, size).

        Args:
            frames: uint8 (N, height, width, 3).
        """
        places, presence = self.eye.locate_all(frames)
        return torch.cat([self.eye.body(frames), places.flatten(start_dim=1), presence], dim=1)

    def of_pair(self, seen: Tensor, pairs: Tensor) -> Tensor:
        """Returns what `GoalEye` says of two phrases, float32 (N, pair_size).

        Args:
            seen: From `forward`.
            pairs: Numbers of the first and the second phrase, int64 (N, 2).
        """
        count = len(self.spec.phrases)
        body, places, presence = torch.split(seen, [self.spec.action_size, 2 * count, count], dim=1)
        rows = torch.arange(seen.shape[0], device=seen.device)[:, None]
        return self.eye.features(body, places.view(-1, count, 2)[rows, pairs], presence[rows, pairs])


def save_eye(policy: StoredPolicy, *, phrases: tuple[str, ...], folder: Path) -> None:
    """Writes the eye of a policy as a folder; its card names the reward model whose encoder it has.

    Args:
        policy: The policy.
        phrases: The phrases that the encoder locates.
        folder: Made when missing.

    Raises:
        InvalidInput: The policy has no eye.
    """
    spec, eye = policy.network.spec, policy.network.eye
    if spec.eye is None or eye is None:
        raise no_eye()
    shared = SharedEye(SharedEyeSpec(spec.eye.image, phrases, spec.height, spec.width, spec.action_size))
    shared.eye.load_state_dict(eye.state_dict())
    model_files.save_model(shared, folder, card={"model": policy.card["eye"], "camera": policy.cameras[0]})


def load_eye(folder: Path) -> tuple[SharedEye, dict[str, Any]]:
    """Returns the eye in a folder, and its card, which are read as untrusted.

    Raises:
        InvalidInput: A file is missing or malformed.
    """
    eye = model_files.load_model(folder, SharedEyeSpec, SharedEye, device="cpu")
    return eye, model_files.read_card(folder)


def no_eye() -> InvalidInput:
    """Returns the error of a student that is to see by an eye that its teachers have not."""
    return InvalidInput(
        "A student sees by the eye of its first teacher, which must have one; this one has none.",
        field="config.encoder",
        hint="Train the teacher with `encoder=goal_eye`, or choose an image encoder for the student.",
    )
