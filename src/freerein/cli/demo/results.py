"""The artifacts of the demo's run: figures of evaluations, frames for pictures, seconds of steps."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import safetensors.numpy

from freerein import images
from freerein.cli.demo.pictures import FilmstripGoal, LabelledTrajectory, RewardExample
from freerein.cli.demo.pipeline import TASKS, TEXTS
from freerein.cli.demo.report import Measured
from freerein.clients import OrchestratorClient, RewardClient
from freerein.types.orchestrator import GetArtifactRequest, ListArtifactsRequest
from freerein.types.reward import GroundRequest

_TWO_BLOCKS, _FOUR_BLOCKS = (0, 1, 2, 4), (0, 4)
"""Places of the captions in their group whose scenes are in the picture of rewards."""


@dataclass(frozen=True)
class Results:
    """The artifacts of a pipeline, by name: `<step>.<name>`."""

    artifacts: Mapping[str, bytes]

    def json(self, name: str) -> Any:
        """Returns a JSON artifact."""
        return json.loads(self.artifacts[name])

    def frames(self, step: str) -> dict[str, npt.NDArray[np.uint8]]:
        """Returns the frames of an evaluation, uint8, by name."""
        return safetensors.numpy.load(self.artifacts[f"{step}.frames.safetensors"])

    def figure(self, step: str, name: str) -> Measured:
        """Returns a figure of an evaluation."""
        return Measured(**self.json(f"{step}.result.json")["figures"][name])

    def told(self) -> dict[tuple[str, str], Measured]:
        """Returns the mean returns of the language policy, by the sides of the task and of the text."""
        rows = self.json("sentences.result.json")["told"]
        tasks, texts = ({each: side for side, each in names.items()} for names in (TASKS, TEXTS))
        return {(tasks[row["task"]], texts[row["goal_text"]]): Measured(**row["return_mean"]) for row in rows}

    def seconds(self, step: str) -> float:
        """Returns the duration of a step."""
        return next(float(row["seconds"]) for row in self.json("steps.json") if row["name"] == step)


async def fetch(client: OrchestratorClient, run_id: str) -> Results:
    """Returns the results, frames and timings of a run."""
    listed = (await client.list_artifacts(ListArtifactsRequest(run_id))).artifacts
    wanted = ("steps.json", ".result.json", ".frames.json", ".frames.safetensors")
    names = [artifact.name for artifact in listed if artifact.name.endswith(wanted)]
    return Results({name: await _artifact(client, run_id, name) for name in names})


async def _artifact(client: OrchestratorClient, run_id: str, name: str) -> bytes:
    return b"".join([part.data async for part in client.get_artifact(GetArtifactRequest(run_id, name))])


def labelled_trajectory(results: Results, step: str) -> LabelledTrajectory:
    """Returns the demonstration of median accuracy of an evaluation of form `segmentation`."""
    (labelled,) = results.json(f"{step}.frames.json")
    return LabelledTrajectory(
        frames=results.frames(step)["trajectory"],
        truth=np.array(labelled["truth"], np.int64),
        labels=np.array(labelled["labels"], np.int64),
        confidence=np.array(labelled["confidence"], np.float32),
        skills=tuple(labelled["skills"]),
        accuracy=labelled["frame_accuracy"],
    )


def filmstrip(results: Results) -> tuple[FilmstripGoal, ...]:
    """Returns the landmarks that the robot of median success was done with."""
    frames = results.frames("landmarks")
    return tuple(
        FilmstripGoal(frames["goals"][one["landmark"]], end, one["step"], one["confidence"], one["at_landmark"])
        for one, end in zip(results.json("landmarks.frames.json"), frames["ends"], strict=True)
    )


async def reward_examples(results: Results, client: RewardClient) -> list[RewardExample]:
    """Returns the first scene of some captions, of two blocks and of four, with groundings to draw."""
    found = []
    for step, places in (("two-blocks", _TWO_BLOCKS), ("four-blocks", _FOUR_BLOCKS)):
        frames = results.frames(step)
        for scene in results.json(f"{step}.frames.json"):
            if scene["truth"] in places:
                found.append(await _example(client, frames[scene["frame"]], scene))
    return found


async def _example(client: RewardClient, frame: npt.NDArray[np.uint8], scene: Mapping[str, Any]) -> RewardExample:
    """Returns a scene of an evaluation of form `relations`, with the groundings of its noun phrases."""
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
