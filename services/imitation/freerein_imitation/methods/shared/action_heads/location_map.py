"""The head of pick and place whose location is read from feature maps of observation and goal.

A location is compared with the same place in both images. Places of actions are those of the first camera's image up to
an affine map, which is learned: it begins as x to the right and y up, from edge to edge.
"""

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional

from freerein.learning.encoders import FrameTensors
from freerein.types.common import ActionSpec, Camera
from freerein_imitation.methods.shared.action_heads.pick_and_place import GRID, LOCATIONS, grid_places
from freerein_imitation.methods.shared.action_heads.pick_head import Locations, PickHead

_CHANNELS, _HIDDEN_CHANNELS, _FUSED_CHANNELS = 12, 8, 24
_MOST_SIDE = 32


class MapHead(PickHead):
    """Location by a heat map, direction and length by the features at the location."""

    def __init__(self, hidden: int, _action: ActionSpec, cameras: Sequence[Camera]) -> None:
        super().__init__(hidden, _FUSED_CHANNELS)
        camera = cameras[0]
        self._camera, self._hidden = camera.name, hidden
        self._sides = min(-(-camera.height // 2), _MOST_SIDE), min(-(-camera.width // 2), _MOST_SIDE)
        self.code_size = _CHANNELS * self._sides[0] * self._sides[1]
        self.eye = nn.ModuleList(
            [
                nn.Conv2d(camera.channels, _CHANNELS, kernel_size=5, stride=2, padding=2),
                nn.Conv2d(_CHANNELS, _CHANNELS, kernel_size=3, padding=1),
            ]
        )
        self.hidden_channels = nn.Linear(hidden, _HIDDEN_CHANNELS)
        self.fusion = nn.Conv2d(2 * _CHANNELS + _HIDDEN_CHANNELS, _FUSED_CHANNELS, kernel_size=3, padding=1)
        self.heat = nn.Linear(_FUSED_CHANNELS, 1)
        self.places = PlacesInImage()

    def encode(self, frames: FrameTensors) -> Tensor:
        """Returns feature maps of the first camera's frames, flat; see `ActionHead`."""
        x = frames[self._camera].permute(0, 3, 1, 2) / 255 - 0.5  # (N, C, H, W)
        for layer in self.eye:
            x = functional.relu(layer(x))  # (N, CHANNELS, H / 2, W / 2)
        return functional.adaptive_avg_pool2d(x, self._sides).flatten(start_dim=1)

    def locations(self, context: Tensor) -> Locations:
        """Returns logits of the locations; see `PickHead`."""
        hidden, both = context[:, : self._hidden], context[:, self._hidden :]
        images = both.reshape(-1, 2 * _CHANNELS, *self._sides)  # of observation, then of goal
        channels = self.hidden_channels(hidden)[:, :, None, None].expand(-1, -1, *self._sides)
        maps = torch.cat([images, channels], dim=1)
        fused = functional.relu(self.fusion(maps))  # (B, FUSED_CHANNELS, rows, columns)
        grid = self.places(grid_places(context.device)).view(1, GRID, GRID, 2).expand(len(context), -1, -1, -1)
        sampled = functional.grid_sample(fused, grid, padding_mode="border", align_corners=False)
        features = sampled.view(len(context), _FUSED_CHANNELS, LOCATIONS).transpose(1, 2)
        return Locations(hidden, self.heat(features)[..., 0], features)


class PlacesInImage(nn.Module):
    """The affine map from places of actions, float32 (N, 2), to places of an image, as `grid_sample` has them."""

    def __init__(self) -> None:
        super().__init__()
        self.affine = nn.Parameter(torch.empty(2, 3))

    def initialise(self, _generator: torch.Generator) -> None:
        """Begins with x to the right and y up, from edge to edge."""
        with torch.no_grad():
            self.affine.copy_(torch.tensor([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]))

    def forward(self, places: Tensor) -> Tensor:
        """Returns where places are in the image."""
        return places @ self.affine[:, :2].T + self.affine[:, 2]
