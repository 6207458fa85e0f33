"""Calls the reward service."""

from functools import cached_property

from freerein.api.reward.v1 import reward_pb2_grpc
from freerein.clients.channel import DEADLINE_S, Client
from freerein.types.reward import (
    DescribeRequest,
    DescribeResponse,
    EmbedGoalRequest,
    EmbedGoalResponse,
    GroundRequest,
    GroundResponse,
    RewardRequest,
    RewardResponse,
)


class RewardClient(Client):
    """Rewards images against goal text. Every call raises `freerein.errors.ServiceError` when it fails."""

    @cached_property
    def _stub(self) -> "reward_pb2_grpc.RewardServiceAsyncStub":
        return reward_pb2_grpc.RewardServiceStub(self._channel.grpc)

    async def reward(self, request: RewardRequest, *, timeout_s: float = DEADLINE_S) -> RewardResponse:
        """Returns the reward of every frame."""
        return await self._channel.unary(self._stub.Reward, request, RewardResponse, timeout_s=timeout_s)

    async def ground(self, request: GroundRequest, *, timeout_s: float = DEADLINE_S) -> GroundResponse:
        """Returns where the things that phrases name are in an image."""
        return await self._channel.unary(self._stub.Ground, request, GroundResponse, timeout_s=timeout_s)

    async def describe(self, request: DescribeRequest, *, timeout_s: float = DEADLINE_S) -> DescribeResponse:
        """Returns captions of images."""
        return await self._channel.unary(self._stub.Describe, request, DescribeResponse, timeout_s=timeout_s)

    async def embed_goal(self, request: EmbedGoalRequest, *, timeout_s: float = DEADLINE_S) -> EmbedGoalResponse:
        """Returns the embedding of a goal text."""
        return await self._channel.unary(self._stub.EmbedGoal, request, EmbedGoalResponse, timeout_s=timeout_s)
