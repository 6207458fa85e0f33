"""Reward `base`: the similarity of goal text and frame by the grounding model."""

from freerein_orchestrator.rewards.learned import served_entry

BASE = served_entry(
    "raw",
    "goal text; the grounding model saw captions of single objects",
    default_model="grounding",
    encodes_objects=False,
)
