"""Kind `ppo`: trains a policy for one task by PPO over the network, on a reward for what its frames show.

An unprivileged session returns frames only, and rewards are computed from them. Only a reward that declares itself
privileged, to compare with, may take a privileged session.

<run>/checkpoints/   freerein_orchestrator.rl.trainer
      artifacts/     the policy, freerein.learning.actor_critic.policy_files, and a video of it
"""

from collections.abc import Collection, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any, cast

import torch
from torch import Tensor

from freerein.clients.tasks import find_camera, find_task
from freerein.config import bounded, one_of, parse
from freerein.data.lookup import open_dataset
from freerein.errors import InvalidInput
from freerein.learning.actor_critic.networks import ActorCritic
from freerein.learning.actor_critic.policy_files import StoredPolicy, save_in_distribution, save_policy
from freerein.learning.checkpoints import JSON, Checkpoint
from freerein.learning.encoders import ENCODERS
from freerein.learning.model_files import choose_device
from freerein.types.common import Camera, ModelRef, check_name
from freerein.types.sim import CreateSessionRequest, Task
from freerein_orchestrator.envs.practice import PractisingEnvs
from freerein_orchestrator.envs.recovery import RecoveringCollector
from freerein_orchestrator.envs.vector_env import RewardFn, open_groups
from freerein_orchestrator.kinds.context import RunContext
from freerein_orchestrator.kinds.finished_training import check_sims, find_training
from freerein_orchestrator.kinds.kind import Kind
from freerein_orchestrator.kinds.policy_store import PolicyStore
from freerein_orchestrator.kinds.policy_video import can_film, save_video
from freerein_orchestrator.rewards import REWARDS, make_rewards
from freerein_orchestrator.rewards.entry import RewardSetting
from freerein_orchestrator.rewards.learned import LearnedReward
from freerein_orchestrator.rl.config import PPOConfig
from freerein_orchestrator.rl.env_groups import ClosableVecEnv, EnvGroups
from freerein_orchestrator.rl.goal_eye import ObjectEncoder, fit_eye, load_object_encoder
from freerein_orchestrator.rl.initial_network import calibrate, network_spec
from freerein_orchestrator.rl.reward import Reward
from freerein_orchestrator.rl.state import PPOState, Prepare, from_checkpoint, init_state, trained_on
from freerein_orchestrator.rl.trainer import Trainer
from freerein_orchestrator.rl.visited_frames import fit_in_distribution, visited_frames

EYE = "goal_eye"
_VISITED_ROLLOUTS = 2  # as many timesteps as in two iterations
_FIELD, _RESUME_FIELD = "config.init_from", "config.resume_from"


