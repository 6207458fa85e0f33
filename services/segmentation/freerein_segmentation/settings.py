"""What an operator may change of the segmentation service."""

from pydantic import Field

from freerein.serving.settings import ServiceSettings


class SegmentationSettings(ServiceSettings):
    """Settings of the segmentation service.

    Attributes:
        device: Where models run: `auto`, `cpu` or `cuda:N`.
    """

    http_port: int = Field(default=8101, ge=0, le=65535)
    grpc_port: int = Field(default=9101, ge=0, le=65535)
    device: str = Field(default="auto", pattern=r"^(auto|cpu|cuda:\d+)$")
