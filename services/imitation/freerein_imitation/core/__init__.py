"""The core of the imitation service: `ActService` for unary calls, `ControlService` for streams, `PublishService`."""

from freerein_imitation.core.act import ActService
from freerein_imitation.core.control import ControlService
from freerein_imitation.core.inference import PolicyRunner
from freerein_imitation.core.publish import PublishService

__all__ = ["ActService", "ControlService", "PolicyRunner", "PublishService"]
