"""Settings of the sim service."""

import os

from pydantic import Field

from freerein.serving.settings import ServiceSettings
from freerein_sim.workers.protocol import MAX_ENVS

_MOST_BY_DEFAULT = 32


class SimSettings(ServiceSettings):
    """Settings of the sim service.

    Attributes:
        sim_workers: Worker processes; default, one for each core that this process may use, 32 at most.
        sim_sessions: Greatest number of open sessions.
        sim_envs: Greatest number of environments of all open sessions.
    """

    sim_workers: int = Field(default_factory=lambda: min(_MOST_BY_DEFAULT, len(os.sched_getaffinity(0))), ge=1, le=256)
    sim_sessions: int = Field(default=64, ge=1, le=65536)
    sim_envs: int = Field(default=512, ge=MAX_ENVS, le=65536)
