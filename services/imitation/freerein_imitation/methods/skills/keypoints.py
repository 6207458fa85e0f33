"""Keypoints of the gripper, of a skill's object and of its goal position: heat maps over the cells of a frame.

Keypoints are x, y in [-1, 1] from the left upper corner, as `torch.nn.functional.grid_sample` has them: float32 (N, 2).
"""

import math
from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from freerein.types.common import Camera

_CROP, _CROP_HALF = 32, 0.5  # points along each side, and half of its side as a share of the frame's
_OPENING_UNITS = 64
_GRIPPER_CELLS, _GRIPPER_CHANNELS = 16, 24
_MAP_CELLS, _MAP_CHANNELS = 32, 16
_DISPLACEMENT_GAIN = 10.0  # a gripper crosses a frame in about ten steps
_TEMPLATE_CELLS = 13  # an object is recognised by the cells up to six from the gripper's keypoint
_ROW_WIDTH, _COLUMN_WIDTH = 1.0, 1.5  # cells; standard deviations of the smoothing of a keypoint's probability
_SMOOTHED_CELLS = 4
_MODE_CELLS = 1.5


class ReluConv(nn.Conv2d):
    """A convolution with the initialisation of He et al. (2015), for heat maps that are not flat at first."""

    def initialise(self, generator: torch.Generator) -> None:
        """Draws the weights; see `freerein.learning.weights.CustomInitialisation`."""
        _initialise(self, generator)


class ReluLinear(nn.Linear):
    """A dense layer, initialised as `ReluConv`."""

    def initialise(self, generator: torch.Generator) -> None:
        """Draws the weights; see `freerein.learning.weights.CustomInitialisation`."""
        _initialise(self, generator)


class KeypointHead(nn.Conv2d):
    """A heat map that is initially high wherever features are: where a frame differs from the mean image.

    With a map that is high where the gripper is not, a keypoint would move against it, and might never find it.
    """

    def initialise(self, generator: torch.Generator) -> None:
        """Draws the weights, none of them negative; see `freerein.learning.weights.CustomInitialisation`."""
        _initialise(self, generator)
        with torch.no_grad():
            self.weight.abs_()


def _initialise(layer: nn.Conv2d | nn.Linear, generator: torch.Generator) -> None:
    nn.init.kaiming_normal_(layer.weight, nonlinearity="relu", generator=generator)
    if layer.bias is not None:
        nn.init.zeros_(layer.bias)


