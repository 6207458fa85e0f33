"""A fit as a process of its own: `python -m freerein_imitation.fit FOLDER DATA_DIR DEVICE`.

FOLDER holds `config.json`; metrics and checkpoints are written there, and in the end `model/`. The exit codes are those
of `freerein.jobs.child`. The configuration's `policy` says which kind of policy is fitted.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from freerein.errors import InvalidInput
from freerein.jobs.child import run_child
from freerein_imitation.fit import goal_conditioned, language, skills
from freerein_imitation.fit.source import Source, open_source
from freerein_imitation.model import GoalConditionedPolicy, LanguagePolicy, SkillsPolicy


@dataclass(frozen=True)
class _Kind:
    """A kind of policy, as a fit knows it.

    Attributes:
        resolve: Returns the whole configuration of a fit on a dataset.
        train: Writes the model into the fit's folder and returns True, or returns False when stopped before.
    """

    resolve: Callable[[Source, Mapping[str, Any]], dict[str, Any]]
    train: Callable[[Path, Source, Mapping[str, Any], str], bool]


def resolve(data_dir: Path, dataset: str, values: Mapping[str, Any], *, threads: int) -> dict[str, Any]:
    """Returns the whole configuration of a fit.

    Args:
        data_dir: The data directory.
        dataset: A dataset's name.
        values: What was asked for.
        threads: Of torch, where not asked for.

    Raises:
        NotFound: There is no such dataset.
        InvalidInput: The configuration is wrong, or the dataset cannot be learned from.
        FailedPrecondition: Skills are to be learned, and the dataset is not labelled; or to follow texts, and there is
            no text tower.
    """
    kind = _kind(values)
    return kind.resolve(open_source(data_dir, dataset), {"threads": threads, **values})


def main(folder: Path, data_dir: Path, device: str) -> int:
    """Fits a model, or goes on fitting it; returns the process's exit code."""

    def train(asked: Mapping[str, Any]) -> bool:
        config = asked["config"]
        return _kind(config).train(folder, open_source(data_dir, asked["dataset"]), config, device)

    return run_child(folder, train)


def _kind(values: Mapping[str, Any]) -> _Kind:
    asked = values.get("policy", GoalConditionedPolicy.kind)
    kinds = {
        GoalConditionedPolicy.kind: _Kind(goal_conditioned.resolve, goal_conditioned.train),
        SkillsPolicy.kind: _Kind(skills.resolve, skills.train),
        LanguagePolicy.kind: _Kind(language.resolve, language.train),
    }
    if not isinstance(asked, str) or asked not in kinds:
        raise InvalidInput(
            f"`policy` must be {' or '.join(kinds)}; got something else.",
            field="config.policy",
            hint="Leave it out for goal images.",
        )
    return kinds[asked]
