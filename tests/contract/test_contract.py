"""One contract, every service, every transport: the same request has the same answer, or the same error.

A service joins by a row in `SERVICES`: how to build it, and requests with what they must come to.
"""

import asyncio
import json
import math
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import AbstractAsyncContextManager, AsyncExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import grpc
import numpy as np
import numpy.typing as npt
import pytest
import pytest_asyncio
from google.protobuf.descriptor import Descriptor
from grpc_reflection.v1alpha import reflection_pb2, reflection_pb2_grpc
from tests.contract import dataset_cases, imitation_cases, reward_cases, run_cases

from freerein import errors, wire
from freerein.api.learning.v1 import learning_pb2
from freerein.atomic_files import write_atomic
from freerein.errors import NotFound, ServiceError
from freerein.model_store import ModelStore
from freerein.serving.fits import FitService
from freerein.serving.health import Health
from freerein.serving.lifecycle import Service
from freerein.serving.limits import Limits
from freerein.serving.methods import methods_of
from freerein.serving.metrics import Metrics
from freerein.serving.model_cache import ModelCache
from freerein.types import learning, segmentation
from freerein.types.common import ActionSpec, Camera, Image, ModelRef
from freerein.types.learning import StartFitRequest
from freerein.types.reward import RewardFrame, RewardHello, RewardStreamRequest
from freerein_segmentation.model import Prediction

Build = Callable[[Path, Health], Service]
Connect = Callable[[Build, Path], AbstractAsyncContextManager[Any]]
pytestmark = pytest.mark.asyncio(loop_scope="module")
ANSWER = ""
FIT = "33aff6d631d05c00849156bc87785527"
VERSION = "524d3f8b85d2"  # of the one model that every row publishes


@dataclass(frozen=True)
class Case:
    """One request, and the code of the error that it must come to: none for an answer."""

    method: str
    request: Any
    code: str = ANSWER

    def __str__(self) -> str:
        return f"{self.method}-{self.code or 'answer'}"


@dataclass(frozen=True)
class Row:
    """One service: how to build it in a data directory, and its cases."""

    build: Build
    cases: tuple[Case, ...]


def publish_model(root: Path, name: str = "") -> ModelStore:
    store, folder = ModelStore(root), root / "unpublished"
    folder.mkdir(parents=True)
    (folder / "card.json").write_text(json.dumps({"steps": 5, "loss": 0.25}))
    store.activate(store.publish(name, folder))
    return store


# --- the services that every learned service has


def build_learning(data_dir: Path, health: Health) -> Service:
    """Returns fits that are never started, so that they stand still, and models that are their folders' names."""
    store = publish_model(data_dir / "models")

    def resolve(dataset: str, config: Any) -> dict[str, Any]:
        if dataset != "demos":
            raise NotFound("The dataset must be there; there is none of that name.", field="dataset", hint="Make it.")
        return {"steps": 5, **config}

    models = ModelCache(store, lambda folder: folder.name, fit_command="freerein fit toy")
    fits = FitService(data_dir / "fits", module="none", store=store, models=models, resolve=resolve, health=health)
    services = learning_pb2.DESCRIPTOR.services_by_name

    async def start() -> None:
        await models.start()
        assert (await fits.start_fit(StartFitRequest("demos", "", {"rate": 0.5}, "key"))).fit.id == FIT
        write_atomic(data_dir / "fits" / FIT / "metrics.jsonl", b'{"step": 1, "loss": 0.5}\n{"step": 2, "loss": NaN}\n')

    async def close() -> None: ...

    methods = methods_of(services["FitService"], fits) + methods_of(services["ModelService"], models)
    return Service("learning", methods, start, close, models.not_ready)


