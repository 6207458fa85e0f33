"""A trained policy of a ppo run on disk.

<folder>/policy.safetensors            weights
         policy.json                   card: `spec`, task, reward, supervision, figures; written last
         in_distribution.safetensors   the in-distribution score, `freerein.learning.in_distribution`
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from freerein.atomic_files import write_atomic
from freerein.errors import FailedPrecondition, InvalidInput, quoted
from freerein.learning import model_files, tensor_files, weights
from freerein.learning.actor_critic.networks import ActorCritic, ActorCriticSpec
from freerein.learning.checkpoints import JSON
from freerein.learning.image_statistics import statistics_sizes
from freerein.learning.in_distribution import InDistribution
from freerein.types.common import Camera

KIND = "ppo"
_MISSING = "Train the policy again: earlier versions of freerein did not keep it."
NAMES = model_files.ModelFileNames("policy.safetensors", "policy.json")
IN_DISTRIBUTION_FILE = "in_distribution.safetensors"


@dataclass(frozen=True, eq=False)
class StoredPolicy:
    """A trained policy and its card.

    Attributes:
        network: In evaluation mode.
        card: Task, reward, supervision, figures.
    """

    network: ActorCritic
    card: Mapping[str, Any]

    @property
    def cameras(self) -> tuple[str, ...]:
        """The cameras that it observes, in order; earlier versions had one."""
        return tuple(map(str, self.card.get("cameras") or [self.card["camera"]]))


def save_policy(network: ActorCritic, folder: Path, *, card: Mapping[str, JSON]) -> None:
    """Writes a policy as a folder; the card gets the sha256 of the weights.

    Args:
        network: Trained.
        folder: Made when missing; its files are overwritten.
        card: Besides kind and spec.
    """
    model_files.save_model(network, folder, card={"kind": KIND, **card, "sha256": weights.sha256(network)}, names=NAMES)


def load_policy(folder: Path, *, device: str) -> StoredPolicy:
    """Returns the policy in a folder.

    Args:
        folder: Written by `save_policy`; read as untrusted.
        device: `auto`, `cpu` or `cuda:N`.

    Raises:
        InvalidInput: A file is missing or malformed, or the card is of other weights.
    """
    network = model_files.load_model(folder, ActorCriticSpec, ActorCritic, device=device, names=NAMES)
    card = model_files.read_card(folder, names=NAMES)
    digest = weights.sha256(network)
    if card.get("kind") != KIND or card.get("sha256") != digest:
        raise InvalidInput(
            f"A policy's card must have kind {KIND} and sha256 {digest}, of its weights; got "
            f"{quoted(str(card.get('kind')))} and {quoted(str(card.get('sha256')))}.",
            hint="Run ppo again, or restore its folder from a copy.",
        )
    return StoredPolicy(network, card)


def save_in_distribution(score: InDistribution, folder: Path) -> None:
    """Writes a fitted in-distribution score beside a policy."""
    write_atomic(folder / IN_DISTRIBUTION_FILE, tensor_files.dump(score.state_dict()))


def load_in_distribution(folder: Path, *, cameras: Sequence[Camera]) -> InDistribution:
    """Returns the in-distribution score of frames of some cameras.

    Raises:
        FailedPrecondition: There is none beside the policy.
        InvalidInput: The file is malformed.
    """
    path, score = folder / IN_DISTRIBUTION_FILE, InDistribution(*statistics_sizes(cameras))
    if not path.is_file():
        raise FailedPrecondition(
            f"The policy must have been stored with an in-distribution score; it has no `{IN_DISTRIBUTION_FILE}`.",
            hint=_MISSING,
        )
    try:
        score.load_state_dict(tensor_files.parse(path.read_bytes()))
    except RuntimeError as error:
        names = ", ".join(each.name for each in cameras)
        raise InvalidInput(
            f"`{IN_DISTRIBUTION_FILE}` must be of the policy's cameras, {names}; its tensors have other shapes.",
            hint="Restore the policy's folder from a copy.",
        ) from error
    return score
