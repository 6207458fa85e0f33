"""Exploration by curiosity: PPO on the intrinsic rewards of an ICM, all of it recorded.

Checkpoints and dataset grow together: an iteration that a crash interrupted is repeated to the same bits, and those of
its trajectories that are missing are written.
"""

import json
import math
from collections.abc import Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path

from freerein.clients.tasks import find_task
from freerein.data import Writer
from freerein.data.dataset_recorder import dataset_spec, recording
from freerein.errors import FailedPrecondition
from freerein.learning.actor_critic.networks import ActorCritic
from freerein.learning.checkpoints import JSON
from freerein.learning.model_files import choose_device
from freerein.types.common import Trajectory
from freerein.types.sim import CreateSessionRequest
from freerein_orchestrator.envs.recovery import RecoveringCollector
from freerein_orchestrator.envs.vector_env import RemoteVectorEnv, open_groups
from freerein_orchestrator.kinds.collect.config import CollectConfig
from freerein_orchestrator.kinds.context import RunContext
from freerein_orchestrator.rewards.curiosity import CuriosityReward
from freerein_orchestrator.rl.config import PPOConfig
from freerein_orchestrator.rl.env_groups import EnvGroups
from freerein_orchestrator.rl.icm import ICMConfig
from freerein_orchestrator.rl.initial_network import network_spec
from freerein_orchestrator.rl.reward import Reward
from freerein_orchestrator.rl.rollout import RolloutBuffer
from freerein_orchestrator.rl.state import PPOState, from_checkpoint, init_state
from freerein_orchestrator.rl.trainer import Trainer


def explore(context: RunContext, config: CollectConfig, root: Path) -> None:
    """Records what curiosity does.

    Args:
        context: The run's.
        config: Its configuration.
        root: The dataset's folder.

    Raises:
        Stopped: The run is to stop.
        FailedPrecondition: The dataset holds something else, or three iterations in a row were rejected.
        ServiceError: The sim service refuses.
    """
    retry, device = context.retry(), choose_device(context.device)
    sims = context.replicas("sim")[: config.num_envs]
    task = retry.call(lambda: find_task(sims[0], config.task))
    spec = dataset_spec(task, cameras=config.cameras, height=config.height, width=config.width)
    ((camera, frame),) = spec.cameras.items()
    inputs: dict[str, JSON] = {**json.loads(json.dumps(asdict(config))), "sims": len(sims)}
    del inputs["parts"]  # of mixes alone
    ppo, make_rewards = _ppo_config(config), partial(_make_rewards, config)

    def open_envs(snapshots: Sequence[bytes]) -> EnvGroups[RemoteVectorEnv]:
        request = CreateSessionRequest(
            config.task,
            num_envs=config.num_envs,
            seed=config.seed,
            height=config.height,
            width=config.width,
            conditions=config.conditions,
        )
        return open_groups(
            sims,
            request,
            cameras=(camera,),
            reward_fn=Reward().of_frames,
            snapshots=snapshots,
            interrupt=retry.interrupt,
        )

    def init() -> PPOState:
        network = network_spec(ppo, observation=frame, action_size=task.action.size, action_choices=task.action.choices)
        with closing(open_envs(())) as envs:
            return init_state(ppo, network, envs, device=device, make_rewards=make_rewards, inputs=inputs)

    with recording(root, spec, {**inputs, "conditions": sorted(config.conditions)}) as writer:
        Trainer(
            context.folder,
            init=lambda: retry.call(init),
            load=partial(from_checkpoint, config=ppo, device=device, make_rewards=make_rewards, inputs=inputs),
            collector=lambda _: RecoveringCollector(open_envs, num_steps=ppo.num_steps, retry=retry),
            metrics_log=context.metrics_logger,
            interrupt=retry.interrupt,
            log_line=context.log_line,
            recorder=TrajectoryRecorder(writer, camera, config.count),
        ).train()


@dataclass(frozen=True)
class TrajectoryRecorder:
    """Writes rollouts to a dataset as trajectories, cut where episodes end; a `Recorder`.

    Attributes:
        writer: The dataset's.
        camera: The camera of the frames.
        target: Trajectories wanted.
    """

    writer: Writer
    camera: str
    target: int

    def count(self, rollout: RolloutBuffer) -> int:
        """Returns the number of trajectories in a rollout."""
        return len(episode_slices(rollout))

    def record(self, rollout: RolloutBuffer, first: int) -> None:
        """Records the trajectories of a rollout that are not yet on disk; `first` is the number of the first one.

        Raises:
            FailedPrecondition: Trajectories of earlier rollouts are missing.
        """
        if first > len(self.writer):
            raise FailedPrecondition(
                f"The dataset must hold the {first} trajectories of the run so far; it holds {len(self.writer)}.",
                hint="Start a new run.",
            )
        for index, trajectory in enumerate(trajectories(rollout, self.camera), first):
            if len(self.writer) == index < self.target:
                self.writer.append(trajectory)


def trajectories(rollout: RolloutBuffer, camera: str) -> list[Trajectory]:
    """Returns a rollout as trajectories within episodes, in order of their last timestep."""
    frames, actions = rollout.observations.numpy(), rollout.executed_actions.numpy()
    terminated = rollout.terminated.numpy()
    return [
        Trajectory({camera: frames[start:end, env]}, actions[start:end, env], terminated=terminated[start:end, env])
        for end, env, start in episode_slices(rollout)
    ]


def episode_slices(rollout: RolloutBuffer) -> list[tuple[int, int, int]]:
    """Returns (end, environment, start) of each part of an episode in a rollout, sorted."""
    slices = []
    for env, dones in enumerate(rollout.dones.T):
        cuts = [0, *(dones[:-1].nonzero()[:, 0] + 1).tolist(), len(dones)]
        slices += [(end, env, start) for start, end in pairwise(cuts)]
    return sorted(slices)


def _make_rewards(config: CollectConfig, policy: ActorCritic, _inputs: object) -> tuple[Reward, ...]:
    return (CuriosityReward(ICMConfig(seed=config.seed), policy, transitions=config.num_envs * config.length),)


def _ppo_config(config: CollectConfig) -> PPOConfig:
    """Returns the policy's hyperparameters; gamma and ent_coef are those of Pathak et al. (2017)."""
    minibatches = next(count for count in (4, 2, 1) if config.num_envs % count == 0)
    return PPOConfig(
        iterations=math.ceil(config.count / config.num_envs),  # each records a trajectory per environment at least
        num_envs=config.num_envs,
        num_steps=config.length,
        epochs=4,
        hidden_size=64,
        layer_norm=False,
        init_log_std=-0.5,
        final_log_std=None,
        batch_size=config.num_envs * config.length // minibatches,
        gamma=0.99,
        ent_coef=0.01,
        seed=config.seed,
    )