LEARNING_CASES = (
    Case("StartFit", learning.StartFitRequest("demos", "mine", {"a": [1, 0.5, None, {"b": "c"}]}, "another")),
    Case("StartFit", learning.StartFitRequest("demos", "mine", {"rate": 0.5}, "key"), "already_exists"),
    Case("StartFit", learning.StartFitRequest("none"), "not_found"),
    Case("StartFit", learning.StartFitRequest(""), "invalid_input"),
    Case("StartFit", learning.StartFitRequest("../demos"), "invalid_input"),
    Case("StartFit", learning.StartFitRequest("demos", "no/where"), "invalid_input"),
    Case("GetFit", learning.GetFitRequest(FIT)),
    Case("GetFit", learning.GetFitRequest("1" * 32), "not_found"),
    Case("GetFit", learning.GetFitRequest("../x"), "invalid_input"),
    Case("ListFits", learning.ListFitsRequest()),
    Case("ListFits", learning.ListFitsRequest(1, f"1-{FIT}")),
    Case("ListFits", learning.ListFitsRequest(1001), "invalid_input"),
    Case("ListFits", learning.ListFitsRequest(0, "1" * 32), "invalid_input"),
    Case("GetFitMetrics", learning.GetFitMetricsRequest(FIT)),
    Case("GetFitMetrics", learning.GetFitMetricsRequest(FIT, 2, 1)),
    Case("GetFitMetrics", learning.GetFitMetricsRequest("1" * 32), "not_found"),
    Case("GetFitMetrics", learning.GetFitMetricsRequest(FIT, 0, 10_001), "invalid_input"),
    Case("CancelFit", learning.CancelFitRequest(FIT)),
    Case("CancelFit", learning.CancelFitRequest("1" * 32), "not_found"),
    Case("ResumeFit", learning.ResumeFitRequest("1" * 32), "not_found"),
    Case("DeleteFit", learning.DeleteFitRequest("1" * 32), "not_found"),
    Case("DeleteFit", learning.DeleteFitRequest("../x"), "invalid_input"),
    Case("WatchFit", learning.WatchFitRequest("1" * 32), "not_found"),
    Case("WatchFit", learning.WatchFitRequest("x", 3), "invalid_input"),
    Case("ListModels", learning.ListModelsRequest()),
    Case("ActivateModel", learning.ActivateModelRequest("", VERSION)),
    Case("ActivateModel", learning.ActivateModelRequest("default", VERSION, VERSION)),
    Case("ActivateModel", learning.ActivateModelRequest("default", VERSION, "0" * 12), "failed_precondition"),
    Case("ActivateModel", learning.ActivateModelRequest("default", "0" * 12), "not_found"),
    Case("ActivateModel", learning.ActivateModelRequest("", ""), "invalid_input"),
    Case("ActivateModel", learning.ActivateModelRequest("A", VERSION), "invalid_input"),
    Case("DeleteModel", learning.DeleteModelRequest("default", "0" * 12, even_active=True), "not_found"),
    Case("DeleteModel", learning.DeleteModelRequest("", even_active=True), "invalid_input"),
    Case("DeleteModel", learning.DeleteModelRequest("../x"), "invalid_input"),
)

# --- segmentation


