"""Reward `constant`: 0 everywhere, the baseline of what shaping alone, or nothing, teaches."""

from freerein_orchestrator.rewards.entry import RewardEntry
from freerein_orchestrator.rl.reward import Reward

CONSTANT = RewardEntry(lambda *_: Reward(), "none", frozenset())
