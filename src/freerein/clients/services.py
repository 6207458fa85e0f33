"""The client of each service. Its methods are the service's RPCs, which `proto/` documents."""

from freerein.clients.rpc import Client, ServerStreamRpc, StreamRpc, UnaryRpc
from freerein.clients.segment_rpc import SegmentRpc
from freerein.types import imitation, learning, orchestrator, segmentation, sim
from freerein.types import reward as rewards


class SimClient(Client):
    """Client of the sim service."""

    list_tasks = UnaryRpc(sim.ListTasksRequest, sim.ListTasksResponse)
    create_session = UnaryRpc(sim.CreateSessionRequest, sim.CreateSessionResponse)
    reset = UnaryRpc(sim.ResetRequest, sim.ResetResponse)
    step = UnaryRpc(sim.StepRequest, sim.StepResponse)
    connect = StreamRpc(sim.ConnectRequest, sim.ConnectResponse)
    """A third of a millisecond faster per step than `step`, but without retries and deadlines. A reply with `draining`
    is unsolicited."""
    render = UnaryRpc(sim.RenderRequest, sim.RenderResponse)
    snapshot = UnaryRpc(sim.SnapshotRequest, sim.SnapshotResponse)
    restore = UnaryRpc(sim.RestoreRequest, sim.RestoreResponse)
    demonstrate = ServerStreamRpc(sim.DemonstrateRequest, sim.DemonstrateResponse)
    draw_recipes = UnaryRpc(sim.DrawRecipesRequest, sim.DrawRecipesResponse)
    check = UnaryRpc(sim.CheckRequest, sim.CheckResponse)
    expert_actions = UnaryRpc(sim.ExpertActionsRequest, sim.ExpertActionsResponse)
    close_session = UnaryRpc(sim.CloseSessionRequest, sim.CloseSessionResponse)


class SegmentationClient(Client):
    """Client of the segmentation service."""

    segment = SegmentRpc(segmentation.SegmentRequest, segmentation.SegmentResponse)
    """Sends a trajectory that is too large for one request as a stream, where the model has streams."""
    segment_stream = StreamRpc(segmentation.SegmentStreamRequest, segmentation.SegmentStreamResponse)
    """First the model; then labels or an error for each message with timesteps; then the labels that are left. Never
    retried; a reply with `draining` is unsolicited."""
    list_skills = UnaryRpc(segmentation.ListSkillsRequest, segmentation.ListSkillsResponse)


class ImitationClient(Client):
    """Client of the imitation service."""

    get_spec = UnaryRpc(imitation.GetSpecRequest, imitation.GetSpecResponse)
    act = UnaryRpc(imitation.ActRequest, imitation.ActResponse)
    act_batch = UnaryRpc(imitation.ActBatchRequest, imitation.ActBatchResponse)
    control = StreamRpc(imitation.ControlRequest, imitation.ControlResponse)
    """First the spec; then a chunk or an error for each observation that no newer one overtook. Never retried; a reply
    with `draining` is unsolicited."""
    publish_policy = UnaryRpc(imitation.PublishPolicyRequest, imitation.PublishPolicyResponse)


class RewardClient(Client):
    """Client of the reward service."""

    reward = UnaryRpc(rewards.RewardRequest, rewards.RewardResponse)
    reward_stream = StreamRpc(rewards.RewardStreamRequest, rewards.RewardStreamResponse)
    """First how the goal text was read; then a reward or an error for each frame. Never retried; a reply with
    `draining` is unsolicited."""
    ground = UnaryRpc(rewards.GroundRequest, rewards.GroundResponse)
    describe = UnaryRpc(rewards.DescribeRequest, rewards.DescribeResponse)
    embed_goal = UnaryRpc(rewards.EmbedGoalRequest, rewards.EmbedGoalResponse)


class OrchestratorClient(Client):
    """Client of the orchestrator."""

    start_run = UnaryRpc(orchestrator.StartRunRequest, orchestrator.StartRunResponse)
    get_run = UnaryRpc(orchestrator.GetRunRequest, orchestrator.GetRunResponse)
    list_runs = UnaryRpc(orchestrator.ListRunsRequest, orchestrator.ListRunsResponse)
    watch_run = ServerStreamRpc(orchestrator.WatchRunRequest, orchestrator.WatchRunResponse)
    get_metrics = UnaryRpc(orchestrator.GetMetricsRequest, orchestrator.GetMetricsResponse)
    cancel_run = UnaryRpc(orchestrator.CancelRunRequest, orchestrator.CancelRunResponse)
    resume_run = UnaryRpc(orchestrator.ResumeRunRequest, orchestrator.ResumeRunResponse)
    delete_run = UnaryRpc(orchestrator.DeleteRunRequest, orchestrator.DeleteRunResponse)
    list_artifacts = UnaryRpc(orchestrator.ListArtifactsRequest, orchestrator.ListArtifactsResponse)
    get_artifact = ServerStreamRpc(orchestrator.GetArtifactRequest, orchestrator.GetArtifactResponse)
    list_datasets = UnaryRpc(orchestrator.ListDatasetsRequest, orchestrator.ListDatasetsResponse)
    list_dataset_problems = UnaryRpc(orchestrator.ListDatasetProblemsRequest, orchestrator.ListDatasetProblemsResponse)
    get_trajectory = UnaryRpc(orchestrator.GetTrajectoryRequest, orchestrator.GetTrajectoryResponse)
    get_frames = UnaryRpc(orchestrator.GetFramesRequest, orchestrator.GetFramesResponse)
    save_labels = UnaryRpc(orchestrator.SaveLabelsRequest, orchestrator.SaveLabelsResponse)


class FitClient(Client):
    """Client of `FitService`, which every learned service has."""

    start_fit = UnaryRpc(learning.StartFitRequest, learning.StartFitResponse)
    get_fit = UnaryRpc(learning.GetFitRequest, learning.GetFitResponse)
    list_fits = UnaryRpc(learning.ListFitsRequest, learning.ListFitsResponse)
    watch_fit = ServerStreamRpc(learning.WatchFitRequest, learning.WatchFitResponse)
    get_fit_metrics = UnaryRpc(learning.GetFitMetricsRequest, learning.GetFitMetricsResponse)
    cancel_fit = UnaryRpc(learning.CancelFitRequest, learning.CancelFitResponse)
    resume_fit = UnaryRpc(learning.ResumeFitRequest, learning.ResumeFitResponse)
    delete_fit = UnaryRpc(learning.DeleteFitRequest, learning.DeleteFitResponse)


class ModelClient(Client):
    """Client of `ModelService`, which every learned service has."""

    list_models = UnaryRpc(learning.ListModelsRequest, learning.ListModelsResponse)
    activate_model = UnaryRpc(learning.ActivateModelRequest, learning.ActivateModelResponse)
    delete_model = UnaryRpc(learning.DeleteModelRequest, learning.DeleteModelResponse)
