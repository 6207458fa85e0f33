"""Datasets as people see them: listed though some are damaged, watched a page at a time, labelled by hand."""

import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import PIL.Image
import pytest
from tests.lerobot_dataset import write_dataset

from freerein.data import Dataset, DatasetSpec, create, labels, truth
from freerein.data.labels import LabelsInfo, LabelsWriter
from freerein.data.meta import WriterLock
from freerein.errors import FailedPrecondition, InvalidInput, NotFound
from freerein.types.common import ActionSpec, Camera, ModelRef, Trajectory
from freerein.types.orchestrator import (
    GetFramesRequest,
    GetTrajectoryRequest,
    LabelSegment,
    ListDatasetProblemsRequest,
    ListDatasetsRequest,
    SaveLabelsRequest,
)
from freerein_orchestrator.datasets import DatasetService

STEPS = 90
CAMERAS = {"front": (48, 64, 3), "wrist": (20, 40, 1)}
SPEC = DatasetSpec(
    fps=10,
    cameras=CAMERAS,
    action=ActionSpec(2, 0, ("x", "y")),
    robot_type="arm",
    skills=("pick", "push"),
    task="tidy up",
)
MODEL = ModelRef("segments", "0123456789ab")


def frames(camera: str) -> npt.NDArray[np.uint8]:
    """Returns frames whose brightness tells the timestep."""
    return np.full((STEPS, *CAMERAS[camera]), np.arange(STEPS)[:, None, None, None] * 2, np.uint8)


@pytest.fixture
def data_dir(tmp_path: Path) -> Path:
    """A data directory with the dataset `demos`, of two trajectories."""
    actions = np.linspace(-1, 1, 2 * STEPS, dtype=np.float32).reshape(STEPS, 2)
    with create(tmp_path / "datasets" / "demos", SPEC) as writer:
        for skills in (("pick",), ("pick", "push")):
            writer.append(Trajectory({camera: frames(camera) for camera in CAMERAS}, actions, skills))
    return tmp_path


@pytest.fixture
def service(data_dir: Path) -> DatasetService:
    return DatasetService(data_dir)


