"""The methods of the service, by name. A new one is a folder or a module here, and a line in `METHODS`."""

from types import MappingProxyType

from freerein.learning.methods import Methods
from freerein_imitation.methods import (
    goal_cloning,
    goal_conditioned,
    goal_recognizer,
    inverse_model,
    language,
    skill_cloning,
    skills,
)
from freerein_imitation.model import ppo
from freerein_imitation.model.policy import Policy

METHODS: Methods[Policy] = Methods(
    "imitation",
    MappingProxyType(
        {
            "goal_conditioned": goal_conditioned.METHOD,
            "goal_cloning": goal_cloning.METHOD,
            "skills": skills.METHOD,
            "skill_cloning": skill_cloning.METHOD,
            "language": language.METHOD,
            "inverse_model": inverse_model.METHOD,
            "goal_recognizer": goal_recognizer.METHOD,
        }
    ),
    made_elsewhere=MappingProxyType({ppo.METHOD: ppo.load}),
)