class Halves:
    """A model of two skills: the first half of a trajectory is one, the second the other. It fails where told to."""

    skills, lag, fps = ("close", "open"), None, 10.0
    camera, action = Camera("front", 2, 3, 3), ActionSpec(2, 0, ("dy", "dz"))

    def predict(self, frames: npt.NDArray[np.uint8], actions: npt.NDArray[Any] | None) -> Prediction:
        if frames[0, 0, 0, 0] == 1:
            raise ZeroDivisionError
        likely = np.full((len(frames), 2), (0.75, 0.25), np.float32)
        likely[len(frames) // 2 :] = (0.25, 0.75)
        likely *= np.float32("nan" if frames[0, 0, 0, 0] == 2 else 1)
        return Prediction(likely, np.linspace(0, 1, len(frames), dtype=np.float32))


def build_segmentation(data_dir: Path, health: Health) -> Service:
    from freerein.serving.learned import LearnedSettings
    from freerein_segmentation.__main__ import build

    publish_model(data_dir / "models" / "segmentation")
    settings = LearnedSettings(data_dir=data_dir)
    return build(settings, Limits(), Metrics(), health, load=lambda _folder, _device: Halves())


FRAMES, ACTIONS = np.zeros((4, 2, 3, 3), np.uint8), np.zeros((4, 2), np.float32)


def segment(code: str = ANSWER, **fields: Any) -> Case:
    return Case("Segment", segmentation.SegmentRequest(**{"frames": FRAMES, "actions": ACTIONS, **fields}), code)


SEGMENTATION_CASES = (
    Case("ListSkills", segmentation.ListSkillsRequest()),
    Case("ListSkills", segmentation.ListSkillsRequest(ModelRef("default", VERSION))),
    Case("ListSkills", segmentation.ListSkillsRequest(ModelRef("other")), "failed_precondition"),
    Case("ListSkills", segmentation.ListSkillsRequest(ModelRef("", "0" * 12)), "not_found"),
    Case("ListSkills", segmentation.ListSkillsRequest(ModelRef("", "../x")), "invalid_input"),
    segment(),
    segment(model=ModelRef("default", VERSION), min_segment=2, smoothing=1.5, min_confidence=0.5, min_kept=2),
    segment(frames=None, images=(reward_cases.png(2, 3),) * 4),
    segment(frames=FRAMES[:1], actions=ACTIONS[:1]),
    segment("invalid_input", images=(reward_cases.png(2, 3),) * 4),
    segment("invalid_input", frames=None),
    segment("invalid_input", video=b"\0\0\0\x18ftypmp42"),
    segment("invalid_input", frames=None, video=b"\0\0\0\x18ftypmp42"),
    segment("unsupported_media", frames=None, video=b"GIF89a"),
    segment("invalid_input", frames=None, video=b"GIF89a", actions=ACTIONS + np.float32(1.5)),
    segment("invalid_input", frames=None, video=b"GIF89a", actions=np.array(0, np.float32)),
    segment("invalid_input", frames=None, images=(reward_cases.png(2, 3), reward_cases.png(3, 2)), actions=ACTIONS[:2]),
    segment("unsupported_media", frames=None, images=(Image("png", 0, 0, b"GIF89a"),)),
    segment("invalid_input", frames=None, images=(Image("raw_rgb8", 2, 3, b"\0"),)),
    segment("invalid_input", frames=FRAMES.astype(np.float32)),
    segment("invalid_input", frames=FRAMES[0]),
    segment("invalid_input", frames=FRAMES[:0], actions=ACTIONS[:0]),
    segment("invalid_input", frames=np.zeros((4, 2, 2, 3), np.uint8)),
    segment("invalid_input", actions=None),
    segment("invalid_input", actions=ACTIONS[:3]),
    segment("invalid_input", actions=ACTIONS.astype(np.float64)),
    segment("invalid_input", actions=ACTIONS + np.float32(math.nan)),
    segment("invalid_input", actions=ACTIONS + np.float32(1.5)),
    segment("invalid_input", min_segment=1_001),
    segment("invalid_input", min_kept=1_001),
    segment("invalid_input", smoothing=-1.0),
    segment("invalid_input", min_confidence=1.5),
    segment("invalid_input", min_confidence=-0.5),
    segment("invalid_input", fps=-1.0),
    segment("invalid_input", fps=240.5),
    segment("too_large", frames=np.zeros((20_001, 1, 1, 1), np.uint8)),
    segment("model_fault", frames=FRAMES + np.uint8(1)),
    segment("output_not_finite", frames=FRAMES + np.uint8(2)),
)

# --- imitation, reward and the orchestrator


def build_imitation(data_dir: Path, health: Health) -> Service:
    return imitation_cases.build(data_dir, health, publish_model)


def build_reward(data_dir: Path, health: Health) -> Service:
    return reward_cases.build(data_dir, health, publish_model)


def build_orchestrator(data_dir: Path, health: Health) -> Service:
    dataset_cases.record(data_dir)
    service: Service = run_cases.build(data_dir, health)
    return service


SERVICES = {
    "imitation": Row(build_imitation, tuple(Case(*case) for case in imitation_cases.cases(VERSION))),
    "learning": Row(build_learning, LEARNING_CASES),
    "orchestrator": Row(build_orchestrator, tuple(Case(*case) for case in run_cases.CASES + dataset_cases.CASES)),
    "reward": Row(build_reward, tuple(Case(*case) for case in reward_cases.cases(VERSION))),
    "segmentation": Row(build_segmentation, SEGMENTATION_CASES),
}

# --- what holds for all


@pytest_asyncio.fixture(loop_scope="module", scope="module")
async def open_service(connect: Connect, tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Any]:
    """A function that opens a service when it is first asked for."""
    opened: dict[str, Any] = {}
    async with AsyncExitStack() as stack:

        async def open_once(name: str) -> Any:
            if name not in opened:
                service = connect(SERVICES[name].build, tmp_path_factory.mktemp(name))
                opened[name] = await stack.enter_async_context(service)
            return opened[name]

        yield open_once


@pytest_asyncio.fixture(loop_scope="module", params=SERVICES)
async def transports(request: pytest.FixtureRequest, open_service: Any) -> Any:
    """Each service, shared by the tests of this module."""
    return await open_service(request.param)


@pytest_asyncio.fixture(loop_scope="module")
async def learning_service(connect: Connect, tmp_path: Path) -> AsyncIterator[Any]:
    """The services of every learned service, with one queued fit."""
    async with connect(build_learning, tmp_path) as opened:
        yield opened


@pytest.mark.parametrize(
    ("transports", "case"),
    [pytest.param(name, case, id=f"{name}-{case}") for name, row in SERVICES.items() for case in row.cases],
    indirect=["transports"],
)
async def test_a_request_has_the_same_outcome_over_every_transport(transports: Any, case: Case) -> None:
    outcome = await transports.outcome(case.method, case.request)
    assert isinstance(outcome, list) == (case.code == ANSWER)
    if case.code != ANSWER:
        assert outcome[0] == case.code
        assert outcome[3], "an error says how to mend it"
        assert case.code not in ("invalid_input", "not_found") or outcome[1], "an error names the field at fault"


async def test_events_are_equal_over_every_transport_and_can_be_resumed(learning_service: Any) -> None:
    transports = learning_service
    await transports.core(transports.method("CancelFit"), learning.CancelFitRequest(FIT))
    for first in (0, 1):
        events = await transports.outcome("WatchFit", learning.WatchFitRequest(FIT, first))
        assert [event["sequence"] for event in events] == [0, 1][first:]


async def test_every_rpc_is_reachable_over_rest_and_grpc(transports: Any) -> None:
    paths = transports.document["paths"]
    for method in transports.methods:
        if method.rest_form != "none":
            assert list(paths[method.path]) == ["get" if method.reads else "post"]
        path = f"/{method.descriptor.containing_service.full_name}/{method.name}"
        call = transports.channel.stream_stream(path)(iter([b"\xff"]))
        with pytest.raises(grpc.aio.AioRpcError) as error:
            await call.read()
        assert error.value.code() is grpc.StatusCode.INVALID_ARGUMENT
        assert "could not be read" in error.value.details()


async def test_reflection_lists_what_the_grpc_server_serves(transports: Any) -> None:
    stub = reflection_pb2_grpc.ServerReflectionStub(transports.channel)
    request = reflection_pb2.ServerReflectionRequest(list_services="")
    reply = await stub.ServerReflectionInfo(iter([request])).read()
    names = {found.name for found in reply.list_services_response.service}
    assert names >= {method.descriptor.containing_service.full_name for method in transports.methods}
    assert "grpc.health.v1.Health" in names


async def test_the_openapi_document_is_valid_and_has_the_fields_of_the_proto(
    transports: Any,
) -> None:
    import schemathesis

    document = transports.document
    schemathesis.openapi.from_dict(document).validate()
    schemas = document["components"]["schemas"]
    served = [method for method in transports.methods if method.rest_form != "none"]
    assert set(document["paths"]) == {method.path for method in served}
    for described in (each for name, each in schemas.items() if name not in ("Problem", "JsonValue")):
        assert described["description"]
        assert all(each["description"] for each in described.get("properties", {}).values())
    for method in served:
        operation = document["paths"][method.path]["get" if method.reads else "post"]
        assert operation["summary"]
        if method.reads:
            assert [p["name"] for p in operation["parameters"]] == list(_leaves(method.descriptor.input_type))
            assert all(parameter["description"] for parameter in operation["parameters"])
        else:
            assert list(schemas[method.request.__name__]["properties"]) == _names(method.descriptor.input_type)
        if not method.descriptor.server_streaming:
            assert list(schemas[method.response.__name__].get("properties", {})) == _names(
                method.descriptor.output_type
            )


async def test_words_that_the_reward_models_do_not_know_are_named_and_asked_back(
    open_service: Any,
) -> None:
    transports = await open_service("reward")
    goal, phrases = "Put more zeppelins on less, zeppelins!", ("a red zeppelin", "a block")
    requests = [
        reward_cases.reward(goal_text=goal),
        reward_cases.embed_goal(goal),
        reward_cases.ground(phrases=phrases),
        reward_cases.describe(phrases=phrases),
    ]
    for transport in transports.all:
        answers = [(await transport(transports.method(name), request))[0] for name, request, _ in requests]
        named = [answer.unknown for answer in answers]
        assert named == [("zeppelins",), ("zeppelins",), ("zeppelin",), ("zeppelin",)]
        assert not answers[0].rewards.any()
        assert answers[0].did_you_mean == answers[1].did_you_mean == "more on top of less"


REWARDS = [case for case in SERVICES["reward"].cases if case.method == "Reward" and len(case.request.images) < 2]


@pytest.mark.parametrize("case", REWARDS, ids=str)
async def test_a_reward_stream_answers_or_refuses_as_reward_does(open_service: Any, case: Case) -> None:
    transports = await open_service("reward")
    asked = case.request
    alone = replace(asked, frames={camera: each[:1] for camera, each in asked.frames.items()})
    hello = RewardHello(asked.goal_text, asked.rivals, asked.mode, asked.model)
    frame = RewardFrame(0, {camera: each[0] for camera, each in asked.frames.items()}, asked.images)
    sent = [RewardStreamRequest(hello), RewardStreamRequest(frame=frame)]
    for transport in (transports.core, transports.grpc):
        try:
            opened, reply = await transport(transports.method("RewardStream"), sent)
            code = reply.error.code if reply.error else ANSWER
        except ServiceError as error:
            code = error.code
        assert code == case.code
        if code == ANSWER:
            (expected,) = await transport(transports.method("Reward"), alone)
            found = reply.reward.reward, reply.reward.similarity, reply.reward.winner, reply.reward.in_distribution
            parts = expected.rewards, expected.similarities, expected.winners, expected.in_distribution
            assert found == tuple(part[0] for part in parts)
            assert (opened.opened.texts, opened.opened.unknown) == (expected.texts, expected.unknown)


def _names(message: Descriptor) -> list[str]:
    return [field.name for field in message.fields]


def _leaves(message: Descriptor, prefix: str = "") -> Iterator[str]:
    for field in message.fields:
        if field.message_type is None:
            yield prefix + field.name
        else:
            yield from _leaves(field.message_type, f"{prefix}{field.name}.")


async def test_rest_and_grpc_keep_a_deadline(learning_service: Any) -> None:
    transports = learning_service
    path = "/freerein.api.learning.v1.FitService/WatchFit"
    request = wire.pack(learning.WatchFitRequest(FIT, 1)).SerializeToString()
    with pytest.raises(grpc.aio.AioRpcError) as error:
        await transports.channel.unary_stream(path)(request, timeout=0.1).read()
    assert error.value.code() is grpc.StatusCode.DEADLINE_EXCEEDED
    with pytest.raises(TimeoutError):
        await asyncio.wait_for(transports.rest(transports.method("WatchFit"), learning.WatchFitRequest(FIT, 1)), 0.1)


async def test_a_watcher_that_disconnects_before_an_event_is_released(learning_service: Any) -> None:
    transports = learning_service
    arriving = [{"type": "http.request", "body": b"", "more_body": False}, {"type": "http.disconnect"}]
    sent: list[Any] = []

    async def receive() -> Any:
        return arriving.pop(0)

    async def send(message: Any) -> None:
        sent.append(message)

    query = f"id={FIT}&from_sequence=1".encode()
    scope = {"type": "http", "method": "GET", "path": "/v1/watch-fit", "query_string": query, "headers": []}
    await transports.app(scope, receive, send)
    assert sent[0]["status"] == 499


ERRORS = [cls for cls in vars(errors).values() if isinstance(cls, type) and issubclass(cls, ServiceError)]


@pytest_asyncio.fixture(loop_scope="module", scope="module")
async def raising(connect: Connect, tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[tuple[list[Any], Any]]:
    """A list with the exception that a service raises, and the service's transports."""
    raised: list[Exception] = []

    async def refuse(_request: object) -> None:
        raise raised[0]

    async def nothing() -> None: ...

    core = SimpleNamespace(list_models=refuse, activate_model=refuse, delete_model=refuse)
    methods = methods_of(learning_pb2.DESCRIPTOR.services_by_name["ModelService"], core)
    service = Service("raising", methods, nothing, nothing, lambda: "")
    async with connect(lambda _data_dir, _health: service, tmp_path_factory.mktemp("raising")) as opened:
        yield raised, opened


@pytest.mark.parametrize("cls", [cls for cls in ERRORS if cls is not ServiceError], ids=lambda cls: cls.code)
async def test_every_error_keeps_its_class_over_every_transport(
    raising: tuple[list[Any], Any], cls: type[ServiceError]
) -> None:
    raised, transports = raising
    raised[:] = [cls("Expected this; got that.", field="name", hint="Send this.")]
    for transport in transports.all:
        with pytest.raises(ServiceError) as caught:
            await transport(transports.method("ListModels"), learning.ListModelsRequest())
        assert type(caught.value) is cls
        assert (caught.value.detail, caught.value.field) == ("Expected this; got that.", "name")
        assert caught.value.hint == "Send this."
    with pytest.raises(grpc.aio.AioRpcError) as status:
        await transports.channel.unary_unary("/freerein.api.learning.v1.ModelService/ListModels")(b"")
    assert status.value.code().name == cls.grpc_status


async def test_a_bug_is_an_internal_error_without_details_over_rest_and_grpc(
    raising: tuple[list[Any], Any], caplog: pytest.LogCaptureFixture
) -> None:
    raised, transports = raising
    raised[:] = [KeyError("secret")]
    for transport in (transports.rest, transports.grpc):
        with pytest.raises(errors.Internal) as caught:
            await transport(transports.method("ListModels"), learning.ListModelsRequest())
        assert "secret" not in caught.value.detail + caught.value.hint
    assert [record.message for record in caplog.records if record.exc_info] == ["bug", "bug"]
