"""Evaluation of a model of criteria on validation moments."""

import numpy as np
import torch

from freerein.criterion_text import Claim
from freerein_reward.methods.criterion_captions.captions import FALSE, TRUE, sampled_tuples
from freerein_reward.methods.criterion_captions.decisions import goal_scores, rewards
from freerein_reward.methods.criterion_captions.keypoint_dataset import KeypointDataset
from freerein_reward.methods.criterion_captions.losses import caption_scores, locate_all, stacked
from freerein_reward.methods.criterion_captions.network import STATEMENTS, CriterionNetwork


@torch.no_grad()
def evaluate_criteria(network: CriterionNetwork, dataset: KeypointDataset, *, tolerance: float) -> dict[str, float]:
    """Returns the balanced accuracy of rewards by criterion, and the share of absent goals that are rewarded.

    Where all images say the same of a criterion, it has none. Captions come from the grounding model, so that this is
    agreement with it, not ground truth.
    """
    tuples = sampled_tuples(len(network.spec.phrases), np.random.default_rng(0))
    labels = dataset.captions(tuples, tolerance=tolerance)
    scores = caption_scores(network, locate_all(network, stacked(dataset), network.device), tuples)
    is_missing = labels[..., STATEMENTS.index((Claim.MISSING, ""))] == TRUE
    figures, absent = {}, []
    for criterion, numbers, among in goal_scores(scores, tuples, network.grammar):
        is_rewarded = rewards(among).cpu().numpy()
        holds = labels[:, numbers][..., STATEMENTS.index((Claim.HOLDS, criterion.name))]
        absent.append(is_rewarded[is_missing[:, numbers]])
        fails = (holds == FALSE) & ~is_missing[:, numbers]
        if (holds == TRUE).any() and fails.any():
            recall, specificity = is_rewarded[holds == TRUE].mean(), 1 - is_rewarded[fails].mean()
            figures[f"{criterion.name}.balanced_accuracy"] = float(recall + specificity) / 2
    rewarded = np.concatenate(absent)
    return {**figures, "absent_rewarded": float(rewarded.mean()) if len(rewarded) else 0.0}
