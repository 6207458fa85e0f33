"""Kind `label`: labels every timestep of a dataset by a segmentation model, beside the data, where learners may read.

<folder>/checkpoints/labelled.json   the model's version, and the number of trajectories that are labelled
         artifacts/labels.json       the model, its skills, and the number of trajectories
"""

import json
from dataclasses import asdict, dataclass
from functools import partial

from freerein.atomic_files import write_atomic
from freerein.config import bounded, parse
from freerein.data import Dataset, dataset_path
from freerein.data.labels import LabelsInfo, LabelsWriter, moved
from freerein.data.lookup import choose_camera
from freerein.types.common import ModelRef, Trajectory, check_name
from freerein.types.segmentation import (
    NO_SKILL,
    ListSkillsRequest,
    ListSkillsResponse,
    SegmentRequest,
    SegmentResponse,
)
from freerein_orchestrator.kinds.context import RunContext
from freerein_orchestrator.kinds.kind import Kind

CARD = "labels.json"


@dataclass(frozen=True)
class LabelConfig:
    """Configuration of a run of kind `label`.

    Attributes:
        dataset: The dataset's name.
        model: Name of the segmentation model; empty for the service's default.
        version: Its version; empty for the one that is active when the run starts.
        camera: The camera of the frames; empty for the one that the model was fitted on.
        smoothing: Standard deviation of the temporal Gaussian filter, in timesteps; 0 for none.
        min_segment: Shortest segment in timesteps; shorter ones are merged into a neighbour. 0 and 1 keep all.
        min_confidence: Least confidence that is kept, in [0, 1], before short segments are rejected; timesteps below it
            have no skill. 0 keeps all.
        min_kept: Shortest segment in timesteps that is kept, after merging; the timesteps of shorter ones are
            rejected: they have no skill. 0 and 1 keep all.
        earlier: Timesteps by which labels are moved to the front: a network that sees nothing of the future names a
            skill late. The last label stays until the end.

    Raises:
        InvalidInput: The dataset's name is invalid.
    """

    dataset: str
    model: str = ""
    version: str = ""
    camera: str = ""
    smoothing: float = bounded(0.0, least=0.0, most=100.0)
    min_segment: int = bounded(0, least=0, most=1000)
    min_confidence: float = bounded(0.0, least=0.0, most=1.0)
    min_kept: int = bounded(0, least=0, most=1000)
    earlier: int = bounded(0, least=0, most=1000)

    def __post_init__(self) -> None:
        check_name(self.dataset, field="config.dataset")


def run(context: RunContext, config: LabelConfig) -> None:
    """Labels all trajectories by one version of the model; a killed run continues with the next trajectory.

    It begins anew where another one has labelled the dataset since. The labels count only once all trajectories have
    theirs.

    Raises:
        Stopped: The run is to stop.
        NotFound: There is no such dataset or model.
        InvalidInput: The dataset has no such camera, several but not the model's, or its frames are not the model's.
        FailedPrecondition: Another run or command is labelling the dataset.
        ServiceError: The segmentation service refuses.
    """
    retry, segmentation = context.retry(), context.client("segmentation")
    root = dataset_path(context.data_dir, config.dataset)
    dataset = Dataset(root)
    path = context.folder / "checkpoints" / "labelled.json"
    saved = json.loads(path.read_bytes()) if path.is_file() else None
    asked = ModelRef(**saved["model"]) if saved else ModelRef(config.model, config.version)
    model = retry.call(lambda: segmentation.list_skills(ListSkillsRequest(asked)))
    camera = choose_camera(dataset, config.camera, of_model=model.camera, field="config.camera")

    def segment(index: int) -> SegmentResponse:
        request = _request(config, model, dataset[index], camera)
        answer: SegmentResponse = retry.call(partial(segmentation.segment, request))
        return answer

    if saved is None:
        segment(0)  # a model that takes no such frames leaves the labels that are there
    with LabelsWriter(root, name=context.key) as writer:
        first = saved["labelled"] if writer.goes_on and saved else 0
        metrics = context.metrics_logger(first, group="label")
        for index in range(first, len(dataset)):
            answer = segment(index)
            writer.save(index, moved(answer.labels, config.earlier))
            write_atomic(path, json.dumps({"model": asdict(model.model), "labelled": index + 1}).encode())
            metrics.append(index + 1, _metrics(answer))
        writer.finish(LabelsInfo(model.skills, model.model))
    card = {
        "dataset": config.dataset,
        "trajectories": len(dataset),
        "skills": model.skills,
        "model": asdict(model.model),
        "fps": {"dataset": dataset.spec.fps, "model": model.fps or None},
    }
    write_atomic(context.artifacts / CARD, json.dumps(card, indent=2).encode() + b"\n")


def _request(config: LabelConfig, model: ListSkillsResponse, trajectory: Trajectory, camera: str) -> SegmentRequest:
    return SegmentRequest(
        model.model,
        trajectory.frames[camera],
        actions=trajectory.actions if model.action_size else None,
        min_segment=config.min_segment,
        smoothing=config.smoothing,
        min_kept=config.min_kept,
        min_confidence=config.min_confidence,
    )


def _metrics(answer: SegmentResponse) -> dict[str, float]:
    return {"confidence": float(answer.confidence.mean()), "kept": float((answer.labels != NO_SKILL).mean())}


KIND = Kind(
    {"": LabelConfig},
    partial(parse, LabelConfig),
    steps=lambda _: 0,
    run=run,
    meaning="Labels every timestep of a dataset by a segmentation model.",
)
