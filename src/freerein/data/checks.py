"""Checks of a dataset: `inspect` summarises it, `verify` finds damage, `check` finds what prevents learning skills."""

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from freerein.data import layout, meta, truth
from freerein.data.batch_memory import Batches, batch_problems
from freerein.data.counter_columns import CounterColumns
from freerein.data.first_frames import MOST_TRAJECTORIES, first_frame_tests, low_resolution
from freerein.data.input_bounds import ACTION_HINT, action_problem, frame_hint, frame_problem
from freerein.data.layout import DatasetSpec
from freerein.data.lookup import choose_cameras
from freerein.data.meta import Row
from freerein.data.reader import Dataset
from freerein.data.tag_checks import Problem, tag_problems
from freerein.data.trajectory_file import read_rows
from freerein.errors import InvalidInput, ServiceError, UnsupportedMedia
from freerein.types.segmentation import NO_SKILL

_GAP = "The data files must be numbered without a gap; this one is missing."
_REBUILD = "Open the dataset while no writer is open: `meta/` is rebuilt from the data files."
_NO_ACTIONS = Problem(
    "actions",
    "Timesteps have no actions: skills are learned from images alone, and no policy can be.",
    "Record the executed actions, too, if you want policies.",
    "warning",
)
_COUNTER_HINT = "Leave them out and import the dataset again; a joint that only moves one way may stay."
_FEWEST_TRAJECTORIES = 2
_TELLING_AUROC, _SIGNIFICANT = 0.6, 0.01
_RESTORE = "Restore the file from a copy; without one, the trajectories before it can be kept."


@dataclass(frozen=True)
class DatasetSummary:
    """Counts and sizes of a dataset.

    Of its trajectories `shortest` and `longest` are timesteps, 0 where there is none; `untagged` have unknown skills,
    `labelled` have ground truth. `frames` are all timesteps; `fingerprint` is the sha256 of the contents.
    """

    spec: DatasetSpec
    trajectories: int
    frames: int
    duration_s: float
    shortest: int
    longest: int
    skill_counts: dict[str, int]
    untagged: int
    goal_text_counts: dict[str, int]
    labelled: int
    data_bytes: int
    fingerprint: str


@dataclass(frozen=True)
class FitPrediction:
    """The cost of a fit of segmentation: frames (H, W, C) of a camera, minutes by an estimate, and gigabytes.

    Memory is that for the frames of a batch, at most; disk that for decoded frames, which `dataset prune` deletes.
    """

    camera: str
    frame: tuple[int, int, int]
    minutes: float
    memory_gb: float
    disk_gb: float


def inspect(root: Path) -> DatasetSummary:
    """Summarises a dataset.

    Raises:
        NotFound: There is no dataset in `root`.
        InvalidInput: It cannot be opened; `verify` says why.
    """
    dataset = Dataset(root)
    occurrences = Counter(skill for skills in dataset.skills for skill in skills)
    frames = int(dataset.lengths.sum())
    return DatasetSummary(
        spec=dataset.spec,
        trajectories=len(dataset),
        frames=frames,
        duration_s=frames / dataset.spec.fps,
        shortest=int(dataset.lengths.min(initial=frames)),
        longest=int(dataset.lengths.max(initial=0)),
        skill_counts={skill: occurrences[skill] for skill in dataset.spec.skills},
        untagged=dataset.skills.count(()),
        goal_text_counts=dict(Counter(text for text in dataset.goal_texts if text)),
        labelled=len(truth.labelled(root)),
        data_bytes=sum(file.size for file in layout.numbered_files(root / "data")),
        fingerprint=dataset.fingerprint,
    )


def verify(root: Path) -> list[Problem]:
    """Returns all damage of a dataset, in order of trajectories.

    Reads every data file and compares it with the hash recorded when it was written. Changes nothing.

    Raises:
        NotFound: There is no dataset in `root`.
    """
    try:
        spec = meta.read_spec(root)
    except InvalidInput as error:
        return [Problem(layout.SPEC_FILE, error.detail, error.hint)]
    if spec is None:
        return list(_foreign_problems(root))
    return [*_data_problems(root, spec), *_count_problems(root, spec), *_truth_problems(root, spec)]


