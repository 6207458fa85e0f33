"""Former place of these names, which the drawings of experiments/robustness still import from here."""

from freerein.learning.actor_critic.policy_files import NAMES, load_policy
from freerein_orchestrator.rl.network_policy import NetworkPolicy

__all__ = ["NAMES", "NetworkPolicy", "load_policy"]