@dataclass(frozen=True, kw_only=True)
class PPORunConfig(PPOConfig):
    """Configuration of a run of kind `ppo`.

    Attributes:
        task: The task's name.
        goal_text: The goal in words that the reward model knows; empty for the task's own.
        camera: The camera that policy and reward see; empty for the task's first.
        reward: `learned`, 1 where a reward model prefers the goal text to its rival captions; `base`, the similarity of
            goal text and frame by the grounding model; `oracle`, the true reward, to compare with. See
            Rewards for the others.
        dataset: Name of the dataset whose trajectories end in success, for a reward that sees such examples.
        reward_model: Name of the reward model; empty for the service's default, for `base` `grounding`. The version
            that is active when the run starts is used to its end.
        encoder: `goal_eye`, a frozen eye for the two objects of the goal and the policy's own body, or an image encoder
            that is trained with the policy, such as `spatial`, or `convolutional` for a camera that moves. The eye has
            the encoder of `reward_model`; for `base`, that of the service's default reward model.
        conditions: The task's conditions that it is trained under, such as a curriculum of starts.
        action_repeat: Timesteps that each action is held for, or until the episode ends, in training and after it.
        practice_share: Share of the environments that begin a rollout in a state that an earlier episode of the
            training passed on its way to a reward; 0 for none.
        episode_steps: Timesteps after which training truncates an episode, so that more of them begin; 0 for the task's
            own length.
        init_from: Initial weights: a run's id, an earlier step of the same pipeline, or a policy among the models of
            the orchestrator; empty for random weights. Optimiser, reward normaliser, noise and schedule begin anew.
        resume_from: A ppo run that has succeeded, or an earlier step of the same pipeline, whose training this one goes
            on with for `iterations` more: weights, optimiser, reward normaliser, noise, schedule and environments as
            they were. Keys other than those of the update must be those of that run.

    Raises:
        InvalidInput: Both `init_from` and `resume_from` are given, or the reward needs another encoder, or a dataset.
    """

    task: str
    goal_text: str = ""
    camera: str = ""
    reward: str = one_of(REWARDS, "learned")
    dataset: str = ""
    reward_model: str = ""
    encoder: str = one_of((EYE, *ENCODERS), EYE)
    conditions: tuple[str, ...] = ()
    action_repeat: int = bounded(2, least=1, most=16)
    episode_steps: int = bounded(50, least=0, most=10_000)
    practice_share: float = bounded(0.0, least=0.0, most=1.0)
    init_from: str = ""
    resume_from: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.init_from and self.resume_from:
            raise InvalidInput(
                "One of `init_from` and `resume_from` may be given; got both.",
                field=_RESUME_FIELD,
                hint="`resume_from` goes on with a training; `init_from` begins one with its weights alone.",
            )
        entry = REWARDS[self.reward]
        if entry.needs_eye not in (None, self.encoder == EYE):
            needed = (EYE,) if entry.needs_eye else tuple(ENCODERS)
            raise InvalidInput(
                f"The reward `{self.reward}` needs the encoder {' or '.join(needed)}; got `{self.encoder}`.",
                field="config.encoder",
                hint=f"--set encoder={'spatial' if 'spatial' in needed else EYE}",
            )
        if bool(self.dataset) != ("success_examples" in entry.sees):
            raise InvalidInput(
                f"`dataset` is for rewards that see examples of success; `{self.reward}` is "
                f"{'none of them' if self.dataset else 'one, and got none'}.",
                field="config.dataset",
                hint="Leave it out." if self.dataset else "Name a dataset whose trajectories end in success.",
            )
        if self.dataset:
            check_name(self.dataset, field="config.dataset")


def run(context: RunContext, config: PPORunConfig) -> None:
    """Trains the policy, or resumes its training.

    Raises:
        Stopped: The run is to stop.
        InvalidInput: The configuration does not fit the task, or there is no such task.
        FailedPrecondition: Three iterations in a row were rejected, the disk is full, or the run was started with other
            inputs.
        ServiceError: A service failed permanently.
    """
    training = _Training(context, config)
    trainer = Trainer(
        context.folder,
        init=lambda: training.retry.call(training.init),
        load=training.load,
        collector=training.collector,
        metrics_log=context.metrics_logger,
        interrupt=training.retry.interrupt,
        log_line=context.log_line,
        threads=config.threads,
    )
    state = trainer.train()
    frames = training.retry.call(lambda: training.visited_frames(state))
    save_in_distribution(fit_in_distribution(frames), context.artifacts)
    task = training.retry.call(lambda: find_task(training.sims[0], config.task))
    if can_film(context):
        save_video(context, frames[:: config.num_envs].numpy(), dt_s=task.control_dt_s * config.action_repeat)
    save_policy(state.network, context.artifacts, card=_card(config, state, task))


def check(config: PPORunConfig, store: PolicyStore, earlier: Collection[str]) -> None:
    """Checks that the initial policy, or the training to go on with, exists and fits, or will exist.

    Raises:
        InvalidInput: It does not.
    """
    if config.init_from and config.init_from not in earlier:
        store.load(config.init_from, field=_FIELD)
    if config.resume_from and config.resume_from not in earlier:
        find_training(store, config.resume_from, config, field=_RESUME_FIELD)


def truth(config: Mapping[str, Any]) -> str:
    """Returns the supervision by a reward that is privileged; empty for another."""
    entry = REWARDS.get(config.get("reward", ""))
    return entry.supervision if entry is not None and entry.privileged else ""


KIND = Kind(
    {"": PPORunConfig},
    partial(parse, PPORunConfig),
    steps=lambda config: config.iterations,
    run=run,
    check=check,
    truth=truth,
    meaning="Trains a policy for one task by PPO, on a reward for what its frames show.",
)


