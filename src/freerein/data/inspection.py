"""What a dataset holds, at a glance."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from freerein.data import layout, truth
from freerein.data.reader import Dataset
from freerein.data.spec import DatasetSpec


@dataclass(frozen=True)
class Summary:
    """What a dataset holds.

    Attributes:
        spec: What its trajectories have in common.
        trajectories: How many there are.
        frames: Timesteps of all together.
        duration_s: Time recorded, in seconds.
        shortest: Timesteps of the shortest trajectory; 0 when there is none.
        longest: Timesteps of the longest.
        skill_counts: In how many trajectories each skill occurs, by skill.
        untagged: Trajectories whose skills are unknown.
        goal_text_counts: In how many trajectories each goal text was to be done, by goal text.
        labelled: Trajectories with ground-truth labels beside them.
        data_bytes: Size of `data/`.
        fingerprint: sha256 of the contents, in hexadecimal.
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


def inspect(root: Path) -> Summary:
    """Returns what a dataset holds.

    Raises:
        NotFound: There is no dataset in `root`.
        InvalidInput: It cannot be opened; `verify` says why.
    """
    dataset = Dataset(root)
    occurrences = Counter(skill for skills in dataset.skills for skill in skills)
    frames = int(dataset.lengths.sum())
    return Summary(
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
