"""The orchestrator's datasets in the contract: a dataset of two short trajectories, and one that is damaged."""

from pathlib import Path

import numpy as np

from freerein.data import DatasetSpec, create
from freerein.types import orchestrator
from freerein.types.common import ActionSpec, Trajectory
from freerein.types.orchestrator import GetFramesRequest, GetTrajectoryRequest, LabelSegment, SaveLabelsRequest

SPEC = DatasetSpec(
    fps=10, cameras={"front": (6, 8, 3)}, action=ActionSpec(2, 0, ("x", "y")), robot_type="arm", skills=("pick", "push")
)


def record(data_dir: Path) -> None:
    frames, actions = np.zeros((4, 6, 8, 3), np.uint8), np.zeros((4, 2), np.float32)
    with create(data_dir / "datasets" / "seen", SPEC) as writer:
        for skills in (("pick",), ("pick", "push")):
            writer.append(Trajectory({"front": frames}, actions, skills))
    (data_dir / "datasets" / "torn" / "meta").mkdir(parents=True)


def save(code: str, *segments: tuple[int, int, str], index: int = 1) -> tuple[str, SaveLabelsRequest, str]:
    return "SaveLabels", SaveLabelsRequest("seen", tuple(LabelSegment(*each) for each in segments), index), code


CASES = (
    ("ListDatasets", orchestrator.ListDatasetsRequest()),
    ("ListDatasets", orchestrator.ListDatasetsRequest(1, "seen")),
    ("ListDatasets", orchestrator.ListDatasetsRequest(1001), "invalid_input"),
    ("ListDatasetProblems", orchestrator.ListDatasetProblemsRequest("seen")),
    ("ListDatasetProblems", orchestrator.ListDatasetProblemsRequest("none"), "not_found"),
    ("ListDatasetProblems", orchestrator.ListDatasetProblemsRequest("../seen"), "invalid_input"),
    save("", (0, 3, "pick"), (3, 4, "")),
    save("invalid_input"),
    save("invalid_input", (1, 4, "pick")),
    save("invalid_input", (0, 2, "pick"), (1, 4, "push")),
    save("invalid_input", (0, 2, "pick"), (3, 4, "push")),
    save("invalid_input", (0, 3, "pick")),
    save("invalid_input", (0, 5, "pick")),
    save("invalid_input", (0, 0, "push"), (0, 4, "pick")),
    save("invalid_input", (0, 4, "pour")),
    save("not_found", (0, 4, "pick"), index=2),
    ("GetTrajectory", GetTrajectoryRequest("seen", 1)),
    ("GetTrajectory", GetTrajectoryRequest("seen", 2), "not_found"),
    ("GetTrajectory", GetTrajectoryRequest("none"), "not_found"),
    ("GetTrajectory", GetTrajectoryRequest("../seen"), "invalid_input"),
    ("GetFrames", GetFramesRequest("seen", 1, "front", 1, 2, 16)),
    ("GetFrames", GetFramesRequest("seen", 2), "not_found"),
    ("GetFrames", GetFramesRequest("seen", camera="wrist"), "invalid_input"),
    ("GetFrames", GetFramesRequest("seen", first=4), "invalid_input"),
    ("GetFrames", GetFramesRequest("seen", count=65), "invalid_input"),
    ("GetFrames", GetFramesRequest("seen", max_side=15), "invalid_input"),
    ("GetFrames", GetFramesRequest("seen", max_side=1025), "invalid_input"),
)
