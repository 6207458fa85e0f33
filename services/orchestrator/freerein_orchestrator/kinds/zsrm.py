"""Kind `zsrm`: from a goal in words to a policy, by a zero-shot reward model (chapter 4).

It is a pipeline: unlabelled images are recorded, a reward model is fitted to captions that the grounding model makes of
them, and a policy is trained by PPO on that reward alone. The policy is published: the imitation service serves it.

<folder>/parts/, artifacts/     as of a pipeline, whose steps are images, reward, policy
         artifacts/policy.*     the policy, as a run of kind `ppo` leaves it
         artifacts/result.json  the goal, the models, what the training's own reward says, and the supervision
"""

import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from freerein.atomic_files import write_atomic
from freerein.clients.tasks import find_camera, find_task
from freerein.config import bounded, parse
from freerein.criteria import CRITERIA, View
from freerein.criterion_text import stated_criterion
from freerein.errors import InvalidInput, NotFound, must_be, quoted
from freerein.goal_text import noun_phrases
from freerein.learning.actor_critic.object_encoder import OBJECT_ENCODER
from freerein.learning.actor_critic.policy_files import IN_DISTRIBUTION_FILE, NAMES
from freerein.types.common import check_name
from freerein.types.imitation import PublishPolicyRequest
from freerein.types.sim import Task
from freerein_orchestrator.kinds import ppo
from freerein_orchestrator.kinds.context import RunContext
from freerein_orchestrator.kinds.evaluate.record import RESULT
from freerein_orchestrator.kinds.fit import check_steps
from freerein_orchestrator.kinds.kind import Kind
from freerein_orchestrator.kinds.pipeline import Pipeline, make_step
from freerein_orchestrator.kinds.policy_store import PolicyStore
from freerein_orchestrator.kinds.ppo_config import PPORunConfig

_SCENES = ".scatter"
"""What the name of a world's task ends in that shows its things in many places."""

_REWARD: Mapping[str, Any] = {"steps": 1000}
_CRITERIA = "criterion_captions"
"""The method of reward models of goals that the five relations cannot say."""

_IMAGE_SIZE = 64
"""Height and width of what reward models see, in pixels."""

_PUSHING: Mapping[str, Any] = {"encoder": OBJECT_ENCODER, "carry_weight": 1.0, "episode_steps": 0}
"""Of trainings of policies that bring one thing close to another."""

_MORE_FRAMES = frozenset({"cameras", "frame_stack", "gray"})
"""Keys of trainings that see what an object encoder does not."""

_OWN = ("task", "goal_text", "reward", "reward_model")
"""Keys of the training that this kind sets."""


