"""How well a reward model agrees with captions that it has not learned from."""

from freerein_reward.model import DualEncoder
from freerein_reward.relations import Relation
from freerein_reward.training.described import Described, told_of
from freerein_reward.training.reward import score


def agreement(network: DualEncoder, described: Described) -> dict[str, float]:
    """Returns the share of captions that win over their rivals, and each relation's precision and recall.

    Captions are told by the grounding model, so that this is agreement, not truth.
    """
    captions = told_of(described.relations)  # (N, pairs)
    said = captions >= 0
    captions, winners = captions[said], score(network, described).argmax(dim=2).numpy()[said]
    figures = {"agreement": float((winners == captions).mean())}
    for relation in Relation:
        right = float(((winners == relation) & (captions == relation)).sum())
        name = relation.name.lower()
        figures[f"{name}.precision"] = right / max(1, int((winners == relation).sum()))
        figures[f"{name}.recall"] = right / max(1, int((captions == relation).sum()))
    return figures
