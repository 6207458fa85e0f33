"""`freerein imitate` as a user types it, with the real services and a shipped model."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest
from typer.testing import CliRunner, Result

from freerein.cli.__main__ import app
from freerein.clients import Channel, SimClient, SyncClient
from freerein.types.sim import CloseSessionRequest, CreateSessionRequest, ResetRequest, StepRequest

pytestmark = pytest.mark.e2e
SEED = "7"


@pytest.fixture(scope="module")
def addresses(start_module_service: Callable[..., Any]) -> dict[str, str]:
    modules = {"SIM": "freerein_sim", "IMITATION": "freerein_imitation"}
    return {f"FREEREIN_{name}_ADDRESS": start_module_service(module).address for name, module in modules.items()}


@pytest.fixture(scope="module")
def demo(addresses: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of two images, after five and twelve actions of an episode in `blocks`."""
    folder, rng = tmp_path_factory.mktemp("demo"), np.random.default_rng(0)
    sim = SyncClient(SimClient(Channel(addresses["FREEREIN_SIM_ADDRESS"])))
    session = sim.create_session(CreateSessionRequest("blocks", num_envs=1, seed=int(SEED))).session
    sim.reset(ResetRequest(session))
    for step in range(1, 13):
        action = rng.uniform(-1, 1, (1, 3)).astype(np.float32)
        reply = sim.step(StepRequest(session, step, action, cameras=("front",)))
        if step in (5, 12):
            PIL.Image.fromarray(reply.frames["front"][0]).save(folder / f"{step}.png")
    sim.close_session(CloseSessionRequest(session))
    sim.close()
    return folder


@pytest.fixture
def imitate(addresses: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> Callable[..., Result]:
    for variable, value in addresses.items():
        monkeypatch.setenv(variable, value)
    return lambda *words: CliRunner().invoke(app, ["imitate", *map(str, words)])


def test_images_are_ticked_off_and_pictures_show_how(
    imitate: Callable[..., Result], demo: Path, tmp_path: Path
) -> None:
    ran = imitate("--world", "blocks", "--demo", demo, "--seed", SEED, "--to", tmp_path / "made", "--json")
    assert ran.exit_code == 0, ran.output
    *landmarks, result = map(json.loads, ran.stdout.splitlines())
    assert [each["index"] for each in landmarks] == [0, 1]
    assert all(0 < each["step"] <= result["actions"] for each in landmarks)
    assert (result["landmarks"], result["reached"]) == (2, sum(each["reached"] for each in landmarks))

    with PIL.Image.open(tmp_path / "made" / "imitation.png") as strip:
        edges = {strip.getpixel((x, strip.height - 6)) for x in range(strip.width)}
    assert ((46, 160, 67) in edges) == bool(result["reached"])
    with PIL.Image.open(tmp_path / "made" / "imitation.gif") as film:
        assert getattr(film, "n_frames", 1) == result["actions"] + 1


def test_actions_that_are_used_up_end_it_whatever_the_sizes_of_images(
    imitate: Callable[..., Result], demo: Path, tmp_path: Path
) -> None:
    photos = tmp_path / "photos"
    photos.mkdir()
    for name, size in (("2.png", (160, 120)), ("10.png", (120, 160))):
        PIL.Image.open(demo / "5.png").resize(size).save(photos / name)
    begun = ("--seed", SEED, "--path", "move-red", "--steps", 2)
    ran = imitate("--task", "blocks", "--demo", photos, "--resize", "fit", *begun, "--to", tmp_path)
    assert ran.exit_code == 0, ran.output
    assert "in 2 actions: 2 actions were executed" in ran.stdout.replace("\n", " ")


def test_what_cannot_be_followed_is_refused(imitate: Callable[..., Result], demo: Path, tmp_path: Path) -> None:
    for words, said in (
        (("--world", "grid", "--demo", demo), "it sees `front`"),
        (("--world", "blocks", "--demo", demo, "--model", "skills"), "follows a recipe"),
        (("--world", "blocks", "--demo", demo, "--path", "fly"), "skills among"),
        (("--world", "blocks", "--demo", tmp_path), "a folder of PNG, JPEG or WebP"),
        (("--world", "nowhere", "--demo", demo), "got `nowhere`"),
        (("--world", "blocks", "--demo", demo, "--demo", demo / "5.png"), "of one length"),
    ):
        ran = imitate(*words, "--to", tmp_path)
        assert ran.exit_code == 1
        assert said in " ".join(ran.stderr.split())
        assert not list(tmp_path.iterdir())
