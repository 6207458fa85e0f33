"""Kind `ppo`: trains a policy for one task by PPO over the network, on a reward for what its frames show.

An unprivileged session returns frames only, and rewards are computed from them. Only a reward that declares itself
privileged, to compare with, may take a privileged session.

<run>/checkpoints/   freerein_orchestrator.rl.trainer
      artifacts/     the policy, freerein.learning.actor_critic.policy_files, and a video of it
"""

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, replace
from functools import partial
from typing import Any, cast

import torch
from torch import Tensor

from freerein.clients.tasks import find_task
from freerein.config import parse
from freerein.data.lookup import open_dataset
from freerein.errors import InvalidInput
from freerein.learning.actor_critic.networks import ActorCritic
from freerein.learning.actor_critic.object_encoder import OBJECT_ENCODER
from freerein.learning.actor_critic.policy_files import StoredPolicy, save_in_distribution, save_policy
from freerein.learning.checkpoints import JSON, Checkpoint
from freerein.learning.model_files import choose_device
from freerein.types.common import Camera, ModelRef
from freerein.types.sim import CreateSessionRequest, Task
from freerein_orchestrator.envs.practice import PractisingEnvs
from freerein_orchestrator.envs.recovery import RecoveringCollector
from freerein_orchestrator.envs.vector_env import RewardFn, open_groups
from freerein_orchestrator.kinds.context import RunContext
from freerein_orchestrator.kinds.finished_training import check_sims, find_training
from freerein_orchestrator.kinds.kind import Kind
from freerein_orchestrator.kinds.observed_cameras import ObservedCameras
from freerein_orchestrator.kinds.policy_store import PolicyStore, is_step
from freerein_orchestrator.kinds.policy_video import can_film, save_video
from freerein_orchestrator.kinds.ppo_config import RESUME_FIELD, PPORunConfig
from freerein_orchestrator.rewards import REWARDS, make_rewards
from freerein_orchestrator.rewards.entry import RewardSetting
from freerein_orchestrator.rewards.learned import LearnedReward
from freerein_orchestrator.rl.env_groups import ClosableVecEnv, EnvGroups
from freerein_orchestrator.rl.initial_network import calibrate, network_spec
from freerein_orchestrator.rl.object_encoder import RewardEncoder, fit_object_encoder, load_reward_encoder
from freerein_orchestrator.rl.reward import Reward
from freerein_orchestrator.rl.state import PPOState, Prepare, from_checkpoint, init_state, trained_on
from freerein_orchestrator.rl.trainer import Trainer
from freerein_orchestrator.rl.vec_env import VecEnv
from freerein_orchestrator.rl.visited_frames import fit_in_distribution, visited_frames

_VISITED_ROLLOUTS = 2  # as many timesteps as in two iterations
_FIELD = "config.init_from"


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
    spec = state.network.spec
    score = fit_in_distribution(frames, num_envs=config.num_envs, cameras=spec.cameras)
    save_in_distribution(score, context.artifacts)
    task = training.retry.call(lambda: find_task(training.sims[0], config.task))
    if can_film(context):
        filmed = frames[:: config.num_envs, ..., : spec.channels].numpy()  # of the first camera
        save_video(context, filmed, dt_s=task.control_dt_s * config.action_repeat)
    save_policy(state.network, context.artifacts, card=_card(config, state, task))


def check(config: PPORunConfig, store: PolicyStore, earlier: Mapping[str, str]) -> None:
    """Checks that the initial policy, or the training to go on with, exists and fits, or will exist.

    Raises:
        InvalidInput: It does not.
    """
    if config.init_from and not is_step(config.init_from, earlier, field=_FIELD):
        store.load(config.init_from, field=_FIELD)
    if config.resume_from and not is_step(config.resume_from, earlier, field=RESUME_FIELD):
        find_training(store, config.resume_from, config, field=RESUME_FIELD)


def truth(config: Mapping[str, Any], store: PolicyStore) -> str:
    """Returns the supervision by a reward that is privileged, else of a privileged policy to begin with; or nothing."""
    entry = REWARDS.get(config.get("reward", ""))
    if entry is not None and entry.privileged:
        return entry.supervision
    return store.privileged_supervision(config.get("init_from") or config.get("resume_from") or "")


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
        height=config.height,
        width=config.width,
        privileged=REWARDS[config.reward].gets_true_rewards,
        conditions=config.conditions,
    )


