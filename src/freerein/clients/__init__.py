"""One asyncio client per gRPC service.

Its methods are the service's RPCs; they take and return dataclasses of `freerein.types` and raise `freerein.errors`.
`SyncClient` wraps any client for blocking use; `freerein.clients.envs` (extra `envs`) has Gymnasium environments.
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
