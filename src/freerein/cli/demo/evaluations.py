"""The artifacts of a run of kind `evaluate`: its figures, and what its pictures show."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import numpy.typing as npt
import safetensors.numpy

from freerein import images
from freerein.cli.demo.pictures import FilmstripGoal, LabelledTrajectory, RewardExample
from freerein.clients import RewardClient
from freerein.types.reward import GroundRequest


@dataclass(frozen=True)
class Measured:
    """A figure of an evaluation.

    Attributes:
        value: The value.
        low: Lower end of its 95 % interval; None where there is none.
        high: Upper end, likewise.
        baseline: Value of the trivial answer; None where there is none.
    """

    value: float
    low: float | None
    high: float | None
    baseline: float | None

    @property
    def interval(self) -> tuple[float, float] | None:
        """Its 95 % interval; None where there is none."""
        return None if self.low is None or self.high is None else (self.low, self.high)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The figures of an evaluation.

    Attributes:
        result: `result.json`.
        shown: `frames.json`, what its pictures show; empty without.
        frames: uint8 arrays of `frames.safetensors` by name; empty without.
    """

    result: Mapping[str, Any]
    shown: Sequence[Mapping[str, Any]]
    frames: Mapping[str, npt.NDArray[np.uint8]]

    @classmethod
    def read(cls, artifacts: Mapping[str, bytes], prefix: str = "") -> Self:
        """Returns the evaluation whose artifacts have names that begin with a prefix, such as `<step>.`."""
        shown, frames = (artifacts.get(f"{prefix}frames.{suffix}") for suffix in ("json", "safetensors"))
        return cls(
            json.loads(artifacts[f"{prefix}result.json"]),
            json.loads(shown) if shown else (),
            safetensors.numpy.load(frames) if frames else {},
        )

    def figure(self, name: str) -> Measured:
        """Returns a figure."""
        return Measured(**self.result["figures"][name])


def labelled_trajectory(evaluation: Evaluation) -> LabelledTrajectory:
    """Returns the demonstration of median accuracy of an evaluation of form `segmentation`."""
    (labelled,) = evaluation.shown
    return LabelledTrajectory(
        frames=evaluation.frames["trajectory"],
        truth=np.array(labelled["truth"], np.int64),
        labels=np.array(labelled["labels"], np.int64),
        confidence=np.array(labelled["confidence"], np.float32),
        skills=tuple(labelled["skills"]),
        accuracy=labelled["frame_accuracy"],
    )


def filmstrip(evaluation: Evaluation) -> tuple[FilmstripGoal, ...]:
    """Returns the landmarks that the robot of median success was done with, of an evaluation of form `landmarks`."""
    return _pursued(evaluation.shown, evaluation.frames["goals"], evaluation.frames["ends"])


def filmstrip_failure(evaluation: Evaluation) -> tuple[FilmstripGoal, ...]:
    """Returns those of the robot of least success; none where it is the median one, or the evaluation kept none."""
    if "worst_ends" not in evaluation.frames:
        return ()
    frames = evaluation.frames
    return _pursued(evaluation.result["worst_pursuits"], frames["worst_goals"], frames["worst_ends"])


def _pursued(
    pursuits: Sequence[Mapping[str, Any]], goals: npt.NDArray[np.uint8], ends: npt.NDArray[np.uint8]
) -> tuple[FilmstripGoal, ...]:
    return tuple(
        FilmstripGoal(goals[one["landmark"]], end, one["step"], one["confidence"], one["at_landmark"])
        for one, end in zip(pursuits, ends, strict=True)
    )


async def reward_examples(
    evaluation: Evaluation, client: RewardClient, *, captions: Sequence[int]
) -> list[RewardExample]:
    """Returns the first scene of each caption, by its place in its group, of an evaluation of form `relations`."""
    scenes = {scene["truth"]: scene for scene in evaluation.shown}
    found = [scenes[caption] for caption in captions if caption in scenes]
    return [await _example(client, evaluation.frames[scene["frame"]], scene) for scene in found]


async def _example(client: RewardClient, frame: npt.NDArray[np.uint8], scene: Mapping[str, Any]) -> RewardExample:
    """Returns a scene with the groundings of its noun phrases."""
    phrases = noun_phrases(scene["texts"])
    grounded = await client.ground(GroundRequest(images.encode(frame, encoding="raw_rgb8"), phrases))
    return RewardExample(
        image=frame,
        phrases=phrases,
        heatmaps=[each.heatmap for each in grounded.groundings],
        pixels=[(each.x, each.y) for each in grounded.groundings],
        texts=scene["texts"],
        similarities=np.array(scene["similarities"], np.float32),
        truth=scene["truth"],
    )


def noun_phrases(captions: Sequence[str]) -> tuple[str, str]:
    """Returns the words that all captions of one pair of objects begin with, and those that all end with."""
    words = [caption.split() for caption in captions]
    return " ".join(_common_start(words)), " ".join(reversed(_common_start([each[::-1] for each in words])))


def _common_start(sequences: Sequence[Sequence[str]]) -> list[str]:
    shared = []
    for words in zip(*sequences, strict=False):
        if len(set(words)) > 1:
            break
        shared.append(words[0])
    return shared
