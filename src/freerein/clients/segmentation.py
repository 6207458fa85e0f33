"""Calls the segmentation service."""

from functools import cached_property

from freerein.api.segmentation.v1 import segmentation_pb2_grpc
from freerein.clients.channel import DEADLINE_S, Client
from freerein.types.segmentation import ListSkillsRequest, ListSkillsResponse, SegmentRequest, SegmentResponse


class SegmentationClient(Client):
    """Labels trajectories. Every call raises `freerein.errors.ServiceError` when it fails."""

    @cached_property
    def _stub(self) -> "segmentation_pb2_grpc.SegmentationServiceAsyncStub":
        return segmentation_pb2_grpc.SegmentationServiceStub(self._channel.grpc)

    async def segment(self, request: SegmentRequest, *, timeout_s: float = DEADLINE_S) -> SegmentResponse:
        """Returns the skill of every timestep of one trajectory."""
        return await self._channel.unary(self._stub.Segment, request, SegmentResponse, timeout_s=timeout_s)

    async def list_skills(self, request: ListSkillsRequest, *, timeout_s: float = DEADLINE_S) -> ListSkillsResponse:
        """Returns the skills that a model can label, and what it wants to see."""
        return await self._channel.unary(self._stub.ListSkills, request, ListSkillsResponse, timeout_s=timeout_s)
