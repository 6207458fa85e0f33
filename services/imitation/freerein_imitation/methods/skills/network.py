"""The skill policies of section 2.4 as one network that takes a skill, with a termination head.

A skill is pick and place in the frame: keypoints of the gripper, of the object, and of where it will be put. The
policy moves to the next waypoint of demonstrations, and not as they moved at each timestep.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from freerein.config import bounded
from freerein.errors import InvalidInput
from freerein.learning.encoders import FrameTensors
from freerein.learning.encoders.exposure import ExposureNormalisation
from freerein.learning.image_statistics import statistics_sizes
from freerein.learning.in_distribution import InDistribution
from freerein.learning.inputs import InputSpec
from freerein_imitation.methods.skills.keypoints import GripperKeypoint, ReluLinear, SkillHeatMaps
from freerein_imitation.model.torch_policy import PolicyNetwork

GRIPPER = "gripper"
"""In the name of an action's number that opens and closes a gripper, in any case."""

_CROP_FEATURES = 64
_CONTEXT, _CONTEXT_FEATURES = 8, 24
_OFFSET_GAIN = 5.0
_KEYPOINTS = 8  # numbers: two offsets and two keypoints
_SPEED_QUANTILE = 0.95


@dataclass(frozen=True, kw_only=True)
class SkillsSpec(InputSpec):
    """Inputs, outputs and sizes of a network.

    Attributes:
        skills: Names of the skills.
        hidden_size: Units of the hidden layers.
        normalise_exposure: Whether frames are made as bright as the training frames.

    Raises:
        InvalidInput: There are no skills, there is more than one camera, or actions are discrete, targets or out of
            bounds.
    """

    skills: tuple[str, ...]
    hidden_size: int = bounded(192, least=8, most=1024)
    normalise_exposure: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.skills:
            raise InvalidInput("A policy must have at least 1 skill; got 0.", hint="Label the dataset with skills.")
        if len(self.cameras) > 1:
            raise InvalidInput(
                f"Skill policies see the frames of 1 camera; got {len(self.cameras)}.",
                field="config.cameras",
                hint="Name the one that sees gripper and objects best.",
            )
        if self.action.choices:
            raise InvalidInput(
                f"Skill policies need actions that displace a gripper; got {self.action.choices} discrete choices.",
                field="dataset",
                hint="Record continuous actions.",
            )
        if self.action.absolute:
            raise InvalidInput(
                "Skill policies need actions that displace a gripper; those of this dataset are targets.",
                field="dataset",
                hint="Choose another method, such as skill_cloning.",
            )

    @property
    def is_gripper(self) -> tuple[bool, ...]:
        """Which numbers of an action move a gripper's fingers, not the gripper; none where they have no names."""
        names = self.action.names or ("",) * self.action.size
        return tuple(GRIPPER in name.lower() for name in names)


