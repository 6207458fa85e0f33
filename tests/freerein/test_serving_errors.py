"""Errors that name a client's field stay within the size limits of REST and gRPC replies."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from types import SimpleNamespace
from typing import Any

import httpx
import numpy as np
import pytest

from freerein import wire
from freerein.api.reward.v1 import reward_pb2
from freerein.clients import Channel, RewardClient
from freerein.errors import InvalidInput, ModelFault, NotFound, must_be, quoted
from freerein.serving.error_replies import close_reason
from freerein.serving.grpc_server import GrpcServer
from freerein.serving.health import Health
from freerein.serving.limits import Limits
from freerein.serving.methods import methods_of
from freerein.serving.metrics import Metrics
from freerein.serving.rest.app import make_app
from freerein.types.reward import RewardRequest


async def never(_request: Any) -> Any:
    """Answers nothing: the requests of these tests are refused while they are read."""
    raise AssertionError


CORE = SimpleNamespace(reward=never, reward_stream=never, ground=never, describe=never, embed_goal=never)
METHODS = methods_of(reward_pb2.DESCRIPTOR.services_by_name["RewardService"], CORE)
LONG = pytest.mark.parametrize("character", ["x", '"', "\\", "\n", "\x01", "é", "\u2028", "\U0001f600"], ids=ascii)


@asynccontextmanager
async def calling(methods: Any) -> AsyncIterator[RewardClient]:
    """A client of a gRPC server of these methods."""
    server = GrpcServer(methods, health=Health(), metrics=Metrics(), limits=Limits())
    port = server.server.add_insecure_port("127.0.0.1:0")
    await server.server.start()
    try:
        async with RewardClient(Channel(f"127.0.0.1:{port}")) as client:
            yield client
    finally:
        await server.server.stop(None)


@LONG
async def test_over_grpc_a_name_of_any_length_is_an_invalid_input(character: str) -> None:
    async with calling(METHODS) as client:
        with pytest.raises(InvalidInput) as error:
            await client.reward(refused(20_000 * character))
    assert error.value.field == "frames"
    assert error.value.hint


async def test_what_the_model_failed_on_is_not_sent_again() -> None:
    calls = []

    async def fail(request: Any) -> Any:
        calls.append(request)
        raise ModelFault("The model failed.")

    core = SimpleNamespace(**(vars(CORE) | {"reward": fail}))
    async with calling(methods_of(reward_pb2.DESCRIPTOR.services_by_name["RewardService"], core)) as client:
        with pytest.raises(ModelFault):
            await client.reward(RewardRequest("a red block"))
    assert len(calls) == 1


@LONG
async def test_over_rest_a_name_of_any_length_is_a_problem_of_at_most_4_kib(character: str) -> None:
    app = make_app("reward", METHODS, health=Health(), metrics=Metrics(), limits=Limits())
    transport = httpx.ASGITransport(app)
    async with httpx.AsyncClient(transport=transport, base_url="http://service") as client:
        reply = await client.post("/v1/reward", json=wire.to_json(refused(20_000 * character)))
    assert (reply.status_code, reply.json()["code"]) == (422, "invalid_input")
    assert reply.json()["field"] == "frames"
    assert len(reply.content) <= 4096


@pytest.mark.parametrize(
    ("detail", "hint", "reason"),
    [
        ("A thing is.", "Do that.", "not_found: Do that. A thing is."),
        ("A thing is.", "", "not_found: A thing is."),
        (
            "A thing that is described at " + "length and " * 10 + "so that it does not fit.",
            "Do that.",
            "not_found: Do that.",
        ),
        ("A thing is.", "Do this at a.b:1/?c.d=e first. " + "Then do that. " * 20, None),
        ("A thing is.", "word " * 50, None),
        ("A thing is.", "\u00e4" * 500, None),
    ],
)
def test_a_close_frame_has_whole_sentences_and_the_hint_first(detail: str, hint: str, reason: str | None) -> None:
    found = close_reason(NotFound(detail, hint=hint))
    assert len(found.encode()) <= 123
    assert found.startswith("not_found:")
    assert reason is None or found == reason
    assert not hint.startswith("Do this") or found.endswith("Then do that.")


def refused(camera: str) -> RewardRequest:
    """Returns a request with frames that cannot be read, of a camera of this name."""
    neither_true_nor_false = np.full((1, 4, 4, 3), 2, np.uint8).view(np.bool_)
    return RewardRequest("a red block", frames={camera: neither_true_nor_false})


def test_the_error_of_a_value_says_its_name_and_what_came_and_quotes_texts_short_and_printable() -> None:
    error = must_be("fps", "1 to 1000", quoted("a`\n" + "x" * 70))
    assert (error.field, error.detail) == ("fps", f"`fps` must be 1 to 1000; got `a??{'x' * 61}...`.")
    assert must_be("The size", "H x W", 3, field="").detail == "The size must be H x W; got 3."
