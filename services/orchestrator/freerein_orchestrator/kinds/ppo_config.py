"""The configuration of runs of kind `ppo`."""

from dataclasses import dataclass

from freerein.config import bounded, one_of
from freerein.errors import InvalidInput, must_be
from freerein.learning.actor_critic.object_encoder import OBJECT_ENCODER
from freerein.learning.encoders import ENCODERS
from freerein.types.common import check_name
from freerein_orchestrator.rewards import REWARDS
from freerein_orchestrator.rewards.entry import RewardEntry
from freerein_orchestrator.rl.config import PPOConfig

RESUME_FIELD = "config.resume_from"


@dataclass(frozen=True, kw_only=True)
class PPORunConfig(PPOConfig):
    """Configuration of a run of kind `ppo`.

    Attributes:
        task: The task's name.
        goal_text: The goal in words that the reward model knows; empty for the task's own.
        camera: The camera that policy and reward see; empty for the task's first.
        cameras: Cameras that the policy sees instead, side by side on the channels; their frames have one size.
        reward_cameras: The cameras that the reward sees; empty for the policy's.
        frame_stack: The last frames of each camera that one observation is made of, on the channels, as a single one
            tells no velocity. One for each action: an action that is held passes frames over. Served, the policy keeps
            the earlier ones in its `state`.
        gray: Whether the policy sees frames in gray; the reward sees them as they are.
        height: Frame height in pixels, of all cameras; 0 for the cameras' own.
        width: Frame width in pixels; as `height`.
        reward: `learned`, 1 where a reward model prefers the goal text to its rival captions; `base`, the similarity of
            goal text and frame by the grounding model; `oracle`, the true reward, to compare with. See
            Rewards for the others.
        dataset: Name of the dataset whose trajectories end in success, for a reward that sees such examples.
        reward_model: Name of the reward model; empty for the service's default, for `base` and `rule` `grounding`. The
            version that is active when the run starts is used to its end.
        encoder: `goal_eye`, a frozen object encoder for the two objects of the goal and the policy's own body, or an
            image encoder trained with the policy, such as `spatial`, or `convolutional` for a camera that moves.
            The object encoder is that of `reward_model`; for `base` and `rule`, of the service's default reward model.
        eye_model: Name of the reward model that the object encoder is of instead; empty for that.
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
        InvalidInput: Both `init_from` and `resume_from` are given, or the reward needs another encoder, or a dataset,
            or takes no cameras of its own, or cameras are named twice, or the object encoder would see more than one
            RGB frame.
    """

    task: str
    goal_text: str = ""
    camera: str = ""
    cameras: tuple[str, ...] = ()
    reward_cameras: tuple[str, ...] = ()
    frame_stack: int = bounded(1, least=1, most=16)
    gray: bool = False
    height: int = bounded(0, least=0, most=1024)
    width: int = bounded(0, least=0, most=1024)
    reward: str = one_of(REWARDS, "learned")
    dataset: str = ""
    reward_model: str = ""
    encoder: str = one_of((OBJECT_ENCODER, *ENCODERS), OBJECT_ENCODER)
    eye_model: str = ""
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
                field=RESUME_FIELD,
                hint="`resume_from` goes on with a training; `init_from` begins one with its weights alone.",
            )
        entry = REWARDS[self.reward]
        if entry.needs_object_encoder not in (None, self.encoder == OBJECT_ENCODER):
            needed = (OBJECT_ENCODER,) if entry.needs_object_encoder else tuple(ENCODERS)
            raise InvalidInput(
                f"The reward `{self.reward}` needs the encoder {' or '.join(needed)}; got `{self.encoder}`.",
                field="config.encoder",
                hint=f"--set encoder={'spatial' if 'spatial' in needed else OBJECT_ENCODER}",
            )
        if self.eye_model and self.encoder != OBJECT_ENCODER:
            raise InvalidInput(
                f"`eye_model` is for the encoder `{OBJECT_ENCODER}`; the encoder is `{self.encoder}`.",
                field="config.eye_model",
                hint="Leave it out.",
            )
        self._check_cameras(entry)
        if bool(self.dataset) != ("success_examples" in entry.sees):
            raise InvalidInput(
                f"`dataset` is for rewards that see examples of success; `{self.reward}` is "
                f"{'none of them' if self.dataset else 'one, and got none'}.",
                field="config.dataset",
                hint="Leave it out." if self.dataset else "Name a dataset whose trajectories end in success.",
            )
        if self.dataset:
            check_name(self.dataset, field="config.dataset")

    def _check_cameras(self, entry: RewardEntry) -> None:
        names = self.cameras or (self.camera,)
        for field, given in (("cameras", names), ("reward_cameras", self.reward_cameras)):
            if len(set(given)) < len(given):
                got = f"{len(given)}, of which {len(set(given))} are different"
                raise must_be(field, "names of different cameras", got, field=f"config.{field}", hint="Name each once.")
        if self.camera and self.cameras:
            raise InvalidInput(
                "One of `camera` and `cameras` may be given; got both.", field="config.cameras", hint="Name all in one."
            )
        if self.reward_cameras and not entry.own_cameras:
            raise InvalidInput(
                f"`reward_cameras` is for rewards of frames alone; `{self.reward}` sees what the policy does, or none.",
                field="config.reward_cameras",
                hint="Leave it out.",
            )
        if self.encoder == OBJECT_ENCODER and (len(names) > 1 or self.frame_stack > 1 or self.gray):
            raise InvalidInput(
                f"An object encoder sees one RGB frame of one camera; got {self.frame_stack} of {len(names)}"
                f"{', gray' if self.gray else ''}.",
                field="config.encoder",
                hint="--set encoder=spatial",
            )
