"""Hand-eye calibration: where in a frame the body of a policy is, from explorations.

What is held moves with the body, so that a policy that carries things finds where it would hold them. What is pushed
slips: a policy that pushes finds its hand where frames change, and there its foot. Cameras look down at a table, on
which things are the lower in the frame the nearer they are to the camera; of a hand that reaches down to it, what is
lowest is where the hand is.
"""

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

_SEEN = 0.5
"""Presence from which an object counts as seen."""

_MOVED, _LEAST_MOVES = 0.04, 32
"""Change of position of a moved object, in frames 2 wide, and the fewest such changes that are regressed on."""

_CHANGED, _LEAST_CHANGE = 60.0, 2000.0
"""Change of a pixel's three channels together from which it counts, and the least sum of what exceeds it in a frame."""

_FOOT = 0.95
"""Share of that sum which is above the foot."""

_MOST_STRETCH = 4.0
_REGRESSION_ROUNDS, _NOISE = 10, 0.02


class HandEye(NamedTuple):
    """Positions in the frame, to the right and up in [-1, 1], are `body @ coefficients + origin`.

    Attributes:
        coefficients: float32 (A, 2).
        origin: float32 (2,).
    """

    coefficients: Tensor
    origin: Tensor

    def ground_metric(self) -> Tensor:
        """Returns the matrix, float32 (2, 2), that undoes the foreshortening of offsets in the frame, (..., 2), by `@`.

        A body goes as far by an action in any direction. Where a camera sees such ways shorter in one direction than in
        another, offsets are stretched there; the longest stay as they are.
        """
        _, lengths, directions = torch.linalg.svd(self.coefficients.cpu(), full_matrices=False)
        stretch = (lengths.max() / lengths.clamp(min=1e-6)).clamp(max=_MOST_STRETCH)
        metric: Tensor = (directions.T * stretch @ directions).to(self.coefficients.device)
        return metric


def by_held_objects(body: Tensor, keypoints: Tensor, presence: Tensor) -> HandEye | None:
    """Returns where what moved with the body is, relative to it; None where too little did.

    Args:
        body: Positions of the body, float32 (B, T + 1, A).
        keypoints: Of two objects, float32 (B, T + 1, 2, 2), to the right and up.
        presence: float32 (B, T + 1, 2).
    """
    is_seen = presence > _SEEN
    change = keypoints.diff(dim=1)  # (B, T, 2, 2)
    has_moved = (change.abs().amax(dim=3) > _MOVED) & is_seen[:, 1:] & is_seen[:, :-1]  # (B, T, 2)
    if has_moved.sum() < _LEAST_MOVES:
        return None
    moves = body.diff(dim=1)[:, :, None].expand(-1, -1, 2, -1)[has_moved]  # (M, A)
    coefficients, errors = robust_regression(moves, change[has_moved])
    together = errors < _MOVED
    if together.sum() < _LEAST_MOVES:
        return None
    after = body[:, 1:, None].expand(-1, -1, 2, -1)[has_moved][together]
    held = keypoints[:, 1:][has_moved][together] - after @ coefficients
    return HandEye(coefficients, held.median(dim=0).values)


def by_moving_pixels(body: Tensor, frames: Tensor) -> HandEye | None:
    """Returns where the foot of what moves is; None where too little does.

    Args:
        body: Positions of the body, float32 (B, T + 1, A).
        frames: uint8 (B, T + 1, H, W, 3).
    """
    places, is_found = zip(*(_moving_feet(each) for each in frames), strict=True)  # one after another, for memory
    moved = torch.stack(is_found).to(body.device)
    if moved.sum() < _LEAST_MOVES:
        return None
    between = (body[:, 1:] + body[:, :-1])[moved] / 2  # (M, A)
    inputs = functional.pad(between, (0, 1), value=1.0)
    fitted, _ = robust_regression(inputs, torch.stack(places).to(body.device)[moved])
    return HandEye(fitted[:-1], fitted[-1])


def _moving_feet(frames: Tensor) -> tuple[Tensor, Tensor]:
    """Returns where the feet of what moves are between frames uint8 (T + 1, H, W, 3), (T, 2), and whether any is, (T,).

    A foot is as far to the right as what changes is on average, and above the lowest twentieth of it.
    """
    change = (frames.float().diff(dim=0).abs().sum(dim=3) - _CHANGED).clamp(min=0)  # (T, H, W)
    rows, columns = (2 * (torch.arange(size, device=frames.device) + 0.5) / size - 1 for size in change.shape[1:])
    mass = change.sum(dim=(1, 2))
    share = change / mass.clamp(min=1)[:, None, None]
    lowest = (share.sum(dim=2).cumsum(dim=1) < _FOOT).sum(dim=1).clamp(max=len(rows) - 1)
    return torch.stack([share.sum(dim=1) @ columns, -rows[lowest]], dim=1), mass > _LEAST_CHANGE


def robust_regression(inputs: Tensor, targets: Tensor) -> tuple[Tensor, Tensor]:
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
