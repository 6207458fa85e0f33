"""The core of the imitation service: `ActService` for unary calls, `ControlService` for control streams."""

from freerein_imitation.core.act import ActService
from freerein_imitation.core.control import ControlService
from freerein_imitation.core.inference import PolicyRunner

__all__ = ["ActService", "ControlService", "PolicyRunner"]
