"""Whether a policy's cameras and actions fit a task."""

import pytest

from freerein.errors import InvalidInput
from freerein.types.common import ActionSpec, Camera
from freerein.types.sim import Task
from freerein_orchestrator.envs.policy_interface import PolicyInterface, check_task, check_teachers

FRONT, WRIST = Camera("front", 64, 64, 3), Camera("wrist", 32, 48, 3)
TASK = Task("reach", "arm", "", (FRONT, WRIST), ActionSpec(2, 0, ("x", "y")), 0.1, (), 50)


@pytest.mark.parametrize(
    ("cameras", "size"),
    [
        ((FRONT,), (0, 0)),
        ((WRIST, FRONT), (0, 0)),
        ((Camera("front", 16, 24, 3),), (16, 24)),
        ((Camera("front", 16, 24, 3), Camera("wrist", 16, 24, 3)), (16, 24)),
    ],
)
def test_a_session_renders_the_task_s_own_sizes_or_one_for_all_cameras(
    cameras: tuple[Camera, ...], size: tuple[int, int]
) -> None:
    spec = PolicyInterface(cameras, 2, 0)
    check_task(spec, TASK)
    assert spec.frame_size(TASK) == size


def test_sizes_that_no_session_renders_are_refused() -> None:
    with pytest.raises(InvalidInput, match="one frame size, or those of the task"):
        PolicyInterface((FRONT, Camera("wrist", 16, 24, 3)), 2, 0).frame_size(TASK)


@pytest.mark.parametrize(
    "spec",
    [
        PolicyInterface((FRONT, Camera("top", 64, 64, 3)), 2, 0),
        PolicyInterface((Camera("front", 64, 64, 1),), 2, 0),
        PolicyInterface((FRONT,), 3, 0),
        PolicyInterface((FRONT,), 1, 4),
    ],
)
def test_other_cameras_or_actions_are_refused(spec: PolicyInterface) -> None:
    with pytest.raises(InvalidInput, match="this task has camera front with 3 channels, camera wrist with 3 channels"):
        check_task(spec, TASK)


@pytest.mark.parametrize("cameras", [[], ["front"], "front"])
def test_a_student_has_cameras_of_its_teachers(cameras: object) -> None:
    check_teachers([PolicyInterface((FRONT,), 2, 0)], student_cameras=cameras)
    with pytest.raises(InvalidInput, match="cameras of its teachers, wrist; got another"):
        check_teachers([PolicyInterface((WRIST,), 2, 0)], student_cameras=cameras or "front")
