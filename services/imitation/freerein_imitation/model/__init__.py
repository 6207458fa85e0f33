"""Policy networks, and the policies that serve them: numpy in, numpy out."""

from pathlib import Path

from freerein.errors import InvalidInput
from freerein.learning import model_files
from freerein_imitation.model.goal_conditioned import GoalConditionedPolicy
from freerein_imitation.model.language import LanguagePolicy
from freerein_imitation.model.policy import Policy
from freerein_imitation.model.skills import SkillsPolicy

_CLASSES = (GoalConditionedPolicy, SkillsPolicy, LanguagePolicy)


def load(folder: Path, device: str) -> Policy:
    """Returns the policy in a folder; its card's `kind` selects the class.

    Args:
        folder: Written by a fit; read as untrusted.
        device: `auto`, `cpu` or `cuda:N`.

    Raises:
        InvalidInput: A file is missing or malformed.
    """
    kind = model_files.read_card(folder).get("kind")
    for each in _CLASSES:
        if kind == each.kind:
            return each.load(folder, device)
    raise InvalidInput(
        f"A policy's card must have `kind` {' or '.join(each.kind for each in _CLASSES)}; got another or none.",
        hint="Fit the model again, or restore its folder from a copy.",
    )
