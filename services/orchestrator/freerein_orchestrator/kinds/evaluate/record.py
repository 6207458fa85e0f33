"""The trials of an evaluation so far, on disk, and its result.

<folder>/checkpoints/trials.json               the trials so far, and what is evaluated
         checkpoints/frames/<i>.safetensors    what pictures may show of trial i
         artifacts/result.json                 figures, counts, versions of models
         artifacts/frames.json                 what the pictures show, and
         artifacts/frames.safetensors          their frames, uint8; only of forms that have pictures
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from freerein.atomic_files import write_atomic
from freerein.learning import tensor_files
from freerein_orchestrator.kinds.context import RunContext
from freerein_orchestrator.kinds.evaluate.form import Figure, Frames, Result, Trial

RESULT, PICTURES, FRAMES = "result.json", "frames.json", "frames.safetensors"


class TrialRecord:
    """The trials of an evaluation.

    Args:
        context: The run's.
        episodes: Number of trials in all.

    Attributes:
        subject: What is evaluated; empty before the first round.
        trials: In order.
    """

    def __init__(self, context: RunContext, episodes: int) -> None:
        self._folder = context.folder / "checkpoints"
        self._artifacts = context.artifacts
        self._episodes = episodes
        self._metrics = context.metrics_logger(0)
        path = self._folder / "trials.json"
        saved = json.loads(path.read_bytes()) if path.is_file() else {"subject": {}, "trials": []}
        self.subject: dict[str, Any] = saved["subject"]
        self.trials = [Trial(values, self._load_frames(index)) for index, values in enumerate(saved["trials"])]
        self._log(0)

    def add(self, subject: dict[str, Any], trials: Sequence[Trial]) -> None:
        """Adds a round of trials, durably."""
        first = len(self.trials)
        self.subject = subject
        self.trials += trials
        for index, trial in enumerate(trials, first):
            if trial.frames:
                _write_frames(self._frames_path(index), trial.frames)
        document = {"subject": subject, "trials": [trial.values for trial in self.trials]}
        write_atomic(self._folder / "trials.json", json.dumps(document).encode())
        self._log(first)

    def write_result(self, result: Result, header: Mapping[str, Any]) -> None:
        """Writes the result, and its figures as the last row of metrics."""
        if result.frames:
            _write_frames(self._artifacts / FRAMES, result.frames)
            write_atomic(self._artifacts / PICTURES, json.dumps(result.pictures, indent=2).encode() + b"\n")
        document = {
            **header,
            **self.subject,
            "figures": {name: asdict(figure) for name, figure in result.figures.items()},
            "counts": result.counts,
            **result.details,
        }
        write_atomic(self._artifacts / RESULT, json.dumps(document, indent=2).encode() + b"\n")
        self._metrics.append(self._episodes, _numbers(self.trials[-1].values) | _rows(result.figures))

    def _log(self, first: int) -> None:
        """Logs trials, all but the last one: its row holds the figures, too."""
        for index, trial in enumerate(self.trials[first:], first + 1):
            if index < self._episodes:
                self._metrics.append(index, _numbers(trial.values))

    def _load_frames(self, index: int) -> dict[str, Frames]:
        path = self._frames_path(index)
        tensors = tensor_files.parse(path.read_bytes()) if path.is_file() else {}
        return {name: tensor.numpy() for name, tensor in tensors.items()}

    def _frames_path(self, index: int) -> Path:
        return self._folder / "frames" / f"{index}.safetensors"


def _write_frames(path: Path, frames: Mapping[str, Frames]) -> None:
    write_atomic(path, tensor_files.dump({name: torch.from_numpy(each.copy()) for name, each in frames.items()}))


def _numbers(values: Mapping[str, Any]) -> dict[str, float]:
    return {name: float(value) for name, value in values.items() if isinstance(value, bool | int | float)}


def _rows(figures: Mapping[str, Figure]) -> dict[str, float]:
    """Returns figures as metrics: each value, and the ends of its interval where there is one."""
    found = {}
    for name, figure in figures.items():
        ends = {name: figure.value, f"{name}.low": figure.low, f"{name}.high": figure.high}
        found.update({key: value for key, value in ends.items() if value is not None})
    return found