def check(root: Path) -> list[Problem]:
    """Returns what prevents or impairs learning skills from a dataset: its tags, first frames, actions, lengths, size.

    Fits of segmentation with the default configuration refuse a dataset with an error, and accept one with warnings.

    Raises:
        NotFound: There is no dataset in `root`.
        InvalidInput: It cannot be opened; `verify` says why.
    """
    dataset = Dataset(root)
    if len(dataset) == 0:
        return [Problem("data", "A dataset must hold trajectories; this one is empty.", "Record demonstrations first.")]
    counters = CounterColumns(dataset.spec.action.names)
    trajectories = [
        problem for index in range(len(dataset)) for problem in _trajectory_problems(dataset, index, counters)
    ]
    first_frames = [] if trajectories else _first_frame_problems(dataset)
    actions = [Problem("actions", each, _COUNTER_HINT, "warning") for each in counters.sentences()]
    if not dataset.spec.has_actions:
        named = next((f"Import it: {why}." for why in dataset.left_out.values() if "--action" in why), "")
        actions.append(replace(_NO_ACTIONS, hint=named) if named else _NO_ACTIONS)
    tags = tag_problems(dataset.spec.skills, dataset.skills)
    return [*tags, *actions, *_size_problems(dataset, root.name), *first_frames, *trajectories]


def predict_fit(root: Path) -> FitPrediction:
    """Returns time and memory of a segmentation fit with the default configuration; for a dataset without errors."""
    dataset = Dataset(root)
    batches = _default_batches(dataset)
    (camera,) = choose_cameras(dataset, ())
    disk_bytes = int(dataset.lengths.sum()) * math.prod(batches.frame)
    return FitPrediction(camera, batches.frame, batches.seconds() / 60, batches.memory_bytes / 1e9, disk_bytes / 1e9)


def _size_problems(dataset: Dataset, name: str) -> Iterator[Problem]:
    """Yields why a fit with the default configuration refuses a dataset's count, actions or frames."""
    if len(dataset) < _FEWEST_TRAJECTORIES:
        sentence = (
            f"A fit needs at least {_FEWEST_TRAJECTORIES} trajectories, one of them for validation; got {len(dataset)}."
        )
        yield Problem("data", sentence, "Record more.")
    if problem := action_problem(dataset.spec.action):
        yield Problem("actions", problem, ACTION_HINT)
    batches = _default_batches(dataset)
    if problem := frame_problem(batches.frame):
        yield Problem("frames", problem, frame_hint(batches.frame))
    else:
        yield from batch_problems(batches, dataset=name)


def _default_batches(dataset: Dataset) -> Batches:
    (camera,) = choose_cameras(dataset, ())
    return Batches(dataset.lengths, dataset.spec.cameras[camera])


def _data_problems(root: Path, spec: DatasetSpec) -> Iterator[Problem]:
    recorded = meta.read_episodes(root, spec).select(["dataset_from_index", "data/sha256"]).to_pylist()
    expected = first_frame = 0
    tasks = dict[str, int]()
    for file in layout.numbered_files(root / "data"):
        missing = (layout.trajectory_path(Path("data"), index) for index in range(expected, file.index))
        yield from (Problem(path.as_posix(), _GAP, _RESTORE) for path in missing)
        expected, row = file.index + 1, recorded[file.index] if file.index < len(recorded) else None
        first_frame = row["dataset_from_index"] if row else first_frame
        try:
            entry = _check_data_file(
                root, spec, index=file.index, first_frame=first_frame, sha256=row and row["data/sha256"], tasks=tasks
            )
            first_frame += entry["length"]
        except InvalidInput as error:
            yield Problem(file.path.relative_to(root).as_posix(), error.detail, _RESTORE)
            if row is None:
                return  # the files after it cannot be checked without its length


def _check_data_file(
    root: Path, spec: DatasetSpec, *, index: int, first_frame: int, sha256: str | None, tasks: dict[str, int]
) -> Row:
    """Returns the episodes row of a data file; raises InvalidInput where it is not the file that was recorded.

    `sha256` is the recorded hash, if any; `tasks` has the index of each goal text so far, and a new one is added.
    """
    path, schema = layout.trajectory_path(root / "data", index), layout.data_schema(spec)
    row = meta.describe(meta.read_data_file(root, index), index=index, first_frame=first_frame)
    rows = read_rows([path], index=index, columns=schema.names)
    if len(rows) != row["length"] or not rows.schema.equals(schema):
        raise InvalidInput(
            f"The file must hold {row['length']} timesteps, of trajectory {index} alone, in columns {schema.names}; it "
            f"has {len(rows)} of it, in {rows.schema.names}."
        )
    t = np.arange(len(rows))
    if not (np.array_equal(rows["frame_index"], t) and np.array_equal(rows["index"], first_frame + t)):
        found = rows["index"][0].as_py() if len(rows) else "none"
        raise InvalidInput(
            f"The frames must count on from frame {first_frame} of the dataset, one by one; the first is {found}."
        )
    if sha256 and row["data/sha256"] != sha256:
        raise InvalidInput("The file must be as it was written; it has changed since.")
    number = tasks.setdefault(row["tasks"][0], len(tasks))
    if not np.all(rows["task_index"].to_numpy() == number):
        found = sorted(set(rows["task_index"].to_pylist()))
        raise InvalidInput(f"The goal text must be number {number} of the dataset in every frame; got {found[:5]}.")
    return row


