"""The networks of chapter 3 and of sections 2.4 and 4.3, and trained ones as policies: numpy in, numpy out."""

from freerein_imitation.model.goal_conditioned import GoalConditionedNetwork, GoalConditionedSpec
from freerein_imitation.model.goal_conditioned_policy import GoalConditionedPolicy
from freerein_imitation.model.handshake import Handshake
from freerein_imitation.model.language import LanguageNetwork, LanguageSpec
from freerein_imitation.model.language_policy import LanguagePolicy
from freerein_imitation.model.skills import SkillsNetwork, SkillsSpec
from freerein_imitation.model.skills_policy import SkillsPolicy
from freerein_imitation.model.step import Step
from freerein_imitation.model.trained import TrainedPolicy, load

__all__ = [
    "GoalConditionedNetwork",
    "GoalConditionedPolicy",
    "GoalConditionedSpec",
    "Handshake",
    "LanguageNetwork",
    "LanguagePolicy",
    "LanguageSpec",
    "SkillsNetwork",
    "SkillsPolicy",
    "SkillsSpec",
    "Step",
    "TrainedPolicy",
    "load",
]
