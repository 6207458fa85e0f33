"""Records what curiosity does, all of it, while it learns: the run's checkpoints and the dataset grow together.

    <folder>/checkpoints/step-...   the whole exploration, after each iteration, once its trajectories are on disk

An iteration that a crash broke off is made again to the same bits, and what is missing of its trajectories is written.
"""

import json
import math
from collections.abc import Sequence
from contextlib import closing
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from freerein.clients.dataset_recorder import dataset_spec, open_or_resume
from freerein.clients.tasks import find_task
from freerein.data import Writer
from freerein.errors import FailedPrecondition
from freerein.learning import checkpoints
from freerein.learning.checkpoints import JSON
from freerein.learning.model_files import choose_device
from freerein.types.common import Trajectory
from freerein.types.sim import CreateSessionRequest, Task
from freerein_orchestrator import exploration as explorations
from freerein_orchestrator import ppo_training
from freerein_orchestrator.curiosity import CuriosityConfig
from freerein_orchestrator.curve import Curve
from freerein_orchestrator.exploration import Exploration
from freerein_orchestrator.judges import Frames
from freerein_orchestrator.kinds.collect_config import CollectConfig
from freerein_orchestrator.patience import Patience
from freerein_orchestrator.ppo_config import PPOConfig
from freerein_orchestrator.rejection import Rejected
from freerein_orchestrator.rollout import Rewards
from freerein_orchestrator.served import ServedEnvironments
from freerein_orchestrator.served_rollouts import ServedRollouts, persist
from freerein_orchestrator.work import Work

_IN_A_ROW = 3


def explore(work: Work, config: CollectConfig, root: Path) -> None:
    """Records what curiosity does.

    Args:
        work: The run.
        config: What was chosen.
        root: Where the dataset lies, or will lie.

    Raises:
        Stopped: The run is to stop.
        FailedPrecondition: The dataset holds something else, the task has no snapshots, or three iterations in a row
            were worthless.
        ServiceError: The sim service refuses.
    """
    torch.set_num_threads(1)
    torch.set_flush_denormal(True)
    explorer = _Explorer(work, config)
    with open_or_resume(root, explorer.dataset_spec, explorer.terms) as writer:
        worthless = 0
        while len(writer) < config.count:
            held = len(writer)
            try:
                explorer.go_on(writer)
            except Rejected as error:
                worthless = worthless + 1 if len(writer) == held else 1
                work.say(f"Rolled back, {worthless} in a row: {error.detail}")
                if worthless == _IN_A_ROW:
                    raise FailedPrecondition(
                        f"An iteration was worthless {_IN_A_ROW} times in a row; the last time: {error.detail}",
                        hint=error.hint,
                    ) from error


