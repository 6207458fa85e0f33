"""When a goal counts as reached, from held-out exploration alone."""

import numpy as np
import torch

from freerein_imitation.model.goal_conditioned import GoalConditionedNetwork
from freerein_imitation.model.recognizer import closeness
from freerein_imitation.training.exploration import Exploration

_FRAMES = 256


@torch.no_grad()
def reached_threshold(network: GoalConditionedNetwork, exploration: Exploration) -> float:
    """Returns how sure the recognizer is of the closer half of frames that are one action from a goal.

    The threshold that separates training's labels best is lower by far, and would call a goal reached some actions too
    early.

    Args:
        network: Trained.
        exploration: Held out, at least one trajectory of 2 timesteps.
    """
    device = next(network.parameters()).device
    scores = []
    for item in range(len(exploration)):
        frames = exploration.frames[item][:_FRAMES]
        embedded = network.recognizer(torch.tensor(frames, device=device))  # (T, embedding)
        scores.append(closeness(embedded[1:], embedded[:-1]).cpu().numpy())  # (T - 1,)
    return float(np.median(1 / (1 + np.exp(-np.concatenate(scores)))))
