"""One asyncio client per gRPC service.

Its methods are the service's RPCs; they take and return dataclasses of `freerein.types` and raise `freerein.errors`.
`SyncClient` wraps any client for blocking use; `freerein.envs` (extra `envs`) has Gymnasium environments.
"""

from freerein.clients.channel import Channel as Channel
from freerein.clients.services import FitClient as FitClient
from freerein.clients.services import ImitationClient as ImitationClient
from freerein.clients.services import ModelClient as ModelClient
from freerein.clients.services import OrchestratorClient as OrchestratorClient
from freerein.clients.services import RewardClient as RewardClient
from freerein.clients.services import SegmentationClient as SegmentationClient
from freerein.clients.services import SimClient as SimClient
from freerein.clients.sync_client import SyncClient as SyncClient
