"""Calls services: numpy in, numpy out, one asyncio client per gRPC service.

A client's methods are the service's calls; they take and return the dataclasses of `freerein.types` and raise the
errors of `freerein.errors`. `SyncClient` makes any client a blocking one, and `freerein.clients.envs` (extra `envs`)
makes sessions of the sim service Gymnasium environments.
"""

from freerein.clients.channel import Channel as Channel
from freerein.clients.imitation import ImitationClient as ImitationClient
from freerein.clients.learning import FitClient as FitClient
from freerein.clients.learning import ModelClient as ModelClient
from freerein.clients.orchestrator import OrchestratorClient as OrchestratorClient
from freerein.clients.reward import RewardClient as RewardClient
from freerein.clients.segmentation import SegmentationClient as SegmentationClient
from freerein.clients.sim import SimClient as SimClient
from freerein.clients.sync_client import SyncClient as SyncClient
