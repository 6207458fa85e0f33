"""What an operator may change of the segmentation service."""

from pydantic import Field

from freerein.serving.settings import ServiceSettings


class SegmentationSettings(ServiceSettings):
    """Settings of the segmentation service.

    Attributes:
        device: Where models run: `auto`, `cpu` or `cuda:N`.
        train_threads: Threads of a fit that does not say; small networks are as fast on one as on two.
    """

    http_port: int = Field(default=8101, ge=0, le=65535)
    grpc_port: int = Field(default=9101, ge=0, le=65535)
    device: str = Field(default="auto", pattern=r"^(auto|cpu|cuda:\d+)$")
    train_threads: int = Field(default=1, ge=1, le=256)
