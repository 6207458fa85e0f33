"""The real `openpi-client`, unmodified and in an environment of its own, drives a policy by its WebSocket."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from freerein.clients import Channel, ImitationClient
from freerein.types.common import Goal, Image, Observation
from freerein.types.imitation import ActRequest

pytestmark = [pytest.mark.e2e, pytest.mark.long]
ROOT = Path(__file__).parents[2]
CLIENT = ("openpi-client==0.1.2", "msgpack-numpy==0.4.8", "typing-extensions")  # the last it imports without asking
TOKEN = "correct-horse-battery"
GOAL = 6
HOLD = [[0.0, 0.0]] * 3


@pytest.fixture(scope="module")
def python() -> Path:
    """The Python of an environment with openpi's client, which needs an older numpy; kept between runs."""
    venv = ROOT / "var" / "openpi-venv"
    python, stamp = venv / "bin" / "python", venv / "installed"
    if not stamp.exists() or stamp.read_text() != str(CLIENT):
        subprocess.run([sys.executable, "-m", "venv", "--clear", venv], check=True)
        command = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *CLIENT]
        if subprocess.run(command, check=False).returncode:
            pytest.skip(f"{CLIENT[0]} could not be installed")
        stamp.write_text(str(CLIENT))
    return python


@pytest.fixture(scope="module")
def met(python: Path, service: Any) -> dict[str, Any]:
    """What the robot met."""
    address = service.url.removeprefix("http://")
    script = ROOT / "tests" / "compat" / "openpi_robot.py"
    run = subprocess.run([python, script, address, TOKEN], capture_output=True, text=True, check=False, timeout=300)
    assert run.returncode == 0, run.stderr
    return dict(json.loads(run.stdout))


@pytest.fixture(scope="module")
def service(start_module_service: Callable[..., Any]) -> Any:
    environ = {"FREEREIN_SHIPPED_DIR": "none", "FREEREIN_TOKEN": TOKEN}
    return start_module_service("tests.faults.faulty_policy", **environ).until_ready()


def picture(brightness: int) -> Image:
    pixels = np.zeros((4, 4, 3), np.uint8)
    pixels[0, 0, 2] = brightness
    return Image("raw_rgb8", 4, 4, pixels.tobytes(), "front")


def test_the_metadata_are_the_models_spec(met: dict[str, Any]) -> None:
    metadata = met["metadata"]
    assert metadata["cameras"] == [{"name": "front", "height": 4, "width": 4, "channels": 3}]
    assert (metadata["goal_form"], metadata["horizon"], metadata["action"]["names"]) == ("images", 3, ["x", "y"])


async def test_a_runtime_with_chunks_gets_the_actions_of_act_in_every_episode(
    met: dict[str, Any], service: Any
) -> None:
    episode = met["episodes"]["replies"][:3]
    assert [reply["brightness"] for reply in met["episodes"]["replies"]] == [0, 3, GOAL] * 2
    state, executed = b"", None
    async with ImitationClient(Channel(service.address, token=TOKEN)) as client:
        for reply in episode:
            request = ActRequest(Observation((picture(reply["brightness"]),)), Goal((picture(GOAL),)), executed, state)
            expected = await client.act(request)
            fields = (
                "done",
                "done_by",
                "goal_reached",
                "goal_confidence",
                "goal_index",
                "goal_abandoned",
                "in_distribution",
            )
            assert [reply[name] for name in fields] == [getattr(expected, name) for name in fields]
            np.testing.assert_allclose(reply["actions"], expected.actions if len(expected.actions) else HOLD, atol=1e-6)
            state, executed = expected.state, expected.actions
    again = [reply["actions"] for reply in met["episodes"]["replies"][3:]]
    np.testing.assert_allclose(again, [reply["actions"] for reply in episode], atol=1e-6)


def test_a_runtime_executes_chunks_whole_and_stops_at_the_goal(met: dict[str, Any]) -> None:
    episodes = met["episodes"]
    chunks = [action for reply in episodes["replies"] for action in reply["actions"]]
    assert episodes["steps"] == [7, 7]
    assert episodes["executed"] == [*chunks[:7], *chunks[9:16]]
    assert chunks[6:9] == HOLD


@pytest.mark.parametrize(
    ("what", "error"),
    [
        ("key", "RuntimeError: Error in inference server:\ninvalid_input: An observation for this model may hold"),
        ("shape", "`observation/front` must be uint8 of shape (4, 4, 3), as in training; got uint8 (3, 4, 4)."),
        ("goal", "The first observation must hold the goal; got none, and none in the URL. Send `prompt`, `recipe`"),
        ("model", "received 1008 (policy violation) failed_precondition: Name an active one: default."),
        ("token", "server rejected WebSocket connection: HTTP 401"),
    ],
)
def test_the_client_shows_what_is_refused(met: dict[str, Any], what: str, error: str) -> None:
    assert error in met["errors"][what]


def test_a_connection_goes_on_after_an_error(met: dict[str, Any]) -> None:
    assert met["errors"]["after"]["actions"] == met["episodes"]["replies"][0]["actions"]


def test_keys_of_other_policies_are_named_and_a_prompt_is_ignored_with_a_note(met: dict[str, Any]) -> None:
    others = met["others"]
    for name, detail in (
        ("droid", "got `observation/exterior_image_1_left`, `observation/wrist_image_left`, "),
        (
            "libero",
            "`observation/image` must be uint8 of shape (4, 4, 3), as in training; got uint8 (224, 224, 3). Add ",
        ),
    ):
        assert others[name].startswith("RuntimeError: Error in inference server:\ninvalid_input: ")
        assert detail in others[name]
    assert others["prompt"] == "`prompt` is ignored: a goal of this model is given by images."


def test_arrays_of_the_package_msgpack_numpy_are_read(met: dict[str, Any]) -> None:
    assert met["others"]["msgpack-numpy"]["actions"] == met["episodes"]["replies"][0]["actions"]
