"""The language-conditioned policy of section 4.3, into which policies of single tasks are distilled.

The text tower is no part of the network: it is frozen, so that what the network sees of a sentence is a code, made
once. Of that it takes what told the goal texts of training apart, and nothing else: about what they had in common, or
did not differ in, nothing could be learned, and in a sentence that is new it would be noise.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from freerein.errors import InvalidInput
from freerein.learning.config import bounded
from freerein.learning.encoders import SpatialEncoder

MAX_DIRECTIONS = 64
_LEAST = 1e-2  # of the largest singular value: below it, goal texts do not differ along a direction


@dataclass(frozen=True, kw_only=True)
class LanguageSpec:
    """What a network does and sees, and how large it is.

    Attributes:
        camera: Which camera's frames it sees.
        text_width: Numbers in the text tower's code of a sentence.
        directions: In which the goal texts of training differ.
        action_size: Numbers per action.
        action_choices: How many different actions there are when they are discrete, else 0.
        height: Of the frames, in pixels.
        width: In pixels.
        channels: 1 or 3.
        features: Image features.
        words: Features of the sentence.
        hidden: Units of its two layers.

    Raises:
        InvalidInput: There are 2 channels.
    """

    camera: str
    text_width: int = bounded(384, least=1, most=4096)
    directions: int = bounded(1, least=1, most=MAX_DIRECTIONS)
    action_size: int = bounded(1, least=1, most=256)
    action_choices: int = bounded(0, least=0, most=4096)
    height: int = bounded(64, least=4, most=1024)
    width: int = bounded(64, least=4, most=1024)
    channels: int = bounded(3, least=1, most=3)
    features: int = bounded(128, least=8, most=1024)
    words: int = bounded(32, least=1, most=1024)
    hidden: int = bounded(128, least=8, most=1024)

    def __post_init__(self) -> None:
        if self.channels == 2:
            raise InvalidInput("Frames must have 1 or 3 channels; got 2.", hint="Store frames as gray or RGB.")


class LanguageNetwork(nn.Module):
    """pi(a_t | x_t, sentence): what is seen, as the sentence scales and shifts it (FiLM), two layers and the action's.

    Args:
        spec: What it does and sees.
    """

    usual: Tensor
    basis: Tensor

    def __init__(self, spec: LanguageSpec) -> None:
        super().__init__()
        self.spec = spec
        self.image = SpatialEncoder(
            height=spec.height, width=spec.width, channels=spec.channels, features=spec.features
        )
        self.words = nn.Linear(spec.directions, spec.words)
        self.modulation = nn.Linear(spec.words, 2 * spec.features)
        self.join = nn.Linear(spec.features, spec.hidden)
        self.plan = nn.Linear(spec.hidden, spec.hidden)
        self.action = nn.Linear(spec.hidden, spec.action_choices or spec.action_size)
        self.register_buffer("usual", torch.zeros(spec.text_width))
        self.register_buffer("basis", torch.zeros(spec.text_width, spec.directions))

    @torch.no_grad()
    def calibrate(self, frames: Tensor, codes: Tensor) -> None:
        """Takes the mean image from training frames, and from its goal texts what they differ in.

        Args:
            frames: uint8 (N, H, W, C).
            codes: Of the different goal texts, float32 (n, text_width).
        """
        self.image.fit_normalisation(frames)
        self.usual.copy_(codes.mean(dim=0))
        self.basis.copy_(differences(codes))

    def forward(self, frames: Tensor, codes: Tensor) -> Tensor:
        """Returns what to do: float32 (B, A), not clipped; or the scores of each discrete action, (B, 1, choices).

        Args:
            frames: uint8 (B, H, W, C).
            codes: Of the sentences, float32 (B, text_width).
        """
        sentence = functional.relu(self.words((codes - self.usual) @ self.basis))  # (B, words)
        scale, shift = self.modulation(sentence).chunk(2, dim=1)  # (B, features) each
        seen = self.image(frames) * (1 + scale) + shift  # (B, features)
        planned = functional.relu(self.plan(functional.relu(self.join(seen))))  # (B, hidden)
        action: Tensor = self.action(planned)  # (B, A or choices)
        return action[:, None] if self.spec.action_choices else action


def differences(codes: Tensor) -> Tensor:
    """Returns the directions in which codes differ, scaled so that what they tell apart is about 1 along each.

    Args:
        codes: float32 (n, W), n >= 1.

    Returns:
        float32 (W, D), D from 1 to `MAX_DIRECTIONS`; one direction of zeros where there is no difference.
    """
    apart = codes - codes.mean(dim=0)  # (n, W)
    _, sizes, directions = torch.linalg.svd(apart, full_matrices=False)  # (D,), (D, W)
    count = min(MAX_DIRECTIONS, int((sizes > _LEAST * sizes[0]).sum()))
    if not count or sizes[0] <= torch.finfo(codes.dtype).eps * len(codes):
        return codes.new_zeros(codes.shape[1], 1)
    length: Tensor = torch.linalg.vector_norm(apart, dim=1).mean()
    basis: Tensor = directions[:count].T * (count**0.5 / length)
    return basis