class _Training:
    """The environments and rewards of a run.

    The state's `inputs` bind a run when it starts: `goal_text`, `caption` (the goal as the object encoder's reward
    model reads it; empty without one), `camera`, `cameras` and `reward_cameras`, `model` (name and version of the
    reward model; empty without one), `eye` (those of the reward model of the object encoder; empty without), the
    number of `sims`, the initial policy's sha256 and supervision (`init`), and whether any of that is `privileged`.
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
        if task.reward_free and self._entry.gets_true_rewards:
            raise InvalidInput(
                f"The reward {config.reward} needs a task with a reward; {task.name} is reward-free.",
                field="config.reward",
                hint="Choose another reward, such as learned or curiosity; or a task with a goal.",
            )
        if "success_examples" in self._entry.sees:
            open_dataset(self._context.data_dir, config.dataset)  # refuses one that is not there, before all else
        cameras, goal_text = ObservedCameras.find(task, config), config.goal_text or task.goal_text
        camera = cameras.policy[0]
        encoder_model, encoder = (
            self._reward_encoder(goal_text, camera) if config.encoder == OBJECT_ENCODER else (None, None)
        )
        spec = network_spec(
            config,
            observation=(camera.height, camera.width, camera.channels),
            action_size=task.action.size,
            action_choices=task.action.choices,
            object_encoder=encoder.spec if encoder else None,
            encoder=config.encoder,
            action_repeat=config.action_repeat,
            cameras=len(cameras.policy),
            frame_stack=config.frame_stack,
            gray=config.gray,
        )
        policy = self._context.policies.load(config.init_from, field=_FIELD) if config.init_from else None
        caption = encoder.caption if encoder else ""
        setting = self._setting(goal_text, caption, cameras.reward, ModelRef(config.reward_model))
        inputs: dict[str, JSON] = {
            "goal_text": goal_text,
            "caption": caption,
            **cameras.to_inputs(),
            "model": asdict(self._entry.resolve_model(setting)),
            "eye": {} if encoder_model is None else asdict(encoder_model),
            "sims": len(self.sims),
            "init": {name: policy.card.get(name) for name in ("supervision", "sha256")} if policy else {},
            "privileged": self._entry.privileged or (policy is not None and policy.card.get("privileged") is True),
        }
        prepare = self._prepare(encoder) if policy is None else partial(_copy_policy, policy)
        with closing(self._open_envs(Reward().of_frames, cameras, ())) as envs:
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
        checkpoint = find_training(self._context.policies, config.resume_from, config, field=RESUME_FIELD)
        check_sims(checkpoint, len(self.sims))
        return trained_on(checkpoint, config, device=self.device, make_rewards=self._make_rewards)

    def collector(self, state: PPOState) -> RecoveringCollector:
        """Returns what collects the rollouts of a state."""
        cameras = ObservedCameras.of_inputs(state.inputs, state.network.spec)
        open_envs = partial(self._open_envs, state.rewards[0].of_frames, cameras)
        return RecoveringCollector(open_envs, num_steps=self._config.num_steps, retry=self.retry)

    def visited_frames(self, state: PPOState) -> Tensor:
        """Returns the frames that the trained policy visits, uint8 (steps * N, H, W, C): step after step of N envs."""
        config, generator = self._config, torch.Generator().manual_seed(self._config.seed)
        cameras = ObservedCameras.of_inputs(state.inputs, state.network.spec)
        with closing(self._open_envs(Reward().of_frames, cameras, ())) as envs:
            steps = _VISITED_ROLLOUTS * config.num_steps
            return visited_frames(state.network, envs, generator, num_steps=steps)

    def _reward_encoder(self, goal_text: str, camera: Camera) -> tuple[ModelRef, RewardEncoder]:
        """Returns the reward model whose image encoder the policy's object encoder has, and that encoder."""
        config, field = self._config, f"config.{'eye_model' if self._config.eye_model else 'reward_model'}"
        name = config.eye_model or (config.reward_model if self._entry.encodes_objects else "")
        answer = LearnedReward(self._context.client("reward"), goal_text, ModelRef(name)).resolve((camera,))
        folder = self._context.reward_models.folder(answer.model)
        return answer.model, load_reward_encoder(folder, goal_caption=answer.texts[0], camera=camera, field=field)

    def _prepare(self, encoder: RewardEncoder | None) -> Prepare:
        if encoder is None:
            return calibrate
        config = self._config

        def prepare(network: ActorCritic, envs: VecEnv, generator: torch.Generator) -> None:
            self._context.log_line("Before the first iteration, the encoder of the policy's own body is fitted.")
            fit_object_encoder(
                network,
                envs,
                generator,
                objects=encoder.weights,
                explorations=config.explorations,
                augmentation=config.augmentation,
                interrupt=self.retry.interrupt,
            )
            self._context.log_line("The encoder of the policy's own body is fitted.")

        return prepare

    def _make_rewards(self, network: ActorCritic, inputs: Mapping[str, JSON]) -> Sequence[Reward]:
        """Returns the untrained rewards of a training with these inputs."""
        bound, cameras = cast(dict[str, Any], inputs), ObservedCameras.of_inputs(inputs, network.spec)
        caption = bound.get("caption", "")  # earlier versions had none
        setting = self._setting(bound["goal_text"], caption, cameras.reward, ModelRef(**bound["model"]))
        return make_rewards(self._entry, setting, network)

    def _setting(self, goal_text: str, caption: str, cameras: tuple[Camera, ...], model: ModelRef) -> RewardSetting:
        config, context = self._config, self._context
        service = context.client("reward")
        return RewardSetting(config, goal_text, caption, cameras, model, service, context.data_dir, config.dataset)

    def _open_envs(
        self, reward_fn: RewardFn, cameras: ObservedCameras, snapshots: Sequence[bytes]
    ) -> EnvGroups[ClosableVecEnv]:
        config = self._config
        steps = config.episode_steps if snapshots else 0  # explorations begin new episodes themselves
        envs = open_groups(
            self.sims,
            replace(session_request(config), max_episode_steps=steps),
            cameras=[camera.name for camera in cameras.policy],
            reward_fn=reward_fn,
            reward_cameras=[camera.name for camera in cameras.reward],
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
