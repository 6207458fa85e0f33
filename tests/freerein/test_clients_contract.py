"""The clients against the contract: every call is there, and its retries were thought about."""

import re

from freerein import wire
from freerein.api.imitation.v1 import imitation_pb2
from freerein.api.learning.v1 import learning_pb2
from freerein.api.orchestrator.v1 import orchestrator_pb2
from freerein.api.reward.v1 import reward_pb2
from freerein.api.segmentation.v1 import segmentation_pb2
from freerein.api.sim.v1 import sim_pb2
from freerein.clients import (
    FitClient,
    ImitationClient,
    ModelClient,
    OrchestratorClient,
    RewardClient,
    SegmentationClient,
    SimClient,
    retry_policy,
)
from freerein.clients.rpc import Rpc, ServerStreamRpc, StreamRpc, UnaryRpc

CLIENTS = (
    SegmentationClient,
    ImitationClient,
    RewardClient,
    SimClient,
    OrchestratorClient,
    FitClient,
    ModelClient,
)
SERVICES = [
    service
    for module in (imitation_pb2, learning_pb2, orchestrator_pb2, reward_pb2, segmentation_pb2, sim_pb2)
    for service in module.DESCRIPTOR.services_by_name.values()
]


def test_a_client_has_a_method_for_every_call_and_no_other() -> None:
    services = {service.name.removesuffix("Service"): service for service in SERVICES}
    for client in CLIENTS:
        calls = services[client.__name__.removesuffix("Client")].methods_by_name
        methods = {name: rpc for name, rpc in vars(client).items() if isinstance(rpc, Rpc)}
        assert set(methods) == {re.sub(r"(?<=[a-z])(?=[A-Z])", "_", call).lower() for call in calls}
        for name, rpc in methods.items():
            assert rpc.descriptor in calls.values()
            assert rpc.descriptor.name.lower() == name.replace("_", "")
            assert rpc.descriptor.output_type is wire.descriptor_of(rpc.response)
            kind = rpc.descriptor.client_streaming, rpc.descriptor.server_streaming
            kinds = {(False, False): UnaryRpc, (False, True): ServerStreamRpc, (True, True): StreamRpc}
            assert isinstance(rpc, kinds[kind])


def test_every_call_is_idempotent_or_known_not_to_be() -> None:
    calls = {(service.full_name, method) for service in SERVICES for method in service.methods_by_name}
    idempotent = {(service, method) for service, methods in retry_policy.IDEMPOTENT.items() for method in methods}
    assert {method for _, method in calls - idempotent} == {
        "Reset",
        "ExpertActions",
        "Connect",
        "Control",
        "SegmentStream",
        "RewardStream",
        "ActivateModel",
        "DeleteFit",
        "DeleteModel",
        "DeleteRun",
        "ResumeFit",
        "ResumeRun",
    }
    assert idempotent < calls
