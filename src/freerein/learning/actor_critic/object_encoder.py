"""The frozen object encoder of a policy: keypoints of the goal's two objects and of the policy's own body in a frame.

A reward model's image encoder locates the two noun phrases of a goal text. A `BodyEncoder` locates the body, and
`hand_eye` has where that is in the frame. Nothing of it is trained by rewards.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from freerein.config import bounded
from freerein.learning.actor_critic import hand_eye
from freerein.learning.actor_critic.body import BodyEncoder, Exploration, fit_body
from freerein.learning.actor_critic.ways import angle_between, way_around
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

_FRAMES_AT_ONCE = 16
_CARRIED_REACH, _PUSHED_REACH = 4.0, 6.0
"""Length of the way, in object widths, from which what is carried, and where a push begins, is no nearer."""

_BEHIND, _TOUCH = 1.4, 1.2
"""Distances in object widths from a pushed object: behind it, where a push begins, and where the hand touches it."""


@dataclass(frozen=True)
class ObjectEncoderSpec:
    """The objects that an object encoder looks for.

    Attributes:
        image: Sizes of the reward model's image encoder.
        first: Number of the goal text's first noun phrase, among those that the encoder locates.
        second: Number of its second one.
        pushed: Whether the first object is pushed to the second; else it is carried.
    """

    image: ClipImageSpec
    first: int = bounded(0, least=0, most=63)
    second: int = bounded(1, least=0, most=63)
    pushed: bool = False


class ObjectEncoder(nn.Module):
    """Turns frames uint8 (N, height, width, 3) into features; frozen.

    Args:
        spec: Sizes, and the numbers of its two phrases.
        height: Frame height in pixels.
        width: Frame width in pixels.
        action_size: Numbers per action.

    Attributes:
        size: Numbers per frame.
        pushes: Whether the first object is pushed.
    """

    def __init__(self, spec: ObjectEncoderSpec, *, height: int, width: int, action_size: int) -> None:
        super().__init__()
        self.size = action_size + 8
        self._action_size = action_size
        self._pair, self.pushes = [spec.first, spec.second], spec.pushed
        self.objects = ClipImageEncoder(spec.image).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.body = BodyEncoder(height=height, width=width, action_size=action_size)
        self.register_buffer("hand_eye", torch.zeros(action_size, 2))
        self.register_buffer("grasp", torch.zeros(2))
        self.hand_eye: Tensor
        self.grasp: Tensor
        if spec.pushed:
            self.register_buffer("metric", torch.eye(2))
            self.metric: Tensor
        self.requires_grad_(False)
        self.train(False)

    def train(self, _mode: bool = True) -> "ObjectEncoder":
        """Stays in evaluation mode: it is frozen."""
        return super().train(False)

    def forward(self, frames: Tensor) -> Tensor:
        """Returns features, float32 (N, size).

        They are the body's position; three offsets in object widths to the right and up; and the presence of both
        objects. Offsets are those of the grasp from both objects, and of the first from the second. Where the first is
        pushed, they are those of the hand from where the push begins and from the first, and of this from the second,
        on the table, not in the frame (`HandEye.ground_metric`).
        """
        return self.features(self.body(frames), *self.locate(frames))

    def features(self, body: Tensor, keypoints: Tensor, presence: Tensor) -> Tensor:
        """Returns features as `forward` does, of the body's position (N, A), keypoints and presences of `locate`."""
        first, second = keypoints.unbind(dim=1)
        held = body @ self.hand_eye + self.grasp  # (N, 2)
        if self.pushes:
            from_first, apart = (each @ self.metric / _OBJECT_WIDTH for each in (held - first, first - second))
            away = apart / apart.norm(dim=1, keepdim=True).clamp(min=1e-6)
            offsets = torch.cat([from_first - _BEHIND * away, from_first, apart], dim=1)
        else:
            offsets = torch.cat([held - first, held - second, first - second], dim=1) / _OBJECT_WIDTH
        return torch.cat([_BODY_SCALE * body, offsets, presence], dim=1)

    def nearness(self, features: Tensor) -> Tensor:
        """Returns the nearness of the grasp to the first object, or to where a push begins, (...), in object widths.

        The way to where a push begins leads around the object, on the nearer side.

        Args:
            features: From `forward`, possibly with others behind them, (..., at least size).
        """
        offset = features[..., self._action_size : self._action_size + 2]
        way, reach = offset.norm(dim=-1), _CARRIED_REACH
        if self.pushes:
            from_first = features[..., self._action_size + 2 : self._action_size + 4]
            behind = from_first - offset
            way = way_around(from_first, behind, angle_between(from_first, behind), radius=_TOUCH)
            reach = _PUSHED_REACH
        near: Tensor = (reach - way).clamp(min=0)
        return near

    def sees_both(self, features: Tensor) -> Tensor:
        """Returns whether both objects are seen, bool (...); the offsets of what is not seen are arbitrary."""
        presence = features[..., self._action_size + 6 : self._action_size + 8]
        return (presence > _SEEN).all(dim=-1)

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
        """Fits `hand_eye` and `grasp`; where too little moved, they stay zero: offsets are positions in the frame."""
        shape, device = seen.frames.shape[:2], self.grasp.device
        parts = [each.to(device) for each in torch.split(seen.frames.flatten(end_dim=1), _FRAMES_AT_ONCE)]
        body = torch.cat([self.body(part) for part in parts]).view(*shape, -1)  # (B, T + 1, A)
        if self.pushes:
            found = hand_eye.by_moving_pixels(body, seen.frames)
        else:
            located = [self.locate(part) for part in parts]
            keypoints = torch.cat([each for each, _ in located]).view(*shape, 2, 2)
            presence = torch.cat([each for _, each in located]).view(*shape, 2)
            found = hand_eye.by_held_objects(body, keypoints, presence)
        if found is None:
            return
        self.hand_eye.copy_(found.coefficients)
        self.grasp.copy_(found.origin)
        if self.pushes:
            self.metric.copy_(found.ground_metric())