class Cells(nn.Module):
    """The cells of a frame, each the size of a stem's stride.

    Args:
        camera: Camera of the frames.
        most: Most cells along the longer side.

    Attributes:
        side: Pixels along each side of a cell.
        rows: Rows of cells.
        columns: Columns of cells.
        centres: Positions of the centres, float32 (rows * columns, 2).
        pitch: Width and height of a cell, as a difference of positions, float32 (2,).
    """

    centres: Tensor
    pitch: Tensor

    def __init__(self, camera: Camera, *, most: int) -> None:
        super().__init__()
        self.side = math.ceil(max(camera.height, camera.width) / most)
        self.rows, self.columns = camera.height // self.side, camera.width // self.side
        pitch = torch.tensor([2 * self.side / camera.width, 2 * self.side / camera.height])
        row, column = torch.meshgrid(torch.arange(self.rows), torch.arange(self.columns), indexing="ij")
        self.register_buffer("centres", (torch.stack([column, row], dim=2).flatten(0, 1) + 0.5) * pitch - 1)
        self.register_buffer("pitch", pitch)

    def stem(self, channels: int, outputs: int) -> ReluConv:
        """Returns a convolution to one output per cell, which sees about twice a cell along each side."""
        kernel = 2 * self.side - self.side % 2
        return ReluConv(channels, outputs, kernel_size=kernel, stride=self.side, padding=(kernel - self.side) // 2)

    def mode(self, logits: Tensor) -> Tensor:
        """Returns the mean place near the likeliest cell, float32 (N, 2), of logits of cells (N, rows * columns)."""
        return self._mean_near(self.centres[logits.argmax(dim=1)], logits)

    def likeliest_place(self, logits: Tensor) -> Tensor:
        """Returns where most of the probability lies, float32 (N, 2), of logits of cells (N, rows * columns).

        The row comes first, by its marginal probability: many places beside one another outweigh a sharper one above
        them. Then comes the column, given the row.
        """
        probabilities = logits.softmax(dim=1).view(-1, self.rows, self.columns)
        row = _smoothed(probabilities.sum(dim=2), _ROW_WIDTH).argmax(dim=1)  # (N,)
        from_row = torch.arange(self.rows, device=logits.device) - row[:, None]  # (N, rows)
        near = torch.exp(-(from_row / _ROW_WIDTH).square() / 2)
        column = _smoothed((near[:, :, None] * probabilities).sum(dim=1), _COLUMN_WIDTH).argmax(dim=1)  # (N,)
        return self._mean_near(self.centres[row * self.columns + column], logits)

    def _mean_near(self, places: Tensor, logits: Tensor) -> Tensor:
        """Returns the mean place in the 3 x 3 cells around places (N, 2)."""
        near = ((self.centres - places[:, None]).abs() < _MODE_CELLS * self.pitch).all(dim=2)  # (N, cells)
        return logits.masked_fill(~near, -torch.inf).softmax(dim=1) @ self.centres


def _smoothed(probabilities: Tensor, width: float) -> Tensor:
    """Returns probabilities (N, n), smoothed by a Gaussian of that width."""
    offsets = torch.arange(-_SMOOTHED_CELLS, _SMOOTHED_CELLS + 1, device=probabilities.device)
    kernel = torch.exp(-(offsets / width).square() / 2)
    return functional.conv1d(probabilities[:, None], kernel[None, None], padding=_SMOOTHED_CELLS)[:, 0]


class GripperKeypoint(nn.Module):
    """Keypoint and opening of the gripper, learned from executed actions alone.

    The keypoint is a spatial soft-argmax (Levine et al., 2016): what moves as the actions say. The opening is what else
    changes around it, as the actions of the gripper say.

    Args:
        camera: Camera of the frames.
        is_gripper: For each number of an action, whether it is a gripper's.
    """

    window: Tensor

    def __init__(self, camera: Camera, *, is_gripper: Sequence[bool]) -> None:
        super().__init__()
        self.cells = Cells(camera, most=_GRIPPER_CELLS)
        self.stem = self.cells.stem(camera.channels, _GRIPPER_CHANNELS)
        self.conv = ReluConv(_GRIPPER_CHANNELS, _GRIPPER_CHANNELS, kernel_size=3, padding=1)
        self.head = KeypointHead(_GRIPPER_CHANNELS, 1, kernel_size=1)
        self.displacement = nn.Parameter(torch.empty(len(is_gripper), 2))
        self.lag = nn.Linear(len(is_gripper), len(is_gripper), bias=False)
        self._grippers = [number for number, each in enumerate(is_gripper) if each]
        self.openings = len(self._grippers)
        self.crop_size = _CROP * _CROP * camera.channels
        self.opening_layers = nn.ModuleList()
        if self._grippers:
            sizes = (self.crop_size, _OPENING_UNITS, _OPENING_UNITS, self.openings)
            self.opening_layers.extend(ReluLinear(*each) for each in pairwise(sizes))
        along = _CROP_HALF * (2 * torch.arange(_CROP) + 1 - _CROP) / _CROP
        rows, columns = torch.meshgrid(along, along, indexing="ij")
        self.register_buffer("window", torch.stack([columns, rows], dim=2))

    def initialise(self, _generator: torch.Generator) -> None:
        """Begins without displacement: which way a keypoint goes must not be decided before it is found."""
        nn.init.zeros_(self.displacement)

    def forward(self, pixels: Tensor) -> Tensor:
        """Returns keypoints, float32 (N, 2), in pixels (N, C, H, W)."""
        x = functional.relu(self.conv(functional.relu(self.stem(pixels))))
        keypoint: Tensor = self.head(x).flatten(1).softmax(dim=1) @ self.cells.centres
        return keypoint

    def crop(self, pixels: Tensor, keypoint: Tensor) -> Tensor:
        """Returns the crop around the gripper, float32 (N, crop_size)."""
        return functional.grid_sample(pixels, keypoint[:, None, None] + self.window, align_corners=False).flatten(1)

    def opening(self, crop: Tensor) -> Tensor:
        """Returns how far each gripper is open, in actions from an opening of its own, float32 (N, openings)."""
        if not self.openings:
            return crop[:, :0]
        *hidden, last = self.opening_layers
        for layer in hidden:
            crop = functional.relu(layer(crop))
        opening: Tensor = last(crop)
        return opening

    def executed(self, moved: Tensor, opened: Tensor, previous: Tensor) -> Tensor:
        """Returns the sum of the actions between two frames, float32 (N, A), as their differences tell it.

        Args:
            moved: Of the gripper's keypoint, float32 (N, 2).
            opened: Of the openings, float32 (N, openings).
            previous: Of the actions executed just before, which the gripper has not followed yet, float32 (N, A).
        """
        summed: Tensor = _DISPLACEMENT_GAIN * functional.linear(moved, self.displacement) + self.lag(previous)
        return summed.index_add(1, torch.tensor(self._grippers, dtype=torch.int64, device=summed.device), opened)


class SkillHeatMaps(nn.Module):
    """Where a skill's object is, and where the skill will put it: two heat maps, by fully convolutional layers.

    Pick and place as keypoints in the frame (Zeng et al., "Transporter networks", 2020), but with maps for each skill.
    An object is matched with a template as wide as its position may be off: the gripper's keypoint may be anywhere on
    the gripper.

    Args:
        camera: Camera of the frames.
        skills: Number of skills.
    """

    def __init__(self, camera: Camera, *, skills: int) -> None:
        super().__init__()
        self.cells = Cells(camera, most=_MAP_CELLS)
        self.stem = self.cells.stem(camera.channels, _MAP_CHANNELS)
        self.wide1 = ReluConv(_MAP_CHANNELS, _MAP_CHANNELS, kernel_size=3, padding=2, dilation=2)
        self.wide2 = ReluConv(_MAP_CHANNELS, _MAP_CHANNELS, kernel_size=3, padding=3, dilation=3)
        self.position = nn.Parameter(torch.empty(_MAP_CHANNELS, self.cells.rows, self.cells.columns))
        self.object_head = nn.Conv2d(_MAP_CHANNELS, skills, kernel_size=_TEMPLATE_CELLS, padding=_TEMPLATE_CELLS // 2)
        self.place_head = nn.Conv2d(_MAP_CHANNELS, skills, kernel_size=3, padding=1)

    def initialise(self, _generator: torch.Generator) -> None:
        """Begins with a position that does not matter."""
        nn.init.zeros_(self.position)

    def forward(self, pixels: Tensor, skill: Tensor) -> tuple[Tensor, Tensor]:
        """Returns logits over cells, float32 (N, cells) each: of the object, and of where it will be put.

        Args:
            pixels: float32 (N, C, H, W).
            skill: One-hot, float32 (N, skills).
        """
        x = functional.relu(self.stem(pixels))
        wide = functional.relu(self.wide1(x) + self.position)
        wide = wide + functional.relu(self.wide2(wide))
        targets, places = (
            (maps.flatten(2) * skill[:, :, None]).sum(dim=1)
            for maps in (self.object_head(x + wide), self.place_head(wide))
        )
        return targets, places