class _Explorer:
    """Explores a task over the network.

    Attributes:
        terms: What is recorded, as JSON.
        dataset_spec: What its trajectories have in common.
    """

    def __init__(self, work: Work, config: CollectConfig) -> None:
        self._work = work
        self._config = config
        self._policy, self._curious = _policy_config(config), CuriosityConfig(seed=config.seed)
        self._device = choose_device(work.device)
        self._patience = Patience(np.random.default_rng(), stop=work.stop, say=work.say)
        self._sims = work.clients("sim")[: config.num_envs]
        self._task = self._patience.ask(self._find_task)
        self.dataset_spec = dataset_spec(self._task, cameras=config.cameras, height=config.height, width=config.width)
        self.terms: dict[str, JSON] = {**json.loads(json.dumps(asdict(config))), "sims": len(self._sims)}
        (self._camera,) = self.dataset_spec.cameras
        self._reached = _Reached()

    def go_on(self, writer: Writer) -> None:
        """Explores from the last checkpoint until all trajectories are recorded; `Rejected` asks for another go."""
        exploration = self._saved() or self._begun()
        if exploration.recorded > len(writer):
            raise FailedPrecondition(
                f"The dataset must hold the {exploration.recorded} trajectories of the run so far; "
                f"it holds {len(writer)}.",
                hint="Start a new run.",
            )
        rollouts = ServedRollouts(self._open, self._policy, self._patience)
        with closing(rollouts), closing(self._work.curve(last_step=exploration.recorded)) as curve:
            while exploration.recorded < self._config.count:
                made, exploration = self._iterate(exploration, rollouts)
                self._report(exploration, curve)  # first: the row of the last trajectory is there when that is
                for index, trajectory in enumerate(made, exploration.recorded - len(made)):
                    if len(writer) == index < self._config.count:
                        writer.append(trajectory)
                checkpoints.save(self._folder, explorations.snapshot(exploration))

    @property
    def _folder(self) -> Path:
        return self._work.folder / "checkpoints"

    def _iterate(self, exploration: Exploration, rollouts: ServedRollouts) -> tuple[list[Trajectory], Exploration]:
        """Returns what was done in an iteration, and the exploration thereafter."""
        training = exploration.training
        rollout, outset = rollouts.gather(training.actor, training.outset)
        reached = self._reached.take(len(rollout.ends))
        after = explorations.advance(exploration, rollout, reached, outset, interrupt=self._patience.interrupt)
        return explorations.trajectories(rollout, self._camera), after

    def _report(self, exploration: Exploration, curve: Curve) -> None:
        training, count = exploration.training, self._config.count
        timesteps = training.iteration * training.config.num_envs * training.config.steps
        curve.append(min(exploration.recorded, count), {**training.metrics, "timesteps": float(timesteps)})

    def _saved(self) -> Exploration | None:
        found = checkpoints.newest(
            self._folder, on_corrupt=lambda step, detail: self._work.say(f"Checkpoint {step} is passed over: {detail}")
        )
        if found is None:
            return None
        training = ppo_training.restore(found, self._policy, device=self._device, terms=self.terms)
        return explorations.restore(training, found, self._curious)

    def _begun(self) -> Exploration:
        exploration = persist(self._begin, self._patience)
        checkpoints.save(self._folder, explorations.snapshot(exploration))
        return exploration

    def _begin(self) -> Exploration:
        action = self._task.action
        spec = ppo_training.design(
            self._policy,
            observation=self.dataset_spec.cameras[self._camera],
            action_size=action.size,
            action_choices=action.choices,
        )
        with closing(self._open()) as environments:
            training = ppo_training.begin(self._policy, spec, environments, device=self._device, terms=self.terms)
        return explorations.begin(training, self._curious)

    def _open(self, snapshots: Sequence[bytes] = ()) -> ServedEnvironments:
        self._reached = _Reached()
        config = self._config
        request = CreateSessionRequest(
            config.task, num_envs=config.num_envs, seed=config.seed, height=config.height, width=config.width
        )
        return ServedEnvironments(
            self._sims,
            request,
            camera=self._camera,
            judge=self._reached,
            snapshots=snapshots,
            interrupt=self._patience.interrupt,
        )

    def _find_task(self) -> Task:
        task = find_task(self._sims[0], self._config.task)
        if not task.snapshots:
            raise FailedPrecondition(
                "Curiosity needs a task with snapshots, so that a run can go on; this one has none.",
                hint="Collect what is done at random.",
            )
        return task


class _Reached:
    """Keeps what the environments came to, and rewards nothing: what is worth something is said by curiosity."""

    def __init__(self) -> None:
        self._frames: list[Frames] = []

    def __call__(self, reached: Frames, oracle: Rewards | None) -> Rewards:
        """Returns zeros; as `Judge`."""
        self._frames.append(reached)
        return np.zeros(len(reached), np.float32)

    def take(self, steps: int) -> Tensor:
        """Returns what was reached since the last call, in T steps: uint8 (T, N, H, W, C)."""
        frames, self._frames = torch.from_numpy(np.concatenate(self._frames)), []
        return frames.reshape(steps, -1, *frames.shape[1:])


def _policy_config(config: CollectConfig) -> PPOConfig:
    """Returns how the policy of curiosity is trained: discount and entropy weight are those of Pathak et al. (2017)."""
    return PPOConfig(
        iterations=math.ceil(config.count / config.num_envs),  # each makes at least one trajectory in each environment
        num_envs=config.num_envs,
        steps=config.length,
        batch_size=config.num_envs * config.length // _minibatches(config.num_envs),
        lr=1e-3,
        discount=0.99,
        entropy_weight=0.01,
        overlap=False,
        seed=config.seed,
    )


def _minibatches(num_envs: int) -> int:
    return next(count for count in (4, 2, 1) if num_envs % count == 0)
