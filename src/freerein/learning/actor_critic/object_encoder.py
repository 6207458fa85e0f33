"""The frozen object encoder of a policy: keypoints of the goal's two objects and of the policy's own body in a frame.

A reward model's image encoder locates the two noun phrases of a goal text. A `BodyEncoder` locates the body, and the
objects that it moved give its position in the frame (hand-eye calibration). Nothing of it is trained by rewards.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from freerein.config import bounded
from freerein.learning.actor_critic.body import BodyEncoder, Exploration, fit_body
from freerein.learning.encoders.clip import ClipImageEncoder, ClipImageSpec

OBJECT_ENCODER = "goal_eye"
"""Value of `encoder` in configurations that chooses it; the name stays, since stored runs have it."""

PHRASES_FILE = "phrases.safetensors"
"""In the folder of a reward model of criteria: the embeddings of its phrases, `phrases`, float32 (P, D)."""

_OBJECT_WIDTH = 0.2
"""Width of an object in a frame that is 2 wide: eps of table 4.1."""

_BODY_SCALE = 2.0
_LEAST_PRESENCE, _SEEN = 0.2, 0.5
"""Presence that a keypoint is divided by at least, and from which an object counts as seen."""

_MOVED, _LEAST_MOVES = 0.04, 32
"""Change of position of a moved object, in frames 2 wide, and the fewest such changes that are regressed on."""

_REGRESSION_ROUNDS, _NOISE = 10, 0.02
_FRAMES_AT_ONCE = 16
_REACH = 4.0
"""Distance in object widths from which an object is no nearer than any other."""


@dataclass(frozen=True)
class ObjectEncoderSpec:
    """The objects that an object encoder looks for.

    Attributes:
        image: Sizes of the reward model's image encoder.
        first: Number of the goal text's first noun phrase, among those that the encoder locates.
        second: Number of its second one.
    """

    image: ClipImageSpec
    first: int = bounded(0, least=0, most=63)
    second: int = bounded(1, least=0, most=63)


class ObjectEncoder(nn.Module):
    """Turns frames uint8 (N, height, width, 3) into features; frozen.

    Args:
        spec: Sizes, and the numbers of its two phrases.
        height: Frame height in pixels.
        width: Frame width in pixels.
        action_size: Numbers per action.
    """

    def __init__(self, spec: ObjectEncoderSpec, *, height: int, width: int, action_size: int) -> None:
        super().__init__()
        self.size = action_size + 8
        self._action_size = action_size
        self._pair = [spec.first, spec.second]
        self.objects = ClipImageEncoder(spec.image).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.body = BodyEncoder(height=height, width=width, action_size=action_size)
        self.register_buffer("hand_eye", torch.zeros(action_size, 2))
        self.register_buffer("grasp", torch.zeros(2))
        self.hand_eye: Tensor
        self.grasp: Tensor
        self.requires_grad_(False)
        self.train(False)

    def train(self, _mode: bool = True) -> "ObjectEncoder":
        """Stays in evaluation mode: it is frozen."""
        return super().train(False)

    def forward(self, frames: Tensor) -> Tensor:
        """Returns features, float32 (N, size).

        They are the body's position; offsets between its grasp and both objects, and between these, in object widths to
        the right and up; and the presence of both objects.
        """
        return self.features(self.body(frames), *self.locate(frames))

    def features(self, body: Tensor, keypoints: Tensor, presence: Tensor) -> Tensor:
        """Returns features as `forward` does, of the body's position (N, A), keypoints and presences of `locate`."""
        first, second = keypoints.unbind(dim=1)
        held = body @ self.hand_eye + self.grasp  # (N, 2)
        offsets = torch.cat([held - first, held - second, first - second], dim=1) / _OBJECT_WIDTH
        return torch.cat([_BODY_SCALE * body, offsets, presence], dim=1)

    def nearness(self, features: Tensor) -> Tensor:
        """Returns the nearness of the body's grasp to the first object, (...), in [0, 4] widths.

        Args:
            features: From `forward`, possibly with others behind them, (..., at least size).
        """
        offset = features[..., self._action_size : self._action_size + 2]
        near: Tensor = (_REACH - offset.norm(dim=-1)).clamp(min=0)
        return near

    def offset(self, features: Tensor) -> Tensor:
        """Returns the first object's offset from the second, in object widths to the right and up, (..., 2)."""
        return features[..., self._action_size + 4 : self._action_size + 6]

    def locate(self, frames: Tensor) -> tuple[Tensor, Tensor]:
        """Returns the objects' keypoints, float32 (N, 2, 2), to the right and up in [-1, 1], and presences (N, 2)."""
        keypoints, presence = self.locate_all(frames)
        return keypoints[:, self._pair], presence[:, self._pair]

    def locate_all(self, frames: Tensor) -> tuple[Tensor, Tensor]:
        """Returns keypoints, float32 (N, P, 2), and presences (N, P), of all phrases that the encoder locates."""
        keypoints = self.objects.keypoints(frames)
        presence = keypoints[:, :, 2]  # (N, P)
        down, right = (keypoints[:, :, :2] / presence[:, :, None].clamp(min=_LEAST_PRESENCE)).unbind(dim=2)
        return torch.stack([right, -down], dim=2), presence

    def load_objects(self, encoder: Mapping[str, Tensor]) -> None:
        """Copies the weights of a reward model's image encoder, by name."""
        self.objects.load_state_dict(encoder)

    def fit(
        self,
        seen: Exploration,
        generator: torch.Generator,
        *,
        augmentation: float = 0.0,
        interrupt: Callable[[], None] = lambda: None,
    ) -> None:
        """Learns to locate the body from random actions; the image encoder stays as it is. See `fit_body`."""
        self.body.requires_grad_(True)
        fit_body(self.body, seen, generator, augmentation=augmentation, interrupt=interrupt)
        self.body.requires_grad_(False)
        self._fit_hand_eye(seen)

    @torch.no_grad()
    def _fit_hand_eye(self, seen: Exploration) -> None:
        """Fits `hand_eye` and `grasp` to objects that moved, all but some of them with the body.

        Where too few did, they stay zero: offsets from the body are then positions in the frame.
        """
        shape, device = seen.frames.shape[:2], self.grasp.device
        parts = [each.to(device) for each in torch.split(seen.frames.flatten(end_dim=1), _FRAMES_AT_ONCE)]
        body = torch.cat([self.body(part) for part in parts]).view(*shape, -1)  # (B, T + 1, A)
        located = [self.locate(part) for part in parts]
        keypoints = torch.cat([each for each, _ in located]).view(*shape, 2, 2)
        presence = torch.cat([each for _, each in located]).view(*shape, 2)
        is_seen = presence > _SEEN
        change = keypoints.diff(dim=1)  # (B, T, 2, 2)
        has_moved = (change.abs().amax(dim=3) > _MOVED) & is_seen[:, 1:] & is_seen[:, :-1]  # (B, T, 2)
        if has_moved.sum() < _LEAST_MOVES:
            return
        moves = body.diff(dim=1)[:, :, None].expand(-1, -1, 2, -1)[has_moved]  # (M, A)
        coefficients, errors = _robust_regression(moves, change[has_moved])
        together = errors < _MOVED
        if together.sum() < _LEAST_MOVES:
            return
        after = body[:, 1:, None].expand(-1, -1, 2, -1)[has_moved][together]
        self.hand_eye.copy_(coefficients)
        self.grasp.copy_((keypoints[:, 1:][has_moved][together] - after @ coefficients).median(dim=0).values)


def _robust_regression(inputs: Tensor, targets: Tensor) -> tuple[Tensor, Tensor]:
    """Returns coefficients (A, 2) that minimise absolute errors of inputs (M, A) and targets (M, 2), and errors (M,).

    By iteratively reweighted least squares, on the CPU: inputs may depend on each other, and of the drivers that allow
    for that, the default one does not always return the same bits.
    """
    weight = torch.ones(len(inputs), 1, device=inputs.device)
    for _ in range(_REGRESSION_ROUNDS):
        weighted = (inputs * weight).cpu(), (targets * weight).cpu()
        coefficients = torch.linalg.lstsq(*weighted, driver="gelsd").solution.to(inputs.device)
        errors = (targets - inputs @ coefficients).abs().amax(dim=1)
        weight = errors.clamp(min=_NOISE).rsqrt()[:, None]
    return coefficients, errors