@dataclass(frozen=True)
class ZsrmRunConfig:
    """Configuration of a run of kind `zsrm`.

    Attributes:
        task: The task that the policy acts in.
        text: The goal in words, a relation or criterion of two or three things; empty for the task's own.
        phrases: Noun phrases of other things that images may show, beside those of the text.
        scenes: The task that the images are recorded in; empty for that of the same world whose name ends in
            `.scatter`, or where there is none `task` itself.
        count: Trajectories of images, with random actions.
        name: Name of the dataset, of the reward model and of the published policy; empty for the task's, with `-zsrm`.
        reward: Configuration of the reward model's fit. Its `method` is `criterion_captions` where the text is none of
            the five relations; by default one camera is then the front view, and that which the criterion is judged in.
        policy: Configuration of the training by PPO, but for `task`, `goal_text`, `reward` and `reward_model`. With
            `criterion_captions`, its encoder is `spatial` by default; where one thing is to be close to another and one
            frame of one camera is seen, it is `goal_eye`, with `carry_weight=1` and `episode_steps=0`.
        seed: Seed of every random draw.

    Raises:
        InvalidInput: A name is invalid, the text states nothing of two or three things, or `steps` of the fit's
            configuration is invalid, or the training's configuration is.
    """

    task: str
    text: str = ""
    phrases: tuple[str, ...] = ()
    scenes: str = ""
    count: int = bounded(1000, least=2, most=100_000)
    name: str = ""
    reward: dict[str, Any] = field(default_factory=dict)
    policy: dict[str, Any] = field(default_factory=dict)
    seed: int = bounded(0, least=0, most=2**31 - 1)

    def __post_init__(self) -> None:
        check_name(self.shared_name, field="config.name" if self.name else "config.task")
        check_steps(self.reward)
        if self.text:
            self.nouns(self.text)
        if own := sorted(set(self.policy).intersection(_OWN)):
            rule = f"without {', '.join(_OWN)}, which this kind sets"
            raise must_be("policy", rule, f"one with {', '.join(own)}", field="config.policy", hint="Leave them out.")
        if "phrases" in self.reward:
            rule = "without `phrases`, which this kind sets to those of the text and its own `phrases`"
            raise must_be("reward", rule, "one with them", field="config.reward", hint="--set 'phrases=[...]'")
        self.training(self.text)

    @property
    def shared_name(self) -> str:
        """Name of the dataset, of the reward model and of the published policy."""
        return self.name or f"{self.task}-zsrm"

    @property
    def fit(self) -> dict[str, Any]:
        """Configuration of the reward model's fit, with the defaults of this kind, but for those of its text."""
        return {**_REWARD, "seed": self.seed, **self.reward}

    def method(self, text: str) -> str:
        """Returns the method of the reward model of a text; empty for the reward service's default."""
        return str(self.reward.get("method", "" if noun_phrases((text,)) else _CRITERIA))

    def nouns(self, text: str) -> tuple[str, ...]:
        """Returns the noun phrases of a text that the reward model can learn.

        Raises:
            InvalidInput: It states no criterion, or, for a model of the five relations, none of these.
        """
        stated = stated_criterion(text) if self.method(text) == _CRITERIA else (None, noun_phrases((text,)))
        _, nouns = stated or (None, ())
        if not nouns:
            raise InvalidInput(
                f"The goal must state a relation or criterion of two or three things; got {quoted(text)}.",
                field="config.text",
                hint="For example: a yellow block to the left of a green block.",
            )
        return nouns

    def training(self, text: str) -> PPORunConfig:
        """Returns the training of a policy that does what a text says."""
        return parse(PPORunConfig, self.policy_config(text))

    def policy_config(self, text: str) -> dict[str, Any]:
        """Returns the configuration of the training of a policy that does what a text says."""
        own = {"task": self.task, "goal_text": text, "reward_model": self.shared_name}
        return {**self._policy_defaults(text), "seed": self.seed, **self.policy, **own}

    def _policy_defaults(self, text: str) -> Mapping[str, Any]:
        if not text or self.method(text) != _CRITERIA:
            return {}
        criterion, _ = stated_criterion(text) or (None, ())
        sees_one_frame = _MORE_FRAMES.isdisjoint(self.policy)
        return _PUSHING if criterion is CRITERIA["close_to"] and sees_one_frame else {"encoder": "spatial"}


def pipeline_steps(config: ZsrmRunConfig, task: Task, scenes: str) -> list[dict[str, Any]]:
    """Returns the steps of the pipeline, in order.

    Args:
        config: The run's.
        task: The task that the policy acts in.
        scenes: Name of the task that the images are recorded in.

    Raises:
        InvalidInput: The goal in words states nothing of two or three things, or the policy's object encoder does not
            see frames as large as the reward model does.
    """
    name, text = config.shared_name, config.text or task.goal_text
    nouns, training = config.nouns(text), config.training(text)
    cameras = training.reward_cameras or training.cameras or (training.camera,) * bool(training.camera)
    _check_frames(training, task)
    images: dict[str, Any] = {"behaviour": "random", "count": config.count, "seed": config.seed}
    images |= {side: size for side in ("height", "width") if (size := getattr(training, side))}
    if cameras:
        images["cameras"] = list(cameras)
    own: dict[str, Any] = {"cameras": list(cameras)} if len(cameras) > 1 else {}  # a fit's own default is the first
    if config.method(text) == _CRITERIA:
        own = {"method": _CRITERIA, **(own or _views(text, cameras[0] if cameras else task.cameras[0].name))}
    fit = {**own, **config.fit, "phrases": list(dict.fromkeys([*nouns, *config.phrases]))}
    return [
        make_step("images", "collect", task=scenes, dataset=name, **images),
        make_step("reward", "fit", service="reward", dataset=name, model_name=name, config=fit),
        make_step("policy", "ppo", **config.policy_config(text)),
    ]


