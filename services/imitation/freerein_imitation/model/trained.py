"""A trained policy of any kind, from its folder: the card's `kind` says which."""

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TypeAlias

from freerein.errors import InvalidInput
from freerein.learning import model_files
from freerein_imitation.model import goal_conditioned_policy, language_policy, skills_policy
from freerein_imitation.model.goal_conditioned_policy import GoalConditionedPolicy
from freerein_imitation.model.language_policy import LanguagePolicy
from freerein_imitation.model.skills_policy import SkillsPolicy

TrainedPolicy: TypeAlias = GoalConditionedPolicy | SkillsPolicy | LanguagePolicy

_LOADERS: Mapping[str, Callable[[Path, str], TrainedPolicy]] = MappingProxyType(
    {
        GoalConditionedPolicy.kind: goal_conditioned_policy.load,
        SkillsPolicy.kind: skills_policy.load,
        LanguagePolicy.kind: language_policy.load,
    }
)


def load(folder: Path, device: str) -> TrainedPolicy:
    """Returns the policy in a folder.

    Args:
        folder: Written by a fit; read as untrusted.
        device: `auto`, `cpu` or `cuda:N`.

    Raises:
        InvalidInput: A file is missing, or is not what a fit writes.
    """
    kind = model_files.read_card(folder).get("kind")
    if not isinstance(kind, str) or kind not in _LOADERS:
        raise InvalidInput(
            f"A policy's card must name its `kind`, {' or '.join(_LOADERS)}; it names another or none.",
            hint="Fit the model again, or restore its folder from a copy.",
        )
    return _LOADERS[kind](folder, device)
