"""The task that a run of kind `ppo` is about: where its frames and its rewards come from.

An unprivileged session shows images and nothing else, and rewards are judged from these. Only the oracle's reward, to
compare with, takes a privileged session.
"""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any, cast

import numpy as np

from freerein.errors import InvalidInput, NotFound
from freerein.learning.checkpoints import JSON, Checkpoint
from freerein.learning.model_files import choose_device
from freerein.types.common import Camera, ModelRef
from freerein.types.reward import Mode
from freerein.types.sim import CreateSessionRequest, ListTasksRequest, ListTasksResponse, Task
from freerein_orchestrator import ppo_training
from freerein_orchestrator.judges import Frames, Judge, LearnedReward, oracle
from freerein_orchestrator.patience import Patience
from freerein_orchestrator.ppo_config import PPORunConfig
from freerein_orchestrator.ppo_training import PPOTraining
from freerein_orchestrator.rollout import Rewards
from freerein_orchestrator.served import ServedEnvironments
from freerein_orchestrator.served_rollouts import ServedRollouts, persist
from freerein_orchestrator.taught import taught_policy
from freerein_orchestrator.work import Work

_GROUNDING = "grounding"
_TOLD = ("supervision", "sha256")


class ServedTask:
    """A task over the network.

    What a run is bound to when it begins, its terms: `goal_text`, `camera`, `model` (name and version of what judges;
    empty for the oracle), how many `sims` the environments are split over, what taught the policy to start from (its
    `start`, with the `sha256` of its weights; empty without one), and whether all that is `privileged`.

    Args:
        work: The run.
        config: What was chosen.
        patience: Waits for services that are away.
    """

    def __init__(self, work: Work, config: PPORunConfig, patience: Patience) -> None:
        self._work = work
        self._config = config
        self._patience = patience
        self._sees_truth = config.reward == "oracle"
        self._device = choose_device(work.device)
        self._sims = work.clients("sim")[: config.num_envs]
        self._reward = work.client("reward")

    def begin(self) -> PPOTraining:
        """Returns the training before its first iteration.

        Raises:
            InvalidInput: The configuration does not fit the task, or the policy to start from does not.
            NotFound: There is no such task or model.
            Stopped: The run is to stop.
        """
        return persist(self._begun, self._patience)

    def resume(self, checkpoint: Checkpoint) -> PPOTraining:
        """Returns the training that a checkpoint is of.

        Raises:
            FailedPrecondition: It was begun with something else.
        """
        return ppo_training.restore(checkpoint, self._config, device=self._device, terms={"sims": len(self._sims)})

    def rollouts(self, training: PPOTraining) -> ServedRollouts:
        """Returns where the experience of a training comes from."""
        terms = cast(dict[str, Any], training.terms)
        judge: Judge = oracle
        if not self._sees_truth:
            judge = self._learned_reward(terms["goal_text"], terms["camera"], ModelRef(**terms["model"]))

        def open_at(snapshots: Sequence[bytes]) -> ServedEnvironments:
            return self._open(judge, terms["camera"], snapshots)

        return ServedRollouts(open_at, self._config, self._patience)

    def _begun(self) -> PPOTraining:
        task = self._task()
        camera, goal_text = self._camera(task), self._config.goal_text or task.goal_text
        size = (camera.height, camera.width, camera.channels)
        spec = ppo_training.design(
            self._config, observation=size, action_size=task.action.size, action_choices=task.action.choices
        )
        taught = taught_policy(self._work, self._config.start_from, spec) if self._config.start_from else None
        terms: dict[str, JSON] = {
            "goal_text": goal_text,
            "camera": camera.name,
            "model": asdict(self._pinned(goal_text, camera)),
            "sims": len(self._sims),
            "start": {name: taught.card.get(name) for name in _TOLD} if taught else {},
            "privileged": self._sees_truth or (taught is not None and taught.card.get("privileged") is True),
        }
        environments = self._open(_unjudged, camera.name)
        try:
            return ppo_training.begin(
                self._config,
                spec,
                environments,
                device=self._device,
                taught=None if taught is None else taught.network,
                terms=terms,
            )
        finally:
            environments.close()

    def _task(self) -> Task:
        reply: ListTasksResponse = self._sims[0].list_tasks(ListTasksRequest())
        found = next((task for task in reply.tasks if task.name == self._config.task), None)
        if found is None:
            raise NotFound(
                "The task must be one of the sim service's; it has none of that name.",
                field="config.task",
                hint="`freerein sim tasks` names them.",
            )
        return found

    def _camera(self, task: Task) -> Camera:
        by_name = {camera.name: camera for camera in task.cameras}
        if self._config.camera and self._config.camera not in by_name:
            raise InvalidInput(
                f"`camera` must be one of the task's, {', '.join(by_name)}; got another.", field="config.camera"
            )
        return by_name[self._config.camera] if self._config.camera else task.cameras[0]

    def _pinned(self, goal_text: str, camera: Camera) -> ModelRef:
        """Returns which version of which model judges from now on."""
        if self._sees_truth:
            return ModelRef()
        name = self._config.reward_model or (_GROUNDING if self._config.reward == "base" else "")
        judge = self._learned_reward(goal_text, camera.name, ModelRef(name))
        return judge.pin(camera.height, camera.width, camera.channels)

    def _learned_reward(self, goal_text: str, camera: str, model: ModelRef) -> LearnedReward:
        mode: Mode = "raw" if self._config.reward == "base" else "binary"
        return LearnedReward(self._reward, goal_text, camera, model, mode)

    def _open(self, judge: Judge, camera: str, snapshots: Sequence[bytes] = ()) -> ServedEnvironments:
        config = self._config
        request = CreateSessionRequest(
            config.task, num_envs=config.num_envs, seed=config.seed, privileged=self._sees_truth
        )
        return ServedEnvironments(
            self._sims, request, camera=camera, judge=judge, snapshots=snapshots, interrupt=self._patience.interrupt
        )


def _unjudged(reached: Frames, _oracle: Rewards | None) -> Rewards:
    """Returns no rewards: before the first iteration nothing is learnt from."""
    return np.zeros(len(reached), np.float32)
