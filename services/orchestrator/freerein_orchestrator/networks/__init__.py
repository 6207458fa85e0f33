"""The networks of reinforcement learning: what to do, and what it is worth."""

from freerein_orchestrator.networks.actor_critic import ActorCritic, ActorCriticSpec, Outputs
from freerein_orchestrator.networks.distributions import Categorical, Distribution, Gaussian

__all__ = ["ActorCritic", "ActorCriticSpec", "Categorical", "Distribution", "Gaussian", "Outputs"]
