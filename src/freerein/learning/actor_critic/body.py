"""Self-localisation: where a policy's own body is in a frame, learned from its own random actions.

A body is what one's actions move: the encoder's output changes between two frames by the sum of the actions between
them. It reads keypoints by spatial softmax (Finn et al. 2016), since a body looks alike wherever it is. Light, and
things that come and go, are not the body: frames of one pair are seen in different lights, with different distractors.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn
from torch.nn import functional

from freerein.learning import weights
from freerein.learning.augmentation import CameraTakes, add_distractors, delayed

_CHANNELS, _KEYPOINTS = 16, 16
_PIXEL_SCALE = 64.0
_SHARPNESS = 2.0
_BATCH, _LR = 64, 4e-3
_EPOCHS, _EPOCHS_AUGMENTED = 8, 12
"""How often each action is the first of a pair of frames, on average."""

_AUGMENTED = 0.5
"""Share of the frames that are augmented, once augmentation begins."""

_MAX_SPAN = 4
_MEDIAN_FRAMES = 1024


@dataclass(frozen=True, eq=False)
class Exploration:
    """B sequences of T random actions.

    Attributes:
        frames: uint8 (B, T + 1, H, W, 3), before each action and after the last.
        actions: As executed, float32 (B, T, A).
    """

    frames: Tensor
    actions: Tensor


class BodyEncoder(nn.Module):
    """Locates the body in frames uint8 (N, height, width, 3) by one number per component of the actions."""

    def __init__(self, *, height: int, width: int, action_size: int) -> None:
        super().__init__()
        self.register_buffer("background", torch.zeros(3, height, width))
        self.background: Tensor
        self.conv1 = nn.Conv2d(3, _CHANNELS, 5, stride=2, padding=2)
        self.conv2 = nn.Conv2d(_CHANNELS, _CHANNELS, 3, padding=1)
        self.conv3 = nn.Conv2d(_CHANNELS, _KEYPOINTS, 3, padding=2, dilation=2)
        self.readout = nn.Linear(2 * _KEYPOINTS, action_size)

    def forward(self, frames: Tensor) -> Tensor:
        """Returns where the body is, float32 (N, A): the sum of the actions that would lead there from the mean."""
        pixels = (frames.permute(0, 3, 1, 2) - self.background) / _PIXEL_SCALE  # (N, 3, H, W)
        heat = self.conv3(functional.relu(self.conv2(functional.relu(self.conv1(pixels)))))  # (N, K, h, w)
        share = (_SHARPNESS * heat.flatten(start_dim=2)).softmax(dim=2).view_as(heat)
        rows, columns = (torch.linspace(-1, 1, cells, device=heat.device) for cells in heat.shape[2:])
        keypoints = torch.cat([share.sum(dim=2) @ columns, share.sum(dim=3) @ rows], dim=1)  # (N, 2 K)
        found: Tensor = self.readout(keypoints)
        return found


def fit_body(
    body: BodyEncoder,
    seen: Exploration,
    generator: torch.Generator,
    *,
    augmentation: float = 0.0,
    interrupt: Callable[[], None] = lambda: None,
) -> None:
    """Trains an encoder on random actions, from new weights.

    The loss is absolute, so that actions without effect, at the ends of a joint's range, count little.

    Args:
        body: Changed in place.
        seen: Random actions and the frames around them.
        generator: Source of all randomness, on the CPU.
        augmentation: Strength of that of frames: their light, and distractors; 0 for none.
        interrupt: Called before every step; raises to stop.
    """
    weights.initialise(body, generator=generator)
    frames, device = seen.frames.flatten(end_dim=1), body.background.device
    chosen = torch.randperm(len(frames), generator=generator)[:_MEDIAN_FRAMES]
    body.background.copy_(frames[chosen].float().median(dim=0).values.permute(2, 0, 1))
    count, length = seen.actions.shape[:2]
    moved = functional.pad(seen.actions.cumsum(dim=1), (0, 0, 1, 0))  # (B, T + 1, A)
    epochs = _EPOCHS_AUGMENTED if augmentation else _EPOCHS
    optimiser, steps = torch.optim.Adam(body.parameters(), _LR), math.ceil(epochs * count * length / _BATCH)
    for step in range(steps):
        interrupt()
        for group in optimiser.param_groups:
            group["lr"] = _LR * (1 - step / steps)
        which = torch.randint(count, (_BATCH,), generator=generator)
        start = torch.randint(length, (_BATCH,), generator=generator)
        end = (start + torch.randint(1, _MAX_SPAN + 1, (_BATCH,), generator=generator)).clamp(max=length)
        pair = torch.cat([seen.frames[which, start], seen.frames[which, end]])
        if strength := delayed(augmentation, step=step, steps=steps):
            pair = _augmented(pair, strength=strength, generator=generator)
        before, after = body(pair.to(device)).chunk(2)
        loss = functional.l1_loss(after - before, (moved[which, end] - moved[which, start]).to(device))
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]  # torch does not annotate it
        optimiser.step()
    with torch.no_grad():
        parts = torch.split(frames[chosen], _BATCH)
        body.readout.bias.sub_(torch.cat([body(each.to(device)) for each in parts]).mean(dim=0))


def _augmented(frames: Tensor, *, strength: float, generator: torch.Generator) -> Tensor:
    """Returns frames, uint8 (N, H, W, 3), half of which have distractors, and are in lights of their own."""
    which = (torch.rand(len(frames), generator=generator) < _AUGMENTED).nonzero()[:, 0]
    takes = CameraTakes.draw(len(which), frames.shape[1:3], strength=strength, generator=generator)
    lights = replace(takes, offsets=torch.zeros_like(takes.offsets))  # a body that is seen elsewhere has moved
    seen = frames.clone()
    seen[which] = lights.of(add_distractors(frames[which], strength=strength, generator=generator), generator)
    return seen
