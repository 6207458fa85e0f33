"""Settings of the imitation service."""

from pydantic import Field

from freerein.serving.learned import LearnedSettings


class ImitationSettings(LearnedSettings):
    """Settings of the imitation service, from the environment."""

    http_port: int = Field(default=8102, ge=0, le=65535)
    grpc_port: int = Field(default=9102, ge=0, le=65535)
