"""Requests and responses of the orchestrator."""

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from freerein.types.common import ActionSpec, Camera, Image, ModelRef
from freerein.types.jobs import Job, JobMetrics, JobMetricsRequest, JobRequest, ListJobsRequest, WatchJobRequest


@dataclass(frozen=True, kw_only=True)
class Run(Job):
    """One run.

    Attributes:
        model: Published to a service; None until a run that makes one has succeeded.
        truth: The privileged data that it reads, such as true rewards, and their purpose; empty for none.
    """

    kind: str
    model: ModelRef | None = None
    truth: str = ""


@dataclass(frozen=True)
class StartRunRequest:
    """Requests a run.

    Attributes:
        kind: Kind of the run.
        config: Configuration of the kind; missing keys have their defaults.
        idempotency_key: The same key and request returns the run already started; empty for none.
    """

    kind: str
    config: dict[str, Any] = field(default_factory=dict)
    idempotency_key: str = ""


@dataclass(frozen=True)
class GetRunResponse:
    """One run."""

    run: Run


class StartRunResponse(GetRunResponse):
    """The queued run."""


class GetRunRequest(JobRequest):
    """Requests one run by its id."""


class ListRunsRequest(ListJobsRequest):
    """Requests one page of the runs."""


@dataclass(frozen=True)
class ListRunsResponse:
    """One page of the runs, newest first; `next_page_token` is empty on the last page."""

    runs: tuple[Run, ...]
    next_page_token: str = ""


class WatchRunRequest(WatchJobRequest):
    """Requests the events of one run."""


@dataclass(frozen=True)
class WatchRunResponse:
    """One event of a run: its sequence number, from 0 without gaps, and the run after it."""

    sequence: int
    run: Run


class GetMetricsRequest(JobMetricsRequest):
    """Requests the metrics of one run."""


class GetMetricsResponse(JobMetrics):
    """Metrics of one run."""


class CancelRunRequest(JobRequest):
    """Requests to cancel one run by its id."""


class CancelRunResponse(GetRunResponse):
    """The run, cancelled or ended before."""


class ResumeRunRequest(JobRequest):
    """Requests to resume one run by its id."""


class ResumeRunResponse(GetRunResponse):
    """The run, queued again."""


class DeleteRunRequest(JobRequest):
    """Requests to delete one run by its id."""


@dataclass(frozen=True)
class DeleteRunResponse:
    """The run is deleted."""


@dataclass(frozen=True)
class Artifact:
    """A file that a run has written; `size` in bytes, `time_ns` the Unix time in nanoseconds of its last change."""

    name: str
    size: int
    time_ns: int = 0


class ListArtifactsRequest(JobRequest):
    """Requests the artifacts of one run by its id."""


@dataclass(frozen=True)
class ListArtifactsResponse:
    """The artifacts, by name."""

    artifacts: tuple[Artifact, ...]


@dataclass(frozen=True)
class GetArtifactRequest(JobRequest):
    """Requests one artifact of one run by its name."""

    name: str


@dataclass(frozen=True)
class GetArtifactResponse:
    """One part of an artifact, in order."""

    data: bytes


@dataclass(frozen=True)
class Dataset:
    """One dataset of the data directory; where it cannot be opened, only `name` and `error` are set.

    Attributes:
        goal_text: Goal text of trajectories without one of their own.
        fps: Timesteps per second.
        action: Of size 0 where timesteps have no actions.
        tags: Number of trajectories in which a skill occurs, by skill.
        timesteps: Of all trajectories together.
        labelled_by: The model that labelled every timestep; None where none did.
        hand_labelled: Number of trajectories with labels that a person saved.
        with_truth: Number of trajectories with true labels, which only measure.
        time_ns: When it was last changed, Unix time in nanoseconds.
        error: Why it cannot be opened; else empty.
    """

    name: str
    goal_text: str = ""
    cameras: tuple[Camera, ...] = ()
    fps: int = 0
    action: ActionSpec | None = None
    skills: tuple[str, ...] = ()
    tags: dict[str, int] = field(default_factory=dict)
    trajectories: int = 0
    timesteps: int = 0
    labelled_by: ModelRef | None = None
    hand_labelled: int = 0
    with_truth: int = 0
    time_ns: int = 0
    error: str = ""


