"""Retries of idempotent calls while a service is unavailable, done by gRPC from a service config.

At most four attempts with jittered exponential backoff, under one request id and one deadline. A token bucket per
service stops retries while most calls fail.
"""

import json

IDEMPOTENT = {
    "freerein.api.imitation.v1.ImitationService": ("GetSpec", "Act", "ActBatch", "PublishPolicy"),
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
        "ListDatasets",
        "ListDatasetProblems",
        "GetTrajectory",
        "GetFrames",
        "SaveLabels",
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
        "DrawRecipes",
        "Check",
        "CloseSession",
    ),
}
"""Idempotent calls by service.

`StartFit`, `StartRun` and `CreateSession` are idempotent because clients always send an idempotency key, `Step` because
of its `step_id`. `Reset` is not: it draws from the generators; nor `ExpertActions`, which advances the experts; nor are
`ActivateModel`, `ResumeFit`, `ResumeRun` and those that delete, which expect the state before them. A stream is
retried only before its first message; `Connect`, `Control`, `SegmentStream` and `RewardStream` never.
"""

MAX_ATTEMPTS = 4

_RETRY_POLICY = {
    "maxAttempts": MAX_ATTEMPTS,
    "initialBackoff": "0.1s",
    "backoffMultiplier": 3,
    "maxBackoff": "1s",
    "retryableStatusCodes": ["UNAVAILABLE", "CANCELLED"],  # the latter by a server that stops, never by the caller
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
