"""The examples of the OpenAPI documents are answered as they stand, as JSON and as multipart."""

import importlib
import io
import json
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import AbstractAsyncContextManager, AsyncExitStack
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import PIL.Image
import pytest
import pytest_asyncio

from freerein.serving.health import Health
from freerein.serving.lifecycle import Service
from freerein.serving.limits import Limits
from freerein.serving.metrics import Metrics
from freerein.serving.rest.examples import ID, JOB, example_parts

pytestmark = pytest.mark.asyncio(loop_scope="module")
SIM = ("Reset", "Step", "Render", "Snapshot", "Restore", "DrawRecipes", "Check", "ExpertActions", "CloseSession")
SHIPPED = {
    "imitation": ("Act", "ActivateModel"),
    "reward": ("Reward", "Ground", "Describe", "EmbedGoal", "ActivateModel"),
    "segmentation": ("Segment", "ActivateModel"),
}


def build_sim(_data_dir: Path, health: Health) -> Service:
    from freerein_sim.__main__ import build
    from freerein_sim.settings import SimSettings

    return build(SimSettings(sim_workers=1), Limits(), Metrics(), health)


def build_learned(name: str, data_dir: Path, health: Health) -> Service:
    from freerein_reward.settings import RewardSettings  # whose fields the others have, but for one

    build = importlib.import_module(f"freerein_{name}.__main__").build
    service: Service = build(RewardSettings(data_dir=data_dir, device="cpu"), Limits(), Metrics(), health)
    return service


BUILD = {"sim": build_sim, **{name: partial(build_learned, name) for name in SHIPPED}}


class Door:
    """The REST API of a service: sends the example of an RPC."""

    def __init__(self, opened: Any, service: str) -> None:
        self._opened, self._service = opened, service
        transport = httpx.ASGITransport(opened.app, raise_app_exceptions=False)
        self._client = httpx.AsyncClient(transport=transport, base_url="http://service")
        self.document = opened.document

    async def send_json(self, name: str, changes: Mapping[str, Any], **options: Any) -> httpx.Response:
        method = self._opened.method(name)
        content = self.document["paths"][method.path]["post"]["requestBody"]["content"]
        example = content["application/json"]["example"]
        return await self._client.post(
            method.path, json={**example, **{k: v for k, v in changes.items() if k in example}}, **options
        )

    async def send_parts(self, name: str, changes: Mapping[str, Any]) -> httpx.Response:
        method = self._opened.method(name)
        files = []
        for part, content in example_parts(method, self._service):
            changed = changes.get(part, content)
            files.append((part, (None, changed) if isinstance(changed, str) else ("frame.png", changed, "image/png")))
        return await self._client.post(method.path, files=files)


@pytest_asyncio.fixture(loop_scope="module", scope="module")
async def open_door(
    connect: Callable[..., AbstractAsyncContextManager[Any]], tmp_path_factory: pytest.TempPathFactory
) -> AsyncIterator[Any]:
    doors: dict[str, Door] = {}
    async with AsyncExitStack() as stack:

        async def open_once(name: str) -> Door:
            if name not in doors:
                opened = await stack.enter_async_context(connect(BUILD[name], tmp_path_factory.mktemp(name)))
                doors[name] = Door(opened, name)
            return doors[name]

        yield open_once


def answered(reply: httpx.Response) -> Any:
    assert reply.status_code == 200, reply.text
    return reply.json()


@pytest.mark.parametrize(("service", "name"), [(service, name) for service, names in SHIPPED.items() for name in names])
async def test_an_example_is_answered_by_a_shipped_model(open_door: Any, service: str, name: str) -> None:
    door = await open_door(service)
    as_json, as_parts = answered(await door.send_json(name, {})), answered(await door.send_parts(name, {}))
    assert {**as_json, "timing": None} == {**as_parts, "timing": None}


async def test_what_the_examples_show_is_seen(open_door: Any) -> None:
    door = await open_door("reward")
    grounded = answered(await door.send_json("Ground", {}))
    red, blue, dog = grounded["groundings"]
    assert red["x"] < 32 < blue["x"]
    assert (red["presence"] > 0.5, blue["presence"] > 0.5, dog["presence"]) == (True, True, 0)
    assert grounded["unknown_phrases"] == [{"phrase": "a dog", "words": ["dog"]}]
    assert answered(await door.send_json("Describe", {}))["descriptions"][0]["captions"]


async def test_the_examples_of_sim_are_a_session(open_door: Any) -> None:
    door = await open_door("sim")
    for send in (door.send_json, door.send_parts):
        changes = {"session": answered(await send("CreateSession", {}))["session"]}
        for name in SIM:
            reply = answered(await send(name, changes))
            if name == "Snapshot":
                changes["snapshot"] = reply["snapshot"]


async def test_a_step_answers_with_lists_and_render_with_a_picture(open_door: Any) -> None:
    door = await open_door("sim")
    changes = {"session": answered(await door.send_json("CreateSession", {}))["session"]}
    answered(await door.send_json("Reset", changes))
    stepped = answered(await door.send_json("Step", changes, params={"tensors": "list"}))
    assert stepped["reward"] == [0.0, 0.0]
    assert np.shape(stepped["truth"]["state"])[0] == 2
    reply = await door.send_json("Render", changes, headers={"accept": "image/png"})
    assert reply.headers["content-type"] == "image/png"
    picture = np.asarray(PIL.Image.open(io.BytesIO(reply.content)))
    ((camera, frames),) = answered(await door.send_json("Render", changes, params={"tensors": "list"}))[
        "frames"
    ].items()
    assert camera
    pixels = np.array(frames, np.uint8)
    assert np.array_equal(picture, np.concatenate(list(pixels)))
    refused = await door.send_json("Step", changes, params={"tensors": "csv"})
    assert (refused.status_code, refused.json()["field"]) == (422, "tensors")


async def test_every_request_of_the_documents_has_an_example_with_a_command(open_door: Any) -> None:
    for service in BUILD:
        document = (await open_door(service)).document
        for path, operations in document["paths"].items():
            for operation in operations.values():
                content = operation.get("requestBody", {}).get("content", {})
                assert all(each["example"] is not None for each in content.values())
                assert f"http://service{path}" in operation["description"]
                required = [each for each in operation.get("parameters", []) if each["name"] == "id"]
                assert all(each["example"] == JOB for each in required)
                example = content.get("application/json", {}).get("example", {})
                assert (ID in example.values()) == ("\n\nReplace `" in operation["description"])
        assert json.dumps(document)
