"""The likeliest labels of trajectories within their tags."""

import torch
from torch import Tensor

from freerein_segmentation.objectives.labels import NO_SKILL


@torch.no_grad()
def viterbi(emissions: Tensor, mask: Tensor, tags: Tensor, *, switching_cost: float) -> Tensor:
    """Returns the labels that maximise the sum of emissions less a cost for each switch, among a trajectory's tags.

    Args:
        emissions: float (B, T, K), such as log P(y_t = k).
        mask: bool (B, T), valid timesteps, before all others.
        tags: bool (B, K), at least one per trajectory.
        switching_cost: Cost of each change of the skill, in nats.

    Returns:
        int64 (B, T), `NO_SKILL` where the mask is False.
    """
    inside = emissions.where(mask[:, :, None], 0.0).masked_fill(~tags[:, None], float("-inf"))  # (B, T, K)
    skills = torch.arange(inside.shape[2], device=inside.device).expand(len(inside), -1)  # (B, K)
    value, before = inside[:, 0], []
    for t in range(1, inside.shape[1]):
        best, best_skill = value.max(dim=1, keepdim=True)
        stays = value >= best - switching_cost  # (B, K)
        before.append(skills.where(stays, best_skill))
        value = value.where(stays, best - switching_cost) + inside[:, t]
    labels = [value.argmax(dim=1)]  # the end of the padding, in which nothing switches
    for came_from in reversed(before):
        labels.append(came_from.gather(1, labels[-1][:, None])[:, 0])
    return torch.stack(labels[::-1], dim=1).where(mask, NO_SKILL)
