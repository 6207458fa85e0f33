"""What a network makes of experience, whichever network acted."""

from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor

from freerein_orchestrator.networks import ActorCritic, Outputs
from freerein_orchestrator.rollout import Rollout

_AT_ONCE = 1024  # observations in one forward pass


@dataclass(frozen=True, eq=False)
class Hindsight:
    """What a network makes of T timesteps of N environments; all on the CPU.

    Attributes:
        log_probs: Of the actions, float32 (T, N).
        values: Of the observations, float32 (T, N).
        cut_values: Of what episodes that were cut off would have gone on from, 0 elsewhere, float32 (T, N).
        next_values: Of the observations after the last timestep, float32 (N,).
    """

    log_probs: Tensor
    values: Tensor
    cut_values: Tensor
    next_values: Tensor


@torch.no_grad()
def reconsider(rollout: Rollout, network: ActorCritic) -> Hindsight:
    """Returns what a network makes of a rollout, some timesteps at a time.

    Its memory is the actor's before the first timestep, and its own from there on.
    """
    device, memory = next(network.parameters()).device, rollout.memory
    log_probs, values, cut_values = list[Tensor](), list[Tensor](), torch.zeros_like(rollout.rewards)

    def look(observations: Tensor, starts: Tensor, memory: Tensor) -> Outputs:
        outputs: Outputs = network(observations.to(device), starts.to(device), memory.to(device))
        return outputs

    for begin, end in pairwise(_pauses(rollout.cuts)):
        outputs = look(rollout.observations[begin:end], rollout.starts[begin:end], memory)
        log_probs.append(outputs.actions.log_prob(rollout.actions[begin:end].to(device)).cpu())
        values.append(outputs.values.cpu())
        memory, cuts = outputs.memory.cpu(), rollout.cuts[end - 1]
        if cuts.any():
            last = rollout.cut_observations[rollout.cuts.nonzero()[:, 0] == end - 1][None]
            goes_on = torch.zeros(last.shape[:2], dtype=torch.bool)
            cut_values[end - 1, cuts] = look(last, goes_on, memory[cuts]).values[0].cpu()
    after = look(rollout.next_observations[None], rollout.ends[-1:], memory)
    return Hindsight(torch.cat(log_probs), torch.cat(values), cut_values, after.values[0].cpu())


def _pauses(cuts: Tensor) -> list[int]:
    """Returns where the parts of T timesteps end that are looked at: where an episode was cut off, and in between."""
    steps, num_envs = cuts.shape
    between = range(0, steps, max(1, _AT_ONCE // num_envs))
    return sorted({*between, *(cuts.any(dim=1).nonzero()[:, 0] + 1).tolist(), steps})
