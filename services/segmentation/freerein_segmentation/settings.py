"""Operator settings of the segmentation service."""

from pydantic import Field

from freerein.serving.learned import LearnedSettings


class SegmentationSettings(LearnedSettings):
    """Settings of the segmentation service."""

    http_port: int = Field(default=8101, ge=0, le=65535)
    grpc_port: int = Field(default=9101, ge=0, le=65535)
