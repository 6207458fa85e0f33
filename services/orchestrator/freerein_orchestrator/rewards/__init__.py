"""The rewards that a training may be given, a module each; `entry.py` is what one consists of."""

from collections.abc import Mapping

from freerein.learning.actor_critic.networks import ActorCritic
from freerein_orchestrator.rewards.alive import ALIVE
from freerein_orchestrator.rewards.constant import CONSTANT
from freerein_orchestrator.rewards.curiosity import CURIOSITY
from freerein_orchestrator.rewards.entry import RewardEntry, RewardSetting
from freerein_orchestrator.rewards.learned import LEARNED
from freerein_orchestrator.rewards.novelty import NOVELTY
from freerein_orchestrator.rewards.oracle import ORACLE
from freerein_orchestrator.rewards.rule import RULE
from freerein_orchestrator.rewards.shaping import SHAPING
from freerein_orchestrator.rewards.similarity import BASE
from freerein_orchestrator.rewards.vice import VICE
from freerein_orchestrator.rl.reward import Reward

REWARDS: Mapping[str, RewardEntry] = {
    "learned": LEARNED,
    "base": BASE,
    "oracle": ORACLE,
    "curiosity": CURIOSITY,
    "novelty": NOVELTY,
    "constant": CONSTANT,
    "shaping": SHAPING,
    "vice": VICE,
    "rule": RULE,
    "alive": ALIVE,
}


def make_rewards(entry: RewardEntry, setting: RewardSetting, network: ActorCritic) -> tuple[Reward, ...]:
    """Returns the untrained reward of a training; then shaping, where the policy has an object encoder."""
    added = [] if network.eye is None else [SHAPING]
    return tuple(each.make(setting, network) for each in dict.fromkeys([entry, *added]))