def session_request(config: PPORunConfig) -> CreateSessionRequest:
    """Returns the session of a training: privileged for a reward that declares itself so and sees the true rewards."""
    return CreateSessionRequest(
        config.task,
        num_envs=config.num_envs,
        seed=config.seed,
        privileged=REWARDS[config.reward].gets_true_rewards,
        conditions=config.conditions,
    )


class _Training:
    """The environments and rewards of a run.

    The state's `inputs` are what a run is bound to when it starts: `goal_text`, `camera`, `model` (name and version of
    the reward model; empty without one), `eye` (those of the one whose encoder the policy sees with; empty without),
    the number of `sims`, the initial policy's sha256 and supervision (`init`), and whether any of that is `privileged`.
    """

    def __init__(self, context: RunContext, config: PPORunConfig) -> None:
        self.retry = context.retry()
        self.device = choose_device(context.device)
        self.sims = context.replicas("sim")[: config.num_envs]
        self._context = context
        self._config = config
        self._entry = REWARDS[config.reward]

    def init(self) -> PPOState:
        """Returns the state before the first iteration."""
        if self._config.resume_from:
            return self._trained_on()
        config, task = self._config, find_task(self.sims[0], self._config.task)
        if "success_examples" in self._entry.sees:
            open_dataset(self._context.data_dir, config.dataset)  # refuses one that is not there, before all else
        camera, goal_text = find_camera(task, config.camera), config.goal_text or task.goal_text
        eye, encoder = self._eye(goal_text, camera) if config.encoder == EYE else (None, None)
        spec = network_spec(
            config,
            observation=(camera.height, camera.width, camera.channels),
            action_size=task.action.size,
            action_choices=task.action.choices,
            eye=encoder.spec if encoder else None,
            encoder=config.encoder,
            action_repeat=config.action_repeat,
        )
        policy = self._context.policies.load(config.init_from, field=_FIELD) if config.init_from else None
        inputs: dict[str, JSON] = {
            "goal_text": goal_text,
            "camera": camera.name,
            "model": asdict(self._entry.resolve_model(self._setting(goal_text, camera, ModelRef(config.reward_model)))),
            "eye": {} if eye is None else asdict(eye),
            "sims": len(self.sims),
            "init": {name: policy.card.get(name) for name in ("supervision", "sha256")} if policy else {},
            "privileged": self._entry.privileged or (policy is not None and policy.card.get("privileged") is True),
        }
        prepare = self._prepare(encoder) if policy is None else partial(_copy_policy, policy)
        with closing(self._open_envs(Reward().of_frames, camera.name, ())) as envs:
            return init_state(
                config,
                spec,
                envs,
                device=self.device,
                prepare=prepare,
                make_rewards=self._make_rewards,
                inputs=inputs,
            )

    def load(self, checkpoint: Checkpoint) -> PPOState:
        """Returns the state of a checkpoint."""
        inputs: dict[str, JSON] = {"sims": len(self.sims)}
        return from_checkpoint(
            checkpoint, self._config, device=self.device, make_rewards=self._make_rewards, inputs=inputs
        )

    def _trained_on(self) -> PPOState:
        """Returns the state of the training that this one goes on with."""
        config = self._config
        checkpoint = find_training(self._context.policies, config.resume_from, config, field=_RESUME_FIELD)
        check_sims(checkpoint, len(self.sims))
        return trained_on(checkpoint, config, device=self.device, make_rewards=self._make_rewards)

    def collector(self, state: PPOState) -> RecoveringCollector:
        """Returns what collects the rollouts of a state."""
        open_envs = partial(self._open_envs, state.rewards[0].of_frames, cast(str, state.inputs["camera"]))
        return RecoveringCollector(open_envs, num_steps=self._config.num_steps, retry=self.retry)

    def visited_frames(self, state: PPOState) -> Tensor:
        """Returns the frames that the trained policy visits, uint8 (steps * N, H, W, C): step after step of N envs."""
        config, generator = self._config, torch.Generator().manual_seed(self._config.seed)
        camera = cast(str, state.inputs["camera"])
        with closing(self._open_envs(Reward().of_frames, camera, ())) as envs:
            steps = _VISITED_ROLLOUTS * config.num_steps
            return visited_frames(state.network, envs, generator, num_steps=steps)

    def _eye(self, goal_text: str, camera: Camera) -> tuple[ModelRef, ObjectEncoder]:
        """Returns the encoder that the policy's eye has, and the reward model that it is of."""
        name = self._config.reward_model if self._entry.encodes_objects else ""
        answer = LearnedReward(self._context.client("reward"), goal_text, camera.name, ModelRef(name)).resolve(camera)
        folder = self._context.reward_models.folder(answer.model)
        return answer.model, load_object_encoder(folder, goal_caption=answer.texts[0], camera=camera)

    def _prepare(self, encoder: ObjectEncoder | None) -> Prepare:
        if encoder is None:
            return calibrate
        config = self._config
        return partial(
            fit_eye,
            objects=encoder.weights,
            explorations=config.explorations,
            augmentation=config.augmentation,
        )

    def _make_rewards(self, network: ActorCritic, inputs: Mapping[str, JSON]) -> Sequence[Reward]:
        """Returns the untrained rewards of a training with these inputs."""
        spec, bound = network.spec, cast(dict[str, Any], inputs)
        camera = Camera(bound["camera"], spec.height, spec.width, spec.channels)
        setting = self._setting(bound["goal_text"], camera, ModelRef(**bound["model"]))
        return make_rewards(self._entry, setting, network)

    def _setting(self, goal_text: str, camera: Camera, model: ModelRef) -> RewardSetting:
        config, context = self._config, self._context
        service = context.client("reward")
        return RewardSetting(config, goal_text, camera, model, service, context.data_dir, config.dataset)

    def _open_envs(self, reward_fn: RewardFn, camera: str, snapshots: Sequence[bytes]) -> EnvGroups[ClosableVecEnv]:
        config = self._config
        steps = config.episode_steps if snapshots else 0  # explorations begin new episodes themselves
        envs = open_groups(
            self.sims,
            replace(session_request(config), max_episode_steps=steps),
            camera=camera,
            reward_fn=reward_fn,
            action_repeat=config.action_repeat,
            snapshots=snapshots,
            interrupt=self.retry.interrupt,
        )
        if not (snapshots and config.practice_share):
            return envs
        return EnvGroups(
            [
                PractisingEnvs(
                    group,
                    share=config.practice_share,
                    num_steps=config.num_steps,
                    memory=next(iter(own[len(self.sims) :]), None),
                    seed=(config.seed, index),
                )
                for index, (group, own) in enumerate(
                    zip(envs.groups, _shares(snapshots, len(envs.groups)), strict=True)
                )
            ]
        )


