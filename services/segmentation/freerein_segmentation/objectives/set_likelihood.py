"""An end of training without shares: each timestep shows some skill of the set, however long each of them lasts.

Tag losses that pool over time are lowest where all tags have equal shares, which moves boundaries. Here a timestep is
given only the skills that it does not show, as with complementary labels (Katsura and Uchida, 2022, arXiv
2206.11011). That alone would allow any mixture of the tags, and skills that vanish; it follows a training by
`lse_per_timestep`.
"""

from torch import Tensor

from freerein_segmentation.objectives.tags import mask_scores

LEAST_OF_EQUAL_SHARE = 0.35
"""Share of the timesteps, relative to an equal one, below which a tag is pushed up."""

ENTROPY_WEIGHT = 0.1


def set_likelihood(scores: Tensor, mask: Tensor, tags: Tensor) -> Tensor:
    """Returns -mean_t log sum_c P(y_t = c) over the tags c, with a floor for each tag's share and a little entropy.

    A share, the mean of P(y_t = c) over time, costs the logarithm of the floor over itself where it is below the floor,
    averaged over tags. Entropy is each timestep's, averaged over time, so that timesteps decide for one skill.
    """
    log_p = scores.log_softmax(dim=2)  # (B, T, K)
    timesteps = mask.sum(dim=1)
    inside = log_p.masked_fill(~tags[:, None], float("-inf")).logsumexp(dim=2)  # (B, T)
    entropy = -(log_p.exp() * log_p).sum(dim=2)
    each = (ENTROPY_WEIGHT * entropy - inside).where(mask, 0.0).sum(dim=1) / timesteps  # (B,)
    log_shares = mask_scores(log_p, mask).logsumexp(dim=1) - timesteps.log()[:, None]  # (B, K)
    count = tags.sum(dim=1)
    log_floor = (LEAST_OF_EQUAL_SHARE / count).log()[:, None]
    return each + (log_floor - log_shares).clamp(min=0.0).where(tags, 0.0).sum(dim=1) / count
