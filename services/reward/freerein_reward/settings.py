"""Operator settings of the reward service."""

from pydantic import Field

from freerein.serving.learned import LearnedSettings


class RewardSettings(LearnedSettings):
    """Settings of the reward service.

    Attributes:
        goal_cache_bytes: Memory limit of the LRU cache of goal embeddings, in bytes.
    """

    goal_cache_bytes: int = Field(default=16 * 2**20, ge=0, le=2**34)
