"""Form `relations`: a reward model chooses among captions of which one is true.

The captions are the texts of the task's predicates, by group; a group counts in the scenes in which one of its
predicates holds. Scenes are the first and the last frames of short random rollouts.
"""

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import chain
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from freerein.clients.tasks import find_camera
from freerein.config import bounded
from freerein.errors import FailedPrecondition, InvalidInput
from freerein.types.common import ModelRef
from freerein.types.reward import EmbedGoalRequest, RewardRequest
from freerein.types.sim import Predicate, Task
from freerein_orchestrator.envs.episodes import Episode, run_episodes
from freerein_orchestrator.envs.random_policies import exploration_policy
from freerein_orchestrator.envs.truth import truth_session
from freerein_orchestrator.kinds.evaluate.form import Form, FormConfig, Frames, Result, Setup, Trial, ratio_figure

_SCENES = 2  # per rollout: its first and its last frame


@dataclass(frozen=True, kw_only=True)
class RelationsConfig(FormConfig):
    """Configuration of the form `relations`. Every episode gives two scenes.

    Attributes:
        form: The form.
        model: Name of the reward model; empty for the service's default.
        version: Its version; empty for the active one.
        camera: The camera of the scenes; empty for the task's first.
        steps: Random actions between the first and the last frame.
    """

    form: Literal["relations"] = "relations"
    model: str = ""
    version: str = ""
    camera: str = ""
    steps: int = bounded(4, least=1, most=1000)


class RelationsEvaluation:
    """Asks the reward model which caption of each group fits a scene best.

    Attributes:
        subject: The model.
    """

    def __init__(self, setup: Setup[RelationsConfig]) -> None:
        config, task = setup.config, setup.task
        self._setup = setup
        self._groups = caption_groups(task)
        self._camera = find_camera(task, config.camera).name
        self._reward = setup.context.client("reward")
        asked = setup.subject.get("model", {"name": config.model, "version": config.version})
        self._model = self._knowing(ModelRef(**asked))
        self.subject: dict[str, Any] = {"model": asdict(self._model)}

    def run_round(self, first: int, count: int) -> Sequence[Trial]:
        """Returns trials `first` to `first + count`."""
        setup = self._setup
        episodes = run_episodes(
            setup.sim,
            setup.session(count, first),
            exploration_policy(setup.task.action),
            setup.interrupt,
            cameras=(self._camera,),
            max_steps=setup.config.steps,
        )
        frames = np.concatenate([each.frames[self._camera][[0, -1]] for each in episodes])  # (2 * count, H, W, C)
        answers: list[list[dict[str, Any]]] = [[] for _ in frames]
        for group, truth in self._true_captions(episodes).items():
            scenes = np.flatnonzero(truth >= 0)
            if not len(scenes):
                continue
            winners = self._winners(group, frames[scenes])
            for scene, winner in zip(scenes.tolist(), winners.tolist(), strict=True):
                answers[scene].append({"group": group, "truth": int(truth[scene]), "winner": winner})
        return [_trial(answers[at : at + _SCENES], frames[at : at + _SCENES]) for at in range(0, len(frames), _SCENES)]

    def _knowing(self, model: ModelRef) -> ModelRef:
        """Returns the version that answers for a model; it knows every word of the captions.

        Raises:
            FailedPrecondition: It does not; a caption with an unknown word would win against no other.
        """
        for predicate in chain.from_iterable(self._groups.values()):
            answer = self._reward.embed_goal(EmbedGoalRequest(predicate.text, model))
            model = answer.model
            if answer.unknown:
                raise FailedPrecondition(
                    f"The reward model must know every word of the task's captions; it does not know "
                    f"{', '.join(answer.unknown)}.",
                    field="config.model",
                    hint="Fit a reward model to the noun phrases of this task, and name it.",
                )
        return model

    def _true_captions(self, episodes: Sequence[Episode]) -> dict[str, npt.NDArray[np.int64]]:
        """Returns by group the true caption of each scene: int64 (M,), an index into the group, or -1 for none."""
        states = [state[None] for each in episodes for state in each.states[[0, -1]]]  # M of (1, S)
        found = {}
        with truth_session(self._setup.sim, self._setup.task.name) as truth:
            for group, predicates in self._groups.items():
                self._setup.interrupt()
                holds = np.stack([np.concatenate(truth.holds(each.name, states)) for each in predicates])  # (P, M)
                found[group] = np.where(holds.sum(axis=0) == 1, holds.argmax(axis=0), -1)
        return found

    def _winners(self, group: str, frames: Frames) -> npt.NDArray[np.int64]:
        """Returns the caption that fits each frame best: int64 (M,), indices into the group."""
        goal, *rivals = [each.text for each in self._groups[group]]
        request = RewardRequest(goal, {self._camera: frames}, rivals=tuple(rivals), model=self._model)
        return self._reward.reward(request).winners

    def _similarities(self, texts: Sequence[str], frame: Frames) -> list[float]:
        """Returns the similarity of a frame, uint8 (H, W, C), and each text."""
        frames = {self._camera: frame[None]}
        requests = [RewardRequest(text, frames, mode="raw", model=self._model) for text in texts]
        return [float(self._reward.reward(each).similarities[0]) for each in requests]

    def result(self, trials: Sequence[Trial]) -> Result:
        """Returns the figures of all trials."""
        answers = [[each for scene in trial.values["scenes"] for each in scene] for trial in trials]
        if not any(answers):
            raise InvalidInput(
                f"The captions of a group must be true in some scenes of {self._setup.task.name}; none was.",
                field="config.task",
                hint="Take more episodes, or choose another task.",
            )
        classes = max(map(len, self._groups.values()))
        correct, asked = np.zeros((2, len(trials), classes))
        for trial, each in enumerate(answers):
            np.add.at(asked[trial], [answer["truth"] for answer in each], 1)
            np.add.at(correct[trial], [answer["truth"] for answer in each if answer["truth"] == answer["winner"]], 1)
        truths, seed = np.array([one["truth"] for each in answers for one in each]), self._setup.config.seed
        accuracy = ratio_figure(
            correct.sum(axis=1, keepdims=True),
            asked.sum(axis=1, keepdims=True),
            seed=seed,
            baseline=_majority_accuracy(chain.from_iterable(answers)),
        )
        balanced = ratio_figure(correct, asked, seed=seed, baseline=1 / len(np.unique(truths)))
        pictures, frames = self._pictures(trials)
        return Result(
            {"accuracy": accuracy, "balanced_accuracy": balanced},
            {"scenes": _SCENES * len(trials), "answers": len(truths)},
            pictures=pictures,
            frames=frames,
        )

    def _pictures(self, trials: Sequence[Trial]) -> tuple[list[dict[str, Any]], dict[str, Frames]]:
        """Returns for each place in a group the first scene in which the caption at that place is true."""
        pictures: dict[int, dict[str, Any]] = {}
        frames: dict[str, Frames] = {}
        for trial in trials:
            for answer in (each for scene in trial.values["scenes"] for each in scene):
                truth, name = answer["truth"], str(answer["truth"])
                if truth not in pictures:
                    texts = [each.text for each in self._groups[answer["group"]]]
                    frames[name] = trial.shown[name]
                    similarities = self._similarities(texts, trial.shown[name])
                    pictures[truth] = {"frame": name, "texts": texts, "similarities": similarities, "truth": truth}
        return [pictures[truth] for truth in sorted(pictures)], frames


