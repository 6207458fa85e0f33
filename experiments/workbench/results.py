"""The result of an arm: `results/EXPERIMENT/ARM.json`, whose long members are compressed.

They are `packed` in its own file when the arm has finished, or `archived` with those of others; see `pack`.
"""

import base64
import json
import lzma
import os
import platform
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt
import torch

from experiments.workbench import archive
from experiments.workbench.locks import locked_folder
from experiments.workbench.processor import processor
from freerein.atomic_files import write_atomic
from freerein.errors import FailedPrecondition
from freerein.learning.checkpoints import JSON

TABLE_FILE = "table.json"
"""Name of the file of claims, which lies beside the results."""

_PACKAGES = ("freerein", "numpy", "torch")
_LONG = ("config", "figures", "machine", "samples", "shown")
"""Members of a result that are compressed."""


@dataclass(frozen=True)
class Sample:
    """A figure of one network, measured over trials, as a ratio of sums.

    A trial is a trajectory or an episode. For frame accuracy, totals are the correct timesteps of each trajectory and
    counts its timesteps; for a mean return, counts are 1.

    Attributes:
        totals: Numerator of each trial.
        counts: Denominator of each trial; 0 where it has nothing to count.
    """

    totals: Sequence[float]
    counts: Sequence[float]

    @classmethod
    def of_flags(cls, flags: Iterable[npt.NDArray[np.bool_]]) -> Self:
        """Returns the share of flags that are true; a trial is an array of some, and one of none is left out."""
        present = [each for each in flags if len(each)]
        return cls([int(each.sum()) for each in present], [len(each) for each in present])

    @property
    def mean(self) -> float:
        """The figure."""
        return float(np.sum(self.totals) / np.sum(self.counts))


@dataclass(frozen=True)
class Outcome:
    """The measurements of an evaluation.

    Attributes:
        figures: Value by figure, such as `test.frame_accuracy`.
        samples: Figures that claims are made of, by trial.
        shown: What pictures show, such as the labels of a few trajectories.
    """

    figures: Mapping[str, float]
    samples: Mapping[str, Sample]
    shown: Mapping[str, JSON] = field(default_factory=dict)


@dataclass(frozen=True)
class ArmResult:
    """The result of a finished arm.

    Attributes:
        name: Name of the arm.
        world: As in `Arm`, like the next three.
        config: Everything that the result depends on, beside its name, the world and the code.
        world_version: Name and version of its world, such as `blocks-v1`.
        minutes: Wall-clock time of all attempts, without drawing the dataset.
        cpu_minutes: Their CPU time.
        machine: Processor, cores, system and package versions.
        command: The command that makes it.
        shown: As in `Outcome`.
    """

    name: str
    world: str
    method: str
    options: Mapping[str, str]
    seed: int
    config: Mapping[str, JSON]
    world_version: str
    figures: Mapping[str, float]
    samples: Mapping[str, Sample]
    minutes: float
    cpu_minutes: float
    machine: Mapping[str, JSON]
    command: str
    shown: Mapping[str, JSON] = field(default_factory=dict)


def save(result: ArmResult, folder: Path) -> None:
    """Writes `folder / <name>.json`."""
    short, long = _split(result)
    packed = base64.b85encode(archive.compress(archive.to_json(long))).decode()
    folder.mkdir(parents=True, exist_ok=True)
    with locked_folder(folder):
        _write({**short, "packed": packed}, folder)


def pack(folder: Path) -> None:
    """Moves the long members of all results in a folder to one archive, where they take half the room or less.

    Raises:
        FailedPrecondition: A file is no result.
    """
    if not folder.is_dir():
        return
    with locked_folder(folder):
        split = [_split(result) for result in load_all(folder)]
        if split:
            written, digests = archive.write(folder, [long for _, long in split])
            for (short, _), digest in zip(split, digests, strict=True):
                _write({**short, "archived": digest}, folder)
            archive.keep_only(written)


def load_all(folder: Path, pattern: str = "*") -> list[ArmResult]:
    """Returns the results in a folder whose names match a shell pattern, by name.

    Raises:
        FailedPrecondition: A file is no result.
    """
    return [load(path) for path in sorted(folder.glob(f"{pattern}.json")) if path.name != TABLE_FILE]


def load(path: Path) -> ArmResult:
    """Returns the result in a file. Raises FailedPrecondition when it is not one."""
    try:
        short: dict[str, Any] = json.loads(path.read_bytes())
        if "archived" in short:
            long = archive.read(path.parent, short.pop("archived"))
        else:
            long = json.loads(lzma.decompress(base64.b85decode(short.pop("packed"))))
        samples = {name: Sample(**each) for name, each in long["samples"].items()}
        return ArmResult(**{**short, **long, "samples": samples})
    except (OSError, ValueError, KeyError, TypeError, AttributeError, lzma.LZMAError) as error:
        raise FailedPrecondition(
            f"The result of an arm must be JSON with its fields, and archived members beside it; {path.name} is not.",
            hint="Restore the file and the archives of its folder, or delete the file and run the arm again.",
        ) from error


def _split(result: ArmResult) -> tuple[dict[str, Any], dict[str, Any]]:
    """Returns the short members of a result, and the long ones."""
    members = asdict(result)
    long = {name: members.pop(name) for name in _LONG}
    return members, long


def _write(document: Mapping[str, Any], folder: Path) -> None:
    text = json.dumps(document, indent=1, allow_nan=False)
    write_atomic(folder / f"{document['name']}.json", f"{text}\n".encode())


def machine() -> dict[str, JSON]:
    """Returns the processor, its cores, the CUDA device if any, the system, and the versions that results depend on."""
    return {
        "processor": processor(),
        "cores": os.cpu_count(),
        **({"cuda": torch.cuda.get_device_name()} if torch.cuda.is_available() else {}),
        "system": platform.platform(),
        "python": platform.python_version(),
        **{name: version(name) for name in _PACKAGES},
    }
