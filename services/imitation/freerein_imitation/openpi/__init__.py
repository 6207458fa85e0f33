"""The WebSocket for robots with `openpi-client`: its messages, and the policy behind them."""

from freerein_imitation.openpi.service import OpenpiService

__all__ = ["OpenpiService"]
