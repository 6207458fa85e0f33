import json
import re
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

from freerein.data import DatasetSpec, check, create, dataset_path, tag
from freerein.data.layout import SPEC_FILE
from freerein.errors import InvalidInput
from freerein.types.common import ActionSpec, Trajectory
from freerein_segmentation.methods import METHODS

ACTION = ActionSpec(2, 0, ("dy", "dz"), "m", (0.05, 0.05))


def record(data_dir: Path, name: str, *, width: int = 12, action: ActionSpec = ACTION) -> Path:
    """Records two demonstrations of two skills; returns the dataset's folder."""
    root = dataset_path(data_dir, name)
    cameras = {"front": (8, width, 3)}
    spec = DatasetSpec(fps=25, cameras=cameras, action=action, robot_type="test", skills=("pick", "push"))
    with create(root, spec) as writer:
        for _ in range(2):
            frames = {"front": np.zeros((3, 8, width, 3), np.uint8)}
            writer.append(Trajectory(frames, np.zeros((3, action.size), np.float32), ("pick", "push")))
    return root


def test_a_configuration_names_the_only_camera_and_every_default(tmp_path: Path) -> None:
    record(tmp_path, "demos")
    config = METHODS.resolve(tmp_path, "demos", {"steps": 3}, threads=2)
    assert [config[key] for key in ("method", "cameras", "steps", "threads")] == ["set_supervised", ("front",), 3, 2]


def test_frames_that_no_network_is_made_for_are_refused_before_a_fit_begins(tmp_path: Path) -> None:
    record(tmp_path, "wide", width=1280)
    with pytest.raises(InvalidInput, match=r"4 to 1024 pixels high and wide.*got 8 x 1280") as error:
        METHODS.resolve(tmp_path, "wide", {}, threads=1)
    assert "another size" in error.value.hint


def test_a_tag_that_is_no_skill_of_the_dataset_is_refused(tmp_path: Path) -> None:
    path = record(tmp_path, "demos") / SPEC_FILE
    path.write_text(json.dumps({**json.loads(path.read_text()), "skills": ["pick"]}))
    with pytest.raises(InvalidInput, match="1 tags are not"):
        METHODS.resolve(tmp_path, "demos", {}, threads=1)


@pytest.mark.parametrize(
    "table", ["0,pick\n1,\n", "0,pick\n1,push\n", "0,pick;push\n1,pick;push\n", "0,pick\n1,pick\n"]
)
def test_a_fit_refuses_what_check_calls_an_error_and_takes_what_it_warns_of(tmp_path: Path, table: str) -> None:
    root = record(tmp_path, "demos")
    tag(root, f"trajectory,skills\n{table}".encode())
    problems = check(root)
    errors = [each.sentence for each in problems if each.severity == "error"]
    assert problems
    with pytest.raises(InvalidInput, match=re.escape(errors[0])) if errors else nullcontext():
        METHODS.resolve(tmp_path, "demos", {}, threads=1)


def test_evidence_of_actions_needs_actions(tmp_path: Path) -> None:
    record(tmp_path, "seen", action=ActionSpec(0, 0, ()))
    given = {"final_objective": "self_training", "action_evidence": 1.0}
    with pytest.raises(InvalidInput, match="`action_evidence` must be 0 for a dataset without actions"):
        METHODS.resolve(tmp_path, "seen", given, threads=1)