@dataclass(frozen=True)
class ListDatasetsRequest:
    """Requests one page of the datasets; `page_size` is at most 1000, 0 for 100."""

    page_size: int = 0
    page_token: str = ""


@dataclass(frozen=True)
class ListDatasetsResponse:
    """One page of the datasets, by name; `next_page_token` is empty on the last page."""

    datasets: tuple[Dataset, ...]
    next_page_token: str = ""


@dataclass(frozen=True)
class ListDatasetProblemsRequest:
    """Requests the problems of one dataset by its name."""

    dataset: str


@dataclass(frozen=True)
class DatasetProblem:
    """What prevents or impairs learning skills from a dataset: what was expected and found, and how to mend it.

    Attributes:
        subject: What it concerns, such as `skills` or a trajectory.
        severity: `error` where fits of segmentation refuse the dataset; `warning` where a fit learns less.
    """

    subject: str
    detail: str
    hint: str
    severity: Literal["error", "warning"]


@dataclass(frozen=True)
class ListDatasetProblemsResponse:
    """The problems; empty for a dataset without any."""

    problems: tuple[DatasetProblem, ...]


@dataclass(frozen=True)
class LabelSegment:
    """Timesteps [start, end) of a trajectory that have one label; `skill` is empty where there is none."""

    start: int
    end: int
    skill: str = ""


@dataclass(frozen=True)
class GetTrajectoryRequest:
    """Requests one trajectory of a dataset; `index` is from 0."""

    dataset: str
    index: int = 0


@dataclass(frozen=True, eq=False)
class GetTrajectoryResponse:
    """One trajectory, without its frames. Never holds ground truth.

    Attributes:
        skills: The skills that occur, sorted; empty where unknown.
        labels: Labels of a segmentation model, without gaps; empty where the dataset was not labelled.
        hand_labels: Labels that a person saved, without gaps; empty where none did.
        known_skills: The names that labels may have: skills of the dataset, and of the model that labelled it.
        actions: float32 (T, A) or int64 (T, 1), in the dataset's own unit; None where there are none, or more than
            100 000 numbers.
    """

    skills: tuple[str, ...]
    goal_text: str
    timesteps: int
    labels: tuple[LabelSegment, ...]
    hand_labels: tuple[LabelSegment, ...]
    known_skills: tuple[str, ...]
    actions: npt.NDArray[np.float32] | npt.NDArray[np.int64] | None = None


@dataclass(frozen=True)
class GetFramesRequest:
    """Requests some frames of a trajectory.

    Attributes:
        index: Of the trajectory, from 0.
        camera: Empty for the dataset's first.
        first: First timestep.
        count: At most so many frames, of 64; 0 for 32. Large ones are fewer: of 2^25 pixels together, or one.
        max_side: Greatest height and width in pixels, 16 to 1024: larger frames are scaled down; 0 for 256.
    """

    dataset: str
    index: int = 0
    camera: str = ""
    first: int = 0
    count: int = 0
    max_side: int = 0


@dataclass(frozen=True, eq=False)
class GetFramesResponse:
    """Frames of consecutive timesteps, JPEG files; `timesteps` are those of the trajectory."""

    frames: tuple[Image, ...]
    first: int
    timesteps: int


@dataclass(frozen=True)
class SaveLabelsRequest:
    """Labels of a trajectory that a person gave: segments from timestep 0 to the last, without gap or overlap."""

    dataset: str
    segments: tuple[LabelSegment, ...]
    index: int = 0


@dataclass(frozen=True)
class SaveLabelsResponse:
    """The labels are saved."""
