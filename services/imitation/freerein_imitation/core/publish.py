"""`PublishService`: policies of finished ppo runs become models that are served by name."""

import asyncio
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from freerein.config import parse
from freerein.data.folder_locks import temporary_folder
from freerein.errors import FailedPrecondition, InvalidInput, NotFound, quoted
from freerein.learning.actor_critic import policy_files
from freerein.learning.model_files import save_model
from freerein.types.common import ActionSpec, Camera, ModelRef, check_id, check_name
from freerein.types.imitation import PublishPolicyRequest, PublishPolicyResponse
from freerein_imitation.core.act import Policies
from freerein_imitation.model import ppo
from freerein_imitation.model.policy import NEVER_REACHED, ControlSpec

_KEPT = ("task", "goal_text", "camera", "reward", "model", "supervision", "privileged", "sha256", "config", "figures")


class PublishService:
    """Answers `PublishPolicy`.

    Args:
        models: The policies.
        data_dir: Data directory, whose `runs/` are those of the orchestrator.
    """

    def __init__(self, models: Policies, data_dir: Path) -> None:
        self._models = models
        self._data_dir = data_dir

    async def publish_policy(self, request: PublishPolicyRequest) -> PublishPolicyResponse:
        """Publishes the policy of a run, loads it and activates it.

        Raises:
            InvalidInput: Id or name are malformed, or the run's files are.
            NotFound: There is no such run.
            FailedPrecondition: The run has no policy, or one without all that is served of it.
        """
        artifacts = self._data_dir / "runs" / check_id(request.run, field="run") / "artifacts"
        if request.model_name:
            check_name(request.model_name, field="model_name")
        return PublishPolicyResponse(await self._publish(artifacts, request))

    async def _publish(self, artifacts: Path, request: PublishPolicyRequest) -> ModelRef:
        with temporary_folder(self._data_dir, prefix=".published-") as staging:
            folder = staging / "model"
            task = await asyncio.to_thread(convert, artifacts, folder, data=f"ppo run {request.run}")
            return await self._models.publish(check_name(request.model_name or task, field="model_name"), folder)


def convert(artifacts: Path, folder: Path, *, data: str) -> str:
    """Writes the policy in a run's artifacts as a model of this service; returns the name of the run's task.

    Args:
        artifacts: Of a run, or the folder of a stored policy.
        folder: Made.
        data: Entry of the model's card: what it was trained on.

    Raises:
        NotFound: There is no such run.
        FailedPrecondition: The run has no policy, or one without all that is served of it.
        InvalidInput: The run's files are malformed.
    """
    if not artifacts.parent.is_dir():
        raise NotFound(
            f"The run must exist; got the id {quoted(artifacts.parent.name)}.",
            field="run",
            hint="`freerein jobs list` names the runs.",
        )
    if not (artifacts / policy_files.NAMES.card).is_file():
        raise FailedPrecondition(
            "The run must be a ppo run that succeeded; it has left no policy.",
            field="run",
            hint="`freerein jobs list` tells the state of each.",
        )
    policy = policy_files.load_policy(artifacts, device="cpu")
    spec, control = _spec(policy)
    network = ppo.PPOPolicyNetwork(spec)
    network.actor_critic = policy.network
    network.in_distribution = policy_files.load_in_distribution(artifacts, cameras=spec.cameras)
    card: dict[str, Any] = {name: policy.card.get(name) for name in _KEPT}
    folder.mkdir()
    save_model(network, folder, card={**card, "method": ppo.METHOD, "data": data, **control.to_card()})
    return str(policy.card.get("task"))


def _spec(policy: policy_files.StoredPolicy) -> tuple[ppo.PPOPolicySpec, ControlSpec]:
    card: Mapping[str, Any] = policy.card
    network = policy.network.spec
    try:
        action, cameras, task = parse(ActionSpec, card["action"]), policy.cameras, str(card["task"])
        control = ControlSpec(float(card["control_dt_s"]), NEVER_REACHED, int(card["max_episode_steps"]))
    except (KeyError, TypeError, ValueError, InvalidInput) as error:
        raise FailedPrecondition(
            f"The policy must have been stored with its actions and control rate; got: {quoted(repr(error))}.",
            field="run",
            hint="Train the policy again: earlier versions of freerein did not keep them.",
        ) from error
    return (
        ppo.PPOPolicySpec(
            cameras=tuple(Camera(name, network.height, network.width, network.channels) for name in cameras),
            action=action,
            network=network,
            goal_text=str(card.get("goal_text") or task),
        ),
        control,
    )
