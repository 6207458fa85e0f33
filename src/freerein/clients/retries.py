"""Which calls are made again when a service is unavailable: those that may be made twice, and no others.

gRPC itself does it, told by a service config: at most four attempts, with jittered exponential backoff, the same
request id and within the one deadline of the call. A token bucket per service stops the retries of a client most of
whose calls fail, so that an outage is not made worse by those who wait for its end.
"""

import json

IDEMPOTENT = {
    "freerein.api.imitation.v1.ImitationService": ("GetSpec", "Act"),
    "freerein.api.learning.v1.FitService": ("StartFit", "GetFit", "ListFits", "WatchFit", "GetFitMetrics", "CancelFit"),
    "freerein.api.learning.v1.ModelService": ("ListModels",),
    "freerein.api.reward.v1.RewardService": ("Reward", "Ground", "Describe", "EmbedGoal"),
    "freerein.api.orchestrator.v1.OrchestratorService": (
        "StartRun",
        "GetRun",
        "ListRuns",
        "WatchRun",
        "GetMetrics",
        "CancelRun",
        "ListArtifacts",
        "GetArtifact",
    ),
    "freerein.api.segmentation.v1.SegmentationService": ("Segment", "ListSkills"),
    "freerein.api.sim.v1.SimService": (
        "ListTasks",
        "CreateSession",
        "Step",
        "Render",
        "Snapshot",
        "Restore",
        "Demonstrate",
        "CloseSession",
    ),
}
"""By service: the calls whose repetition changes nothing.

`StartFit`, `StartRun` and `CreateSession` are among them because clients always send an idempotency key, `Step` because
of its `step_id`. `Reset` is not: it draws from the generators. `ActivateModel` and `ResumeRun` are not: their second
attempt would not find what they expect. A stream is begun again only while nothing of it has arrived; `Connect` and
`Control` never.
"""

MAX_ATTEMPTS = 4

_RETRY_POLICY = {
    "maxAttempts": MAX_ATTEMPTS,
    "initialBackoff": "0.1s",
    "backoffMultiplier": 3,
    "maxBackoff": "1s",
    "retryableStatusCodes": ["UNAVAILABLE"],
}
_RETRY_THROTTLING = {"maxTokens": 100, "tokenRatio": 0.1}


def service_config() -> str:
    """Returns gRPC's service config, as JSON."""
    names = [{"service": service, "method": method} for service, methods in IDEMPOTENT.items() for method in methods]
    return json.dumps(
        {
            "methodConfig": [{"name": names, "retryPolicy": _RETRY_POLICY}],
            "retryThrottling": _RETRY_THROTTLING,
        }
    )
