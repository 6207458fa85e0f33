"""Errors over REST name paths, never RPCs."""

import pytest

from freerein.serving.rest.wording import with_paths


@pytest.mark.parametrize(
    ("sentence", "over_rest"),
    [
        ("See the task's `action` in ListTasks.", "See the task's `action` in GET /v1/list-tasks."),
        ("GetSpec names the cameras.", "GET /v1/get-spec names the cameras."),
        ("Call `Reset` first.", "Call POST /v1/reset first."),
        ("Reset the robot; send `Authorization`.", "Reset the robot; send `Authorization`."),
        ("Open `Control`, or send LeRobot data.", "Open `Control`, or send LeRobot data."),
    ],
)
def test_rpcs_become_paths(sentence: str, over_rest: str) -> None:
    assert with_paths(sentence) == over_rest