def _majority_accuracy(answers: Iterable[Mapping[str, Any]]) -> float:
    """Returns the accuracy of always choosing the caption of each group that is true most often."""
    counts: dict[str, Counter[int]] = defaultdict(Counter)
    for each in answers:
        counts[each["group"]][each["truth"]] += 1
    return sum(max(count.values()) for count in counts.values()) / sum(count.total() for count in counts.values())


def caption_groups(task: Task) -> dict[str, list[Predicate]]:
    """Returns the predicates with captions of a task, by group.

    Raises:
        InvalidInput: The task has none.
    """
    groups: dict[str, list[Predicate]] = {}
    for predicate in task.predicates:
        if predicate.group and predicate.text:
            groups.setdefault(predicate.group, []).append(predicate)
    if not groups:
        raise InvalidInput(
            f"An evaluation of the form relations needs groups of predicates with captions; {task.name} offers none.",
            field="config.task",
            hint="Choose a task of a world that offers them, or another form.",
        )
    return groups


def _trial(scenes: Sequence[Sequence[Mapping[str, Any]]], frames: Frames) -> Trial:
    answers = [each for scene in scenes for each in scene]
    values: dict[str, Any] = {"scenes": [list(scene) for scene in scenes]}
    if answers:
        values["accuracy"] = float(np.mean([each["truth"] == each["winner"] for each in answers]))
    shown: dict[str, Frames] = {}  # by the place of the true caption in its group
    for scene, frame in zip(scenes, frames, strict=True):
        for answer in scene:
            shown.setdefault(str(answer["truth"]), frame)
    return Trial(values, shown)


FORM = Form(RelationsConfig, RelationsEvaluation)
