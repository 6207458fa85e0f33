"""Records datasets. `append` returns once the trajectory is on disk, so a crash loses at most the open one."""

from pathlib import Path
from typing import Self

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from freerein.atomic_files import TEMP_SUFFIX, fsync_folder, write_atomic
from freerein.data import layout, meta, truth
from freerein.data.folder_locks import temporary_folder
from freerein.data.layout import DatasetSpec
from freerein.data.meta import Row, WriterLock
from freerein.data.trajectory_file import Actions, State, encode
from freerein.errors import AlreadyExists, FailedPrecondition, InvalidInput, NotFound, must_be, quoted
from freerein.types.common import MAX_TEXT, Trajectory


def create(root: Path, spec: DatasetSpec) -> "Writer":
    """Creates an empty dataset atomically and returns its writer.

    Args:
        root: The dataset's folder; must not exist, or be empty.
        spec: Properties that its trajectories share.

    Raises:
        AlreadyExists: `root` is not empty.
    """
    root.parent.mkdir(parents=True, exist_ok=True)
    with temporary_folder(root.parent, prefix=".create-") as folder:
        staging = folder / root.name
        (staging / "data").mkdir(parents=True)
        meta.save(staging, spec, meta.episodes_schema(spec).empty_table())
        try:
            staging.rename(root)
        except OSError:  # a folder in use, or a file
            raise AlreadyExists(
                "A new dataset needs a name that is not taken; this one is.",
                hint="Append to it with open_writer, or choose another name.",
            ) from None
    fsync_folder(root.parent)
    return open_writer(root)


def open_writer(root: Path) -> "Writer":
    """Returns the writer of a dataset, after repairing what a crash left.

    Raises:
        NotFound: There is no dataset in `root` that freerein wrote.
        FailedPrecondition: The dataset has another writer.
        InvalidInput: A data file is missing or corrupt.
    """
    spec = meta.read_spec(root) if root.is_dir() else None
    if spec is None:
        raise NotFound(
            f"There must be a dataset that freerein wrote; {quoted(str(root))} holds none.",
            hint="Make one with create; datasets of other tools can only be read.",
        )
    return Writer(root, spec)


class Writer:
    """The only writer of a dataset, from `create` or `open_writer`; a context manager.

    `meta/` is written on `close` and after every 1000 trajectories; readers take newer trajectories from their files.

    Attributes:
        spec: Properties that the trajectories share.
    """

    def __init__(self, root: Path, spec: DatasetSpec) -> None:
        self.spec = spec
        self._root = root
        self._lock = WriterLock(root)
        try:
            self._table = _repaired(root, spec)
        except BaseException:
            self._lock.close()
            raise
        self._rows: list[Row] = []
        self._frames = meta.frame_count(self._table)
        self._tasks = meta.task_indices(self._table)
        self._is_open = True

    def __len__(self) -> int:
        """Returns the number of trajectories on disk."""
        return len(self._table) + len(self._rows)

    def append(
        self, trajectory: Trajectory, labels: npt.NDArray[np.int64] | None = None, *, robot_state: State | None = None
    ) -> int:
        """Writes one trajectory durably.

        Args:
            trajectory: Matches the spec: every camera, T >= 1 timesteps, `terminated` if the spec has terminations.
            labels: Ground truth for evaluation, int64 (T,), indices into the spec's skills; stored in `truth/`.
            robot_state: The robot's own state, float32 (T, S), where the spec has one.

        Returns:
            Index of the trajectory in the dataset.

        Raises:
            InvalidInput: The trajectory, the labels or the state do not match the spec.
            FailedPrecondition: The writer is closed.
        """
        if not self._is_open:
            raise FailedPrecondition("A writer must be open to append; this one is closed.", hint="Use open_writer.")
        _check_trajectory(trajectory, self.spec)
        _check_robot_state(robot_state, self.spec, length=len(trajectory.actions))
        index = len(self)
        task = trajectory.goal_text or self.spec.task
        number = self._tasks.get(task, len(self._tasks))
        data = encode(
            trajectory, self.spec, index=index, first_frame=self._frames, task_index=number, state=robot_state
        )
        truth.discard(self._root, index)  # of an append that failed half-way
        if labels is not None:
            _check_labels(labels, self.spec, length=len(trajectory.actions))
            truth.save(self._root, index, labels)  # before the data: what is on disk has all its labels
        write_atomic(layout.trajectory_path(self._root / "data", index), data)
        self._rows.append(meta.describe(data, index=index, first_frame=self._frames))
        self._frames += len(trajectory.actions)
        self._tasks[task] = number
        if len(self._rows) == layout.CHUNK_SIZE:
            self._save_meta()
        return index

    def close(self) -> None:
        """Writes `meta/` and releases the lock; a second call does nothing."""
        if self._is_open:
            self._is_open = False
            try:
                if self._rows:
                    self._save_meta()
            finally:
                self._lock.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _save_meta(self) -> None:
        self._table, self._rows = meta.extended(self._table, self._rows), []
        meta.save(self._root, self.spec, self._table)


