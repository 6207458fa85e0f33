"""The base of policies whose goals are names of skills."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from freerein.errors import InvalidInput
from freerein_imitation.model.torch_policy import N, TorchPolicy


class SkillPolicy(TorchPolicy[N]):
    """Base of policies that execute skills by name."""

    def encode_goals(self, goals: Sequence[str]) -> npt.NDArray[np.float32]:
        """Returns one-hot codes of skill names, float32 (N, skills).

        Raises:
            InvalidInput: A name is not among the policy's skills.
        """
        skills = self.spec.skills
        unknown = sum(name not in skills for name in goals)
        if unknown:
            raise InvalidInput(
                f"Skills must be among {', '.join(skills)}; {unknown} of {len(goals)} are not.",
                field="goal",
                hint="GetSpec lists a model's skills.",
            )
        return np.eye(len(skills), dtype=np.float32)[[skills.index(name) for name in goals]]