def _count_problems(root: Path, spec: DatasetSpec) -> Iterator[Problem]:
    stored = meta.read_episodes(root, spec)
    sizes = [file.size for file in layout.numbered_files(root / "data")]
    if stored["data/bytes"].to_pylist() != sizes:
        sentence = (
            f"`meta/` must list the {len(sizes)} data files and their sizes; it lists {len(stored)}, or other sizes."
        )
        yield Problem(layout.EPISODES_FILE, sentence, _REBUILD)
    expected, counts = (len(stored), meta.frame_count(stored)), meta.read_counts(root)
    if counts != expected:
        found = f"{counts[0]} and {counts[1]}" if counts else "nothing that can be read"
        sentence = f"`info.json` must count {expected[0]} trajectories and {expected[1]} frames; it has {found}."
        yield Problem(layout.INFO_FILE, sentence, _REBUILD)


def _truth_problems(root: Path, spec: DatasetSpec) -> Iterator[Problem]:
    lengths = meta.read_episodes(root, spec)["length"].to_pylist()
    for index in truth.stored(root):
        where = layout.trajectory_path(Path("truth"), index).as_posix()
        if index >= len(lengths):
            sentence = f"Labels must be of one of the {len(lengths)} trajectories, from 0 on; got {index}."
            yield Problem(where, sentence, "Open the dataset for writing once: such labels are deleted.")
            continue
        try:
            labels = truth.labels(root, index)
        except ServiceError as error:
            yield Problem(where, error.detail, _RESTORE)
            continue
        outside = int(np.sum((labels < NO_SKILL) | (labels >= len(spec.skills))))
        if len(labels) != lengths[index] or outside:
            rule = f"There must be {lengths[index]} labels in [{NO_SKILL}, {len(spec.skills)})"
            sentence = f"{rule}; got {len(labels)}, of which {outside} are outside."
            yield Problem(where, sentence, _RESTORE)


def _foreign_problems(root: Path) -> Iterator[Problem]:
    try:
        dataset = Dataset(root)
    except InvalidInput as error:
        yield Problem("meta", error.detail, error.hint)
        return
    for index, episode in enumerate(dataset.episodes):
        try:
            _ = dataset[index], dataset.robot_state(index)
        except (InvalidInput, UnsupportedMedia) as error:
            yield Problem(f"trajectory {episode}", error.detail, error.hint)


def _first_frame_problems(dataset: Dataset) -> Iterator[Problem]:
    """Asks of each camera by itself, because a learner may be given any of them."""
    tagged = [index for index, skills in enumerate(dataset.skills) if skills]
    items = tagged[:: -(-len(tagged) // MOST_TRAJECTORIES) or 1]
    tags = [dataset.skills[index] for index in items]
    for camera in dataset.spec.cameras:
        try:
            frames = [low_resolution(frame) for frame in dataset.first_frames(items, camera)]
        except (InvalidInput, UnsupportedMedia) as error:
            is_seen = camera in choose_cameras(dataset, ())
            yield Problem(f"camera {camera}", error.detail, error.hint, "error" if is_seen else "warning")
            continue
        for test in first_frame_tests(np.array(frames), tags, rng=np.random.default_rng(0)):
            if test.auroc >= _TELLING_AUROC and test.p_value <= _SIGNIFICANT:
                sentence = (
                    f"First frames must not tell the tags; those of camera {camera} tell {test.skill!r} with an AUROC "
                    f"of {test.auroc:.2f} on held-out trajectories (0.5 is chance, p <= {test.p_value:.3f})."
                )
                hint = "Show all objects in every scene and begin alike: else a model names skills by the scene."
                yield Problem("skills", sentence, hint, "warning")


def _trajectory_problems(dataset: Dataset, index: int, counters: CounterColumns) -> Iterator[Problem]:
    where = f"trajectory {dataset.episodes[index]}"
    if dataset.lengths[index] == 0:
        yield Problem(where, "A trajectory must have at least one timestep; this one has none.", "Leave it out.")
        return
    try:
        actions = dataset.actions(index)
    except InvalidInput as error:
        yield Problem(where, error.detail, error.hint)
        return
    counters.add(actions)
    low, high = dataset.spec.action_bounds
    outside = int(np.sum(~((actions >= low) & (actions <= high))))
    if outside:
        found = f"{outside} of {actions.size} numbers are not"
        sentence = f"Actions must be {dataset.spec.action_range}; {found}."
        yield Problem(where, sentence, "Scale the actions by the robot's limits before recording.")
