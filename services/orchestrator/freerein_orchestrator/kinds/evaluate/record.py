"""The trials of an evaluation so far, on disk, and its result.

<folder>/checkpoints/rounds.jsonl              a line per round: its trials, and what is evaluated
         checkpoints/frames/<i>.safetensors    what pictures may show of trial i; of one name only the first trial's
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
from freerein.jobs import json_lines
from freerein.learning import tensor_files
from freerein_orchestrator.kinds.context import RunContext
from freerein_orchestrator.kinds.evaluate.form import Figure, Frames, Result, Trial
from freerein_orchestrator.kinds.metrics_logger import last_step

RESULT, PICTURES, FRAMES = "result.json", "frames.json", "frames.safetensors"


class TrialRecord:
    """The trials of an evaluation.

    Args:
        context: The run's.
        episodes: Number of trials in all.

    Attributes:
        subject: The evaluated policy or model; empty before the first round.
    """

    def __init__(self, context: RunContext, episodes: int) -> None:
        self._folder = context.folder / "checkpoints"
        self._artifacts = context.artifacts
        self._episodes = episodes
        self.subject: dict[str, Any] = {}
        self._values: list[dict[str, Any]] = []
        self._kept: dict[str, int] = {}  # first trial with frames of a name, by name
        for line in self._whole_lines():
            self._take(json.loads(line))
        logged = max(0, last_step(context.run_folder, prefix=context.prefix) - context.first_step)
        logged = min(logged, self.count, episodes - 1)
        self._metrics = context.metrics_logger(logged, group="eval")
        self._log(logged)

    @property
    def count(self) -> int:
        """Number of trials."""
        return len(self._values)

    def trials(self) -> list[Trial]:
        """Returns the trials in order, with the frames that were kept."""
        found = [Trial(values) for values in self._values]
        for index in set(self._kept.values()):
            tensors = tensor_files.parse(self._frames_path(index).read_bytes())
            found[index].shown.update({name: tensor.numpy() for name, tensor in tensors.items()})
        return found

    def add(self, subject: dict[str, Any], trials: Sequence[Trial]) -> None:
        """Adds a round of trials, durably."""
        first, kept = self.count, set(self._kept)
        names = []
        for index, trial in enumerate(trials, first):
            new = {name: each for name, each in trial.shown.items() if name not in kept}
            if new:
                _write_frames(self._frames_path(index), new)
            kept |= set(new)
            names.append(sorted(new))
        document = {"subject": subject, "trials": [trial.values for trial in trials], "shown": names}
        self._folder.mkdir(parents=True, exist_ok=True)
        json_lines.append(self._path, lambda _last: [document])
        self._take(document)
        self._log(first)

    def _take(self, document: Mapping[str, Any]) -> None:
        """Takes a round from its line."""
        for index, names in enumerate(document["shown"], self.count):
            self._kept.update(dict.fromkeys(names, index))
        self.subject = document["subject"]
        self._values += document["trials"]

    @property
    def _path(self) -> Path:
        return self._folder / "rounds.jsonl"

    def _whole_lines(self) -> list[bytes]:
        return self._path.read_bytes().rpartition(b"\n")[0].splitlines() if self._path.is_file() else []

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
        self._metrics.append(self._episodes, _numbers(self._values[-1]) | _rows(result.figures))

    def _log(self, first: int) -> None:
        """Logs trials, all but the last one: its row holds the figures, too."""
        for index, values in enumerate(self._values[first:], first + 1):
            if index < self._episodes:
                self._metrics.append(index, _numbers(values))

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
