"""Form `segmentation`: a segmentation model labels fresh demonstrations, whose true labels the sim service knows."""

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from typing import Any, Literal, cast

import numpy as np
import numpy.typing as npt

from freerein.config import bounded
from freerein.errors import InvalidInput, Unavailable
from freerein.metrics import frame_accuracy, majority_accuracy
from freerein.types.common import ModelRef
from freerein.types.segmentation import (
    NO_SKILL,
    ListSkillsRequest,
    SegmentRequest,
)
from freerein.types.sim import DemonstrateRequest, DemonstrateResponse
from freerein_orchestrator.kinds.evaluate.form import (
    Form,
    FormConfig,
    Frames,
    Result,
    Setup,
    Trial,
    enlarged,
    ratio_figure,
)


@dataclass(frozen=True, kw_only=True)
class SegmentationConfig(FormConfig):
    """Configuration of the form `segmentation`.

    Attributes:
        form: The form.
        model: Name of the segmentation model; empty for the service's default.
        version: Its version; empty for the active one.
        smoothing: Standard deviation of the temporal Gaussian filter, in timesteps; 0 for none.
        min_segment: Shortest segment in timesteps; shorter ones are merged into a neighbour. 0 and 1 keep all.
        min_confidence: Least confidence that is kept, before short segments are rejected; 0 keeps all.
        min_kept: Shortest segment in timesteps that is kept, after merging; 0 and 1 keep all. With rejection, the share
            of timesteps that is kept and the accuracy of those are figures, too.
        min_skills: Fewest different skills per demonstration; 0 means the fewest of a recipe of the task.
        max_skills: Most different skills per demonstration; 0 means the most of a recipe of the task.
    """

    form: Literal["segmentation"] = "segmentation"
    model: str = ""
    version: str = ""
    smoothing: float = bounded(0.0, least=0.0, most=100.0)
    min_segment: int = bounded(0, least=0, most=1000)
    min_confidence: float = bounded(0.0, least=0.0, most=1.0)
    min_kept: int = bounded(0, least=0, most=1000)
    min_skills: int = bounded(0, least=0, most=1000)
    max_skills: int = bounded(0, least=0, most=1000)


class SegmentationEvaluation:
    """Has demonstrations of the expert labelled.

    Attributes:
        subject: The model.
    """

    def __init__(self, setup: Setup[SegmentationConfig]) -> None:
        config, task = setup.config, setup.task
        if not (task.has_expert and task.skills):
            raise InvalidInput(
                f"The form segmentation needs a task with an expert and skills; {task.name} lacks them.",
                field="config.task",
                hint="Choose another task, or another form.",
            )
        self._setup = setup
        self._service = setup.context.client("segmentation")
        asked = setup.subject.get("model", {"name": config.model, "version": config.version})
        self._model = self._service.list_skills(ListSkillsRequest(ModelRef(**asked)))
        known = [task.skills.index(skill) if skill in task.skills else NO_SKILL for skill in self._model.skills]
        self._labels = np.array([*known, NO_SKILL])  # of the task, by the model's labels; the last is of NO_SKILL
        self._camera = next((each for each in task.cameras if each.name == self._model.camera), task.cameras[0])
        self.subject: dict[str, Any] = {"model": asdict(self._model.model)}

    def run_round(self, first: int, count: int) -> Sequence[Trial]:
        """Returns trials `first` to `first + count`."""
        size = {"height": self._model.height, "width": self._model.width}
        trials = [self._trial(each) for each in self._demonstrations(first, count, **size)]
        if len(trials) < count:
            raise Unavailable(
                "The stream of demonstrations must be whole; it ended early.", hint="The round is run again."
            )
        return trials

    def _demonstrations(self, first: int, count: int, *, height: int, width: int) -> Iterator[DemonstrateResponse]:
        config = self._setup.config
        request = DemonstrateRequest(
            config.task,
            "expert",
            min_skills=config.min_skills,
            max_skills=config.max_skills,
            count=first + count,
            seed=config.seed,
            first=first,
            height=height,
            width=width,
            privileged=True,
            cameras=(self._camera.name,),
            conditions=config.conditions,
        )
        with closing(self._setup.sim.demonstrate(request)) as demonstrations:
            for demonstration in demonstrations:
                self._setup.interrupt()
                yield demonstration

    def _trial(self, demonstration: DemonstrateResponse) -> Trial:
        trajectory, truth = demonstration.trajectory, demonstration.labels
        (frames,) = trajectory.frames.values()
        request = SegmentRequest(
            self._model.model,
            frames,
            actions=trajectory.actions if self._model.action_size else None,
            smoothing=self._setup.config.smoothing,
            min_segment=self._setup.config.min_segment,
            min_kept=self._setup.config.min_kept,
            min_confidence=self._setup.config.min_confidence,
        )
        answer = self._service.segment(request)
        labels = self._labels[answer.labels]
        values = {
            "truth": truth.tolist(),
            "labels": labels.tolist(),
            "confidence": answer.confidence.tolist(),
            "frame_accuracy": frame_accuracy(labels, truth),
            "kept": int((answer.labels != NO_SKILL).sum()),
        }
        return Trial(values)

    def result(self, trials: Sequence[Trial]) -> Result:
        """Returns figures over all timesteps, and the trajectory of median accuracy as a picture."""
        values, skills, seed = [trial.values for trial in trials], self._setup.task.skills, self._setup.config.seed
        correct, timesteps = (
            np.array(rows) for rows in zip(*(_counts(each, len(skills)) for each in values), strict=True)
        )
        lengths = timesteps.sum(axis=1, keepdims=True)
        majority = [majority_accuracy(np.array(each["truth"])) for each in values]
        baseline = float(np.average(majority, weights=lengths[:, 0]))
        occurring = int((timesteps.sum(axis=0) > 0).sum())
        median = sorted(range(len(values)), key=lambda index: cast(float, values[index]["frame_accuracy"]))[
            len(values) // 2
        ]
        names = ("truth", "labels", "confidence", "frame_accuracy")
        right, kept = correct.sum(axis=1, keepdims=True), np.array([[each["kept"]] for each in values])
        figures = {
            "frame_accuracy": ratio_figure(right, lengths, seed=seed, baseline=baseline),
            "balanced_accuracy": ratio_figure(correct, timesteps, seed=seed, baseline=1 / occurring),
        }
        if self._setup.config.min_kept or self._setup.config.min_confidence:
            figures["kept"] = ratio_figure(kept, lengths, seed=seed)
            if kept.any():
                figures["kept_accuracy"] = ratio_figure(right, kept, seed=seed)
        return Result(
            figures,
            {"demonstrations": len(values), "timesteps": int(lengths.sum())},
            pictures=[{"skills": list(skills), **{name: values[median][name] for name in names}}],
            frames={"trajectory": self._frames(median)},
        )

    def _frames(self, index: int) -> Frames:
        """Returns the frames of a demonstration, uint8 (T, H, W, C), recorded again, as large as in films."""

        def recorded(height: int, width: int) -> Frames:
            (demonstration,) = self._demonstrations(index, 1, height=height, width=width)
            (frames,) = demonstration.trajectory.frames.values()
            return frames

        return enlarged(self._camera, (self._model.height, self._model.width), recorded)


def _counts(values: dict[str, Any], skills: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Returns how many timesteps of each skill were labelled right, and how many there are: int64 (skills,) each."""
    truth, labels = np.array(values["truth"]), np.array(values["labels"])
    return np.bincount(truth[labels == truth], minlength=skills), np.bincount(truth, minlength=skills)


FORM = Form(SegmentationConfig, SegmentationEvaluation)