def zsrm_kind(pipeline: Kind[Pipeline]) -> Kind[ZsrmRunConfig]:
    """Returns the kind `zsrm`, which is done by the kind `pipeline`."""

    def run(context: RunContext, config: ZsrmRunConfig) -> None:
        sim, retry = context.client("sim"), context.retry()
        task = retry.call(lambda: find_task(sim, config.task))
        scenes = config.scenes or retry.call(lambda: _scenes_of(context, task))
        pipeline.run(context, pipeline.parse({"steps": pipeline_steps(config, task, scenes)}))
        _publish(context, config)

    def named(values: Mapping[str, Any]) -> ZsrmRunConfig:
        config = parse(ZsrmRunConfig, values)
        return replace(config, name=config.shared_name)

    def steps(config: ZsrmRunConfig) -> int:
        return config.count + int(config.fit["steps"]) + config.training(config.text).iterations

    def check(config: ZsrmRunConfig, store: PolicyStore, earlier: Mapping[str, str]) -> None:
        ppo.check(config.training(config.text), store, earlier)

    def truth(config: Mapping[str, Any], store: PolicyStore) -> str:
        return ppo.truth(config["policy"], store)

    meaning = "Goes from a goal in words to a policy, by a zero-shot reward model."
    return Kind({"": ZsrmRunConfig}, named, steps=steps, run=run, check=check, truth=truth, meaning=meaning)


def _check_frames(training: PPORunConfig, task: Task) -> None:
    camera = find_camera(task, (*training.cameras, training.camera)[0])
    height, width = training.height or camera.height, training.width or camera.width
    if training.encoder == OBJECT_ENCODER and (height, width) != (_IMAGE_SIZE, _IMAGE_SIZE):
        raise InvalidInput(
            f"The encoder {OBJECT_ENCODER} must see frames as large as the reward model does, {_IMAGE_SIZE} x "
            f"{_IMAGE_SIZE}; those of the training are {height} x {width}.",
            field="config.policy",
            hint=f'policy={{"height": {_IMAGE_SIZE}, "width": {_IMAGE_SIZE}}}, or the encoder spatial.',
        )


def _scenes_of(context: RunContext, task: Task) -> str:
    """Returns the task of the same world that shows its things in many places, or the task itself."""
    try:
        return find_task(context.client("sim"), f"{task.world}{_SCENES}").name
    except NotFound:
        return task.name


def _views(text: str, camera: str) -> dict[str, Any]:
    """Returns the keys of a fit to one camera: it is the front view, and that of the text's criterion."""
    criterion, _ = stated_criterion(text) or (None, ())
    its = {View.FRONT} if criterion is None else {View.FRONT, criterion.view}
    return {"cameras": [camera], "views": [camera if each in its else "" for each in View]}


def _publish(context: RunContext, config: ZsrmRunConfig) -> None:
    """Leaves the policy as a run of kind `ppo` does, publishes it, and writes the result."""
    for name in (NAMES.weights, IN_DISTRIBUTION_FILE, NAMES.card):
        shutil.copyfile(context.artifacts / f"policy.{name}", context.artifacts / name)
    card = json.loads((context.artifacts / NAMES.card).read_bytes())
    imitation, run_id = context.client("imitation"), context.run_folder.name
    published = context.retry().call(
        partial(imitation.publish_policy, PublishPolicyRequest(run_id, config.shared_name))
    )
    context.record_model(published.model)
    document = {
        "task": card["task"],
        "goal_text": card["goal_text"],
        "models": {"reward": card["model"], "policy": vars(published.model)},
        "figures": card["figures"],
        "audit": "self-consistency only: the figures are of the reward that the policy was trained on",
        "supervision": card["supervision"],
        "privileged": card["privileged"],
    }
    write_atomic(context.artifacts / RESULT, json.dumps(document, indent=2).encode() + b"\n")