class SkillsNetwork(PolicyNetwork):
    """Gripper keypoint, heat maps of a skill, and the next waypoint given both.

    Attributes:
        hand: Keypoint and opening of the gripper; the name is that of stored models.
        maps: Heat maps of the object, and of where the skill will put it.
    """

    spec: SkillsSpec
    mean_image: Tensor
    pixel_std: Tensor
    speed: Tensor

    def __init__(self, spec: SkillsSpec) -> None:
        super().__init__()
        self.spec = spec
        (camera,) = spec.cameras
        size = spec.action.size
        self.hand = GripperKeypoint(camera, is_gripper=spec.is_gripper)
        self.maps = SkillHeatMaps(camera, skills=len(spec.skills))
        known = _KEYPOINTS + self.hand.openings
        self.crop_layer = ReluLinear(self.hand.crop_size, _CROP_FEATURES)
        self.context_layer = ReluLinear(_CONTEXT * _CONTEXT * camera.channels, _CONTEXT_FEATURES)
        self.input_layer = ReluLinear(_CROP_FEATURES + _CONTEXT_FEATURES + known + size, spec.hidden_size)
        self.hidden1 = ReluLinear(spec.hidden_size, spec.hidden_size)
        self.hidden2 = ReluLinear(spec.hidden_size, spec.hidden_size)
        self.waypoint_head = nn.Linear(spec.hidden_size, size)
        self.direct = nn.Linear(known, size)
        self.termination_head = nn.Linear(spec.hidden_size, 1)
        self.in_distribution = InDistribution(*statistics_sizes(spec.cameras))
        sizes = {"height": camera.height, "width": camera.width, "channels": camera.channels}
        self.exposure = ExposureNormalisation(**sizes) if spec.normalise_exposure else None
        self.register_buffer("mean_image", torch.zeros(camera.channels, camera.height, camera.width))
        self.register_buffer("pixel_std", torch.ones(()))
        self.register_buffer("speed", torch.ones(()))

    @torch.no_grad()
    def fit_normalisation(self, frames: FrameTensors, actions: Tensor) -> None:
        """Sets mean image and deviation of pixels, and the speed of the gripper.

        Args:
            frames: Some training frames, uint8 (N, H, W, C).
            actions: Executed ones, float32 (M, A).
        """
        (only,) = frames.values()
        if self.exposure:
            self.exposure.fit(only)
        pixels = only.permute(0, 3, 1, 2).float()
        self.mean_image.copy_(pixels.mean(dim=0))
        self.pixel_std.copy_((pixels - self.mean_image).std().clamp(min=1.0))
        moves = actions[:, ~self._is_gripper()].abs()
        if moves.numel():
            self.speed.copy_(torch.quantile(moves.amax(dim=1)[:: 1 + len(moves) // 100_000], _SPEED_QUANTILE))

    def pixels(self, frames: FrameTensors) -> Tensor:
        """Returns normalised pixels, float32 (N, C, H, W), of frames uint8 (N, H, W, C) of the one camera."""
        (only,) = frames.values()
        if self.exposure:
            only = self.exposure(only)
        return (only.permute(0, 3, 1, 2).float() - self.mean_image) / self.pixel_std

    def forward(
        self, pixels: Tensor, gripper: Tensor, target: Tensor, place: Tensor, previous: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Returns the displacement to the next waypoint, in actions, float32 (N, A), and termination logits (N,).

        Args:
            pixels: float32 (N, C, H, W).
            gripper: Keypoint of the gripper, float32 (N, 2).
            target: Keypoint of the object, float32 (N, 2).
            place: Where the skill will put it, float32 (N, 2).
            previous: a_{t-1}, float32 (N, A); zeros for none.
        """
        crop, context = self.hand.crop(pixels, gripper), functional.adaptive_avg_pool2d(pixels, _CONTEXT).flatten(1)
        offsets = _OFFSET_GAIN * torch.cat([target - gripper, place - gripper], dim=1)
        known = torch.cat([offsets, 2 * gripper, 2 * target, self.hand.opening(crop).detach()], dim=1)
        features = [functional.relu(self.crop_layer(crop)), functional.relu(self.context_layer(context))]
        x = functional.relu(self.input_layer(torch.cat([*features, known, previous], dim=1)))
        x = functional.relu(self.hidden1(x))
        x = x + functional.relu(self.hidden2(x))
        return self.waypoint_head(x) + self.direct(known), self.termination_head(x)[:, 0]

    def actions(self, displacement: Tensor) -> Tensor:
        """Returns the actions towards waypoints, float32 (N, A) in [-1, 1]: straight, and no faster than shown."""
        gripper = self._is_gripper()
        moves = displacement.masked_fill(gripper, 0.0)
        furthest = moves.abs().amax(dim=1, keepdim=True).clamp(min=1e-6)
        return torch.where(gripper, displacement, moves * (self.speed / furthest).clamp(max=1)).clamp(-1, 1)

    def _is_gripper(self) -> Tensor:
        return torch.tensor(self.spec.is_gripper, device=self.speed.device)