def _repaired(root: Path, spec: DatasetSpec) -> pa.Table:
    """Deletes unfinished files and orphaned labels, brings `meta/` up to date, and returns the episodes table."""
    for folder in ("data", "meta", "truth"):
        for unfinished in (root / folder).rglob(f"*{TEMP_SUFFIX}"):
            unfinished.unlink()
    table, is_current = meta.load(root, spec)
    for orphan in truth.stored(root):
        if orphan >= len(table):
            truth.discard(root, orphan)
    if not is_current:
        meta.save(root, spec, table)
    return table


def _check_trajectory(trajectory: Trajectory, spec: DatasetSpec) -> None:
    _check_actions(trajectory.actions, spec)
    _check_terminations(trajectory.terminated, spec, length=len(trajectory.actions))
    if set(trajectory.frames) != set(spec.cameras):
        rule = f"of exactly the cameras {', '.join(sorted(spec.cameras))}"
        raise must_be("frames", rule, f"{len(trajectory.frames)} cameras that are not these")
    for camera, size in spec.cameras.items():
        frames, expected = trajectory.frames[camera], (len(trajectory.actions), *size)
        if frames.dtype != np.uint8 or frames.shape != expected:
            rule, hint = f"uint8 {expected}, as many as actions", "Give channels last, values 0..255."
            raise must_be(f"frames.{camera}", rule, f"{frames.dtype} {frames.shape}", hint=hint)
    unknown = set(trajectory.skills) - set(spec.skills)
    if unknown or list(trajectory.skills) != sorted(set(trajectory.skills)):
        rule = f"sorted, different, and of the dataset's {len(spec.skills)} skills"
        raise must_be("skills", rule, f"{len(trajectory.skills)}, {len(unknown)} of them unknown")
    text = trajectory.goal_text
    if len(text) > MAX_TEXT or text.encode(errors="replace").decode() != text:
        rule, hint = f"of up to {MAX_TEXT} characters, all of Unicode", "Say what is to be done in one sentence."
        raise must_be("goal_text", rule, len(text), hint=hint)


def _check_actions(actions: Actions, spec: DatasetSpec) -> None:
    expected = f"{spec.action.dtype} (T, {spec.action.size}) with T >= 1"
    if actions.dtype != spec.action.dtype or actions.shape[1:] != (spec.action.size,) or not len(actions):
        raise must_be("actions", expected, f"{actions.dtype} {actions.shape}")
    low, high = spec.action_bounds
    outside = int(np.sum(~((actions >= low) & (actions <= high))))
    if outside:
        raise InvalidInput(
            f"Actions must be {spec.action_range}; {outside} of {actions.size} numbers are not.",
            field="actions",
            hint="Scale continuous actions by the world's action spec, or make the dataset without "
            "`has_scaled_actions`.",
        )


def _check_terminations(terminated: npt.NDArray[np.bool_] | None, spec: DatasetSpec, *, length: int) -> None:
    if (terminated is not None) != spec.has_terminations:
        expected, found = ("`terminated`", "none") if spec.has_terminations else ("no `terminated`", "one")
        raise InvalidInput(
            f"A trajectory of this dataset must have {expected}, like all others of it; got {found}.",
            field="terminated",
            hint="Give it for all trajectories of a dataset made with `has_terminations`, and for none of another.",
        )
    if terminated is not None and (terminated.dtype != np.bool_ or terminated.shape != (length,)):
        hint = "Say for each action whether the episode terminated after it."
        found = f"{terminated.dtype} {terminated.shape}"
        raise must_be("terminated", f"bool ({length},), one per action", found, hint=hint)


def _check_robot_state(state: State | None, spec: DatasetSpec, *, length: int) -> None:
    shape = (length, spec.robot_state_size)
    if state is None and not spec.robot_state_size:
        return
    if state is None or not spec.robot_state_size or state.dtype != np.float32 or state.shape != shape:
        expected = f"float32 {shape}, one per action" if spec.robot_state_size else "none, as the dataset has none"
        found = "none" if state is None else f"{state.dtype} {state.shape}"
        raise must_be("The robot's state", expected, found, field="robot_state")
    if not np.all(np.isfinite(state)):
        hint = "Leave the feature out, with LeRobot's `lerobot-edit-dataset`, or the broken episodes."
        raise must_be("The robot's state", "finite", "others, too", field="robot_state", hint=hint)


def _check_labels(labels: npt.NDArray[np.int64], spec: DatasetSpec, *, length: int) -> None:
    if labels.dtype != np.int64 or labels.shape != (length,):
        raise must_be("labels", f"int64 ({length},)", f"{labels.dtype} {labels.shape}")
    if np.any((labels < 0) | (labels >= len(spec.skills))):
        raise must_be("labels", f"in [0, {len(spec.skills)}), the dataset's skills", "others")