def _shares(snapshots: Sequence[bytes], groups: int) -> list[Sequence[bytes]]:
    """Returns the snapshots of each group."""
    each = len(snapshots) // groups
    return [snapshots[group * each : (group + 1) * each] for group in range(groups)]


def _copy_policy(policy: StoredPolicy, network: ActorCritic, *_: object) -> None:
    """Copies the weights of the initial policy.

    Raises:
        InvalidInput: It has another network.
    """
    if policy.network.spec != network.spec:
        raise InvalidInput(
            f"The initial policy must have the network {network.spec}; it has {policy.network.spec}.",
            field=_FIELD,
            hint="Choose the task and the configuration of the network that it was trained with.",
        )
    network.load_state_dict(policy.network.state_dict())


def _card(config: PPORunConfig, state: PPOState, task: Task) -> dict[str, JSON]:
    init = cast(Mapping[str, JSON], state.inputs["init"])
    arranged = (
        f"; the simulator arranged episodes of training: {', '.join(config.conditions)}" if config.conditions else ""
    )
    practised = "; episodes of training began in states that earlier ones had visited" if config.practice_share else ""
    before = f"; the initial policy had this supervision: {init['supervision']}" if init else ""
    return {
        "task": config.task,
        "action": asdict(task.action),
        "control_dt_s": task.control_dt_s,
        "max_episode_steps": task.max_episode_steps,
        **state.inputs,
        "reward": config.reward,
        "supervision": REWARDS[config.reward].supervision + arranged + practised + before,
        "config": asdict(config),
        "figures": {
            "iterations": state.schedule.before + state.iteration,
            "timesteps": state.timesteps,
            **state.metrics,
        },
    }