def label_by_model(root: Path, *values: int) -> None:
    with LabelsWriter(root, name="test") as writer:
        for index in range(2):
            writer.save(index, np.repeat(values, STEPS // len(values)))
        writer.finish(LabelsInfo(("pick", "pour"), MODEL))


async def test_datasets_are_listed_by_name_and_a_damaged_one_says_why(data_dir: Path, service: DatasetService) -> None:
    root = data_dir / "datasets"
    (root / "torn" / "meta").mkdir(parents=True)
    (root / "unread" / "meta").mkdir(parents=True)
    (root / "unread" / "tags.json").symlink_to("/proc/self/mem")  # a regular file that cannot be read: EIO
    (root / ".import-12345678" / "meta").mkdir(parents=True)
    write_dataset(root / "arm")
    label_by_model(root / "demos", 0, 1)
    truth.save(root / "demos", 0, np.zeros(STEPS, np.int64))
    arm, demos, torn, unread = (await service.list_datasets(ListDatasetsRequest())).datasets
    assert (arm.name, arm.fps, arm.trajectories, arm.timesteps, arm.error) == ("arm", 10, 3, 15, "")
    assert demos.cameras == (Camera("front", 48, 64, 3), Camera("wrist", 20, 40, 1))
    assert (demos.goal_text, demos.skills, demos.tags) == ("tidy up", ("pick", "push"), {"pick": 2, "push": 1})
    assert (demos.trajectories, demos.timesteps, demos.action) == (2, 2 * STEPS, SPEC.action)
    assert (demos.labelled_by, demos.hand_labelled, demos.with_truth) == (MODEL, 0, 1)
    assert (torn.name, torn.trajectories) == ("torn", 0)
    assert "There must be a dataset" in torn.error
    assert unread.error == "It cannot be read: Input/output error."


async def test_pages_of_datasets_hold_each_of_them_once(data_dir: Path, service: DatasetService) -> None:
    for name in ("a", "b", "e"):
        (data_dir / "datasets" / name / "meta").mkdir(parents=True)
    found, token = list[str](), ""
    while True:
        page = await service.list_datasets(ListDatasetsRequest(2, token))
        found += [each.name for each in page.datasets]
        token = page.next_page_token
        if not token:
            break
    assert found == ["a", "b", "demos", "e"]


async def test_problems_are_those_of_the_command_line(service: DatasetService) -> None:
    problems = (await service.list_dataset_problems(ListDatasetProblemsRequest("demos"))).problems
    assert {each.severity for each in problems} == {"warning"}
    assert any("occurs in all" in each.detail and each.hint for each in problems)


async def test_a_page_of_frames_is_small_pictures_of_those_timesteps(service: DatasetService) -> None:
    shown = await service.get_frames(GetFramesRequest("demos", 1, "front", first=80, count=64, max_side=32))
    assert (shown.first, shown.timesteps, len(shown.frames)) == (80, STEPS, 10)
    for t, image in enumerate(shown.frames, 80):
        assert (image.encoding, image.height, image.width, image.camera) == ("jpeg", 24, 32, "front")
        pixels = np.asarray(PIL.Image.open(io.BytesIO(image.data)))
        assert pixels.shape == (24, 32, 3)
        assert abs(int(pixels[0, 0, 0]) - 2 * t) <= 2


async def test_frames_are_of_the_first_camera_and_never_enlarged(service: DatasetService) -> None:
    shown = await service.get_frames(GetFramesRequest("demos"))
    assert (len(shown.frames), shown.frames[0].camera, shown.frames[0].width) == (32, "front", 64)
    (gray,) = (await service.get_frames(GetFramesRequest("demos", camera="wrist", count=1))).frames
    assert np.asarray(PIL.Image.open(io.BytesIO(gray.data))).shape == (20, 40)


async def test_large_frames_come_a_few_at_a_time(data_dir: Path, service: DatasetService) -> None:
    spec = replace(SPEC, cameras={"front": (4000, 4000, 1)})
    with create(data_dir / "datasets" / "large", spec) as writer:
        writer.append(Trajectory({"front": np.zeros((3, 4000, 4000, 1), np.uint8)}, np.zeros((3, 2), np.float32)))
    shown = await service.get_frames(GetFramesRequest("large", max_side=16))
    assert [(image.height, image.width) for image in shown.frames] == [(16, 16)] * 2


async def test_a_trajectory_has_its_tags_actions_and_the_labels_of_a_model(
    data_dir: Path, service: DatasetService
) -> None:
    asked = GetTrajectoryRequest("demos", 1)
    plain = await service.get_trajectory(asked)
    assert (plain.skills, plain.goal_text, plain.timesteps) == (("pick", "push"), "tidy up", STEPS)
    assert (plain.labels, plain.hand_labels, plain.known_skills) == ((), (), ("pick", "push"))
    assert plain.actions is not None
    assert (plain.actions.shape, plain.actions[0, 0]) == ((STEPS, 2), -1)
    label_by_model(data_dir / "datasets" / "demos", 0, -1, 1)
    labelled = await service.get_trajectory(asked)
    assert labelled.labels == (LabelSegment(0, 30, "pick"), LabelSegment(30, 60), LabelSegment(60, STEPS, "pour"))
    assert labelled.known_skills == ("pick", "push", "pour")


def hand_labels(*ends: tuple[int, str]) -> tuple[LabelSegment, ...]:
    """Returns segments without gaps, by their ends and skills."""
    starts = (0, *(end for end, _ in ends))
    return tuple(LabelSegment(start, end, skill) for start, (end, skill) in zip(starts, ends, strict=False))


async def test_labels_by_hand_replace_earlier_ones_and_are_neither_predicted_nor_true(
    data_dir: Path, service: DatasetService
) -> None:
    root = data_dir / "datasets" / "demos"
    before = Dataset(root).fingerprint
    for segments in (hand_labels((STEPS, "push")), hand_labels((40, "pick"), (45, ""), (STEPS, "push"))):
        await service.save_labels(SaveLabelsRequest("demos", segments, 1))
        assert (await service.get_trajectory(GetTrajectoryRequest("demos", 1))).hand_labels == segments
    assert (await service.get_trajectory(GetTrajectoryRequest("demos", 0))).hand_labels == ()
    assert (await service.list_datasets(ListDatasetsRequest())).datasets[0].hand_labelled == 1
    assert truth.stored(root) == []
    with pytest.raises(FailedPrecondition):
        labels.info(root)
    assert Dataset(root).fingerprint == before


@pytest.mark.parametrize(
    ("segments", "field", "words"),
    [
        (hand_labels((40, "pick"), (STEPS, "pour")), "segments.1.skill", "got `pour`"),
        (hand_labels((40, "Pick"), (STEPS, "push")), "segments.0.skill", "did you mean `pick`"),
        (hand_labels((40, "pick"), (STEPS - 1, "push")), "segments", "end with the trajectory, at 90; they end at 89"),
        (hand_labels((40, "pick"), (STEPS + 1, "push")), "segments.1.end", "at most 90; got 91"),
        (hand_labels((40, "pick"), (40, "push"), (STEPS, "push")), "segments.1.end", "above 40"),
        ((LabelSegment(0, 50, "pick"), LabelSegment(40, STEPS, "push")), "segments.1.start", "must be 50"),
        ((LabelSegment(0, 40, "pick"), LabelSegment(50, STEPS, "push")), "segments.1.start", "must be 40"),
        ((LabelSegment(40, STEPS, "push"), LabelSegment(0, 40, "pick")), "segments.0.start", "must be 0"),
        ((), "segments", "they end at 0"),
    ],
)
async def test_labels_that_overlap_leave_gaps_or_name_unknown_skills_change_nothing(
    service: DatasetService, segments: tuple[LabelSegment, ...], field: str, words: str
) -> None:
    earlier = hand_labels((STEPS, "push"))
    await service.save_labels(SaveLabelsRequest("demos", earlier, 1))
    with pytest.raises(InvalidInput, match=words) as refused:
        await service.save_labels(SaveLabelsRequest("demos", segments, 1))
    assert (refused.value.field, bool(refused.value.hint)) == (field, True)
    assert (await service.get_trajectory(GetTrajectoryRequest("demos", 1))).hand_labels == earlier


async def test_a_dataset_that_is_being_written_takes_no_labels(data_dir: Path, service: DatasetService) -> None:
    lock = WriterLock(data_dir / "datasets" / "demos")
    with pytest.raises(FailedPrecondition, match="one writer"):
        await service.save_labels(SaveLabelsRequest("demos", hand_labels((STEPS, "push"))))
    lock.close()


@pytest.mark.parametrize("content", ["", "{}", '{"segments": [{"start": 0, "end": 9, "skill": "pick"}]}', "[" * 10**5])
async def test_damaged_labels_are_named(data_dir: Path, service: DatasetService, content: str) -> None:
    await service.save_labels(SaveLabelsRequest("demos", hand_labels((STEPS, "push"))))
    (path,) = (data_dir / "datasets" / "demos" / "hand_labels").iterdir()
    assert json.loads(path.read_text())["segments"] == [{"start": 0, "end": STEPS, "skill": "push"}]
    path.write_text(content)
    with pytest.raises(InvalidInput, match=r"`hand_labels/000000\.json` must hold labels") as refused:
        await service.get_trajectory(GetTrajectoryRequest("demos", 0))
    assert refused.value.hint


async def test_a_dataset_or_trajectory_that_is_not_there_is_not_found(service: DatasetService) -> None:
    for name, index in (("other", 0), ("demos", 2)):
        for call, request in (
            (service.get_trajectory, GetTrajectoryRequest(name, index)),
            (service.get_frames, GetFramesRequest(name, index)),
            (service.save_labels, SaveLabelsRequest(name, hand_labels((STEPS, "")), index)),
        ):
            with pytest.raises(NotFound):
                await call(request)
