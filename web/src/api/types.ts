// Types of the REST API, made by `npm run types` from the services' OpenAPI documents. Not to be edited.

/** A request: what is left out has its default. */
export type Sent<T> = T extends readonly (infer Item)[]
  ? readonly Sent<Item>[]
  : T extends object
    ? { [Key in keyof T]?: Sent<T[Key]> }
    : T;

export interface ActBatchRequest {
  requests: readonly ActRequest[];
}

export interface ActBatchResponse {
  responses: readonly ActResponse[];
}

export interface ActRequest {
  model: ModelRef | null;
  observation: Observation | null;
  executed_actions: Tensor | readonly unknown[] | null;
  goal: Goal | null;
  state: string;
  max_steps_per_goal: number;
  resize: "fit" | "crop" | null;
}

export interface ActResponse {
  actions: Tensor | readonly unknown[] | null;
  goal_reached: boolean | null;
  goal_confidence: number;
  goal_index: number;
  goal_abandoned: boolean;
  state: string;
  model: ModelRef | null;
  timing: Timing | null;
  in_distribution: number;
  resized: boolean;
  done: "no" | "yes" | "unknown" | null;
  done_by: "policy" | "step_limit" | null;
}

export interface ActionSpec {
  size: number;
  choices: number;
  names: readonly string[];
  unit: string;
  scale: readonly number[];
  absolute: boolean;
  hold: number | null;
}

export interface ActivateModelRequest {
  name: string;
  version: string;
  expected_current: string;
}

export interface ActivateModelResponse {
  model: Model | null;
}

export interface Artifact {
  name: string;
  size: number;
  time_ns: number;
}

export interface Camera {
  name: string;
  height: number;
  width: number;
  channels: number;
}

export interface CancelFitRequest {
  id: string;
}

export interface CancelFitResponse {
  fit: Fit | null;
}

export interface CancelRunRequest {
  id: string;
}

export interface CancelRunResponse {
  run: Run | null;
}

export interface CheckRequest {
  session: string;
  predicate: string;
  states: Tensor | readonly unknown[] | null;
  references: Tensor | readonly unknown[] | null;
}

export interface CheckResponse {
  holds: Tensor | readonly unknown[] | null;
  values: Tensor | readonly unknown[] | null;
}

export interface CloseSessionRequest {
  session: string;
}

export interface CloseSessionResponse {

}

export interface CreateSessionRequest {
  task: string;
  num_envs: number;
  seed: number | null;
  lease_s: number;
  height: number;
  width: number;
  privileged: boolean;
  idempotency_key: string;
  conditions: readonly string[];
  max_episode_steps: number;
}

export interface CreateSessionResponse {
  session: string;
  seed: number;
  num_envs: number;
  task: Task | null;
  lease_s: number;
}

export interface Dataset {
  name: string;
  goal_text: string;
  cameras: readonly Camera[];
  fps: number;
  action: ActionSpec | null;
  skills: readonly string[];
  tags: Readonly<Record<string, number>>;
  trajectories: number;
  timesteps: number;
  labelled_by: ModelRef | null;
  hand_labelled: number;
  with_truth: number;
  time_ns: number;
  error: string;
}

export interface DatasetProblem {
  subject: string;
  detail: string;
  hint: string;
  severity: "error" | "warning";
}

export interface DeleteFitRequest {
  id: string;
}

export interface DeleteFitResponse {

}

export interface DeleteModelRequest {
  name: string;
  version: string;
  even_active: boolean;
}

export interface DeleteModelResponse {
  models: readonly ModelRef[];
}

export interface DeleteRunRequest {
  id: string;
}

export interface DeleteRunResponse {

}

export interface DescribeRequest {
  model: ModelRef | null;
  images: readonly Image[];
  phrases: readonly string[];
  epsilon: number | null;
}

export interface DescribeResponse {
  descriptions: readonly Description[];
  model: ModelRef | null;
  timing: Timing | null;
  unknown: readonly string[];
  unknown_phrases: readonly UnknownPhrase[];
}

export interface Description {
  captions: readonly string[];
}

export interface DrawRecipesRequest {
  task: string;
  count: number;
  seed: number;
  skills: readonly string[];
  min_skills: number;
  max_skills: number;
  conditions: readonly string[];
}

export interface DrawRecipesResponse {
  recipes: readonly Recipe[];
}

export interface EmbedGoalRequest {
  model: ModelRef | null;
  goal_text: string;
}

export interface EmbedGoalResponse {
  embedding: Tensor | readonly unknown[] | null;
  truncated: boolean;
  model: ModelRef | null;
  timing: Timing | null;
  unknown: readonly string[];
  did_you_mean: string;
}

export interface ExpertActionsRequest {
  session: string;
  recipes: readonly Recipe[];
  behaviour: "expert" | "random" | null;
}

export interface ExpertActionsResponse {
  actions: Tensor | readonly unknown[] | null;
  finished: Tensor | readonly unknown[] | null;
  skills: Tensor | readonly unknown[] | null;
}

export interface Fit {
  id: string;
  state: "queued" | "running" | "succeeded" | "failed" | "cancelled";
  dataset: string;
  model_name: string;
  config: Record<string, unknown>;
  step: number;
  steps: number;
  metrics: Readonly<Record<string, number>>;
  model: ModelRef | null;
  error: string;
  time_ns: number;
}

export interface GetFitMetricsResponse {
  rows: readonly MetricRow[];
  total_rows: number;
  next_step: number;
}

export interface GetFitResponse {
  fit: Fit | null;
}

export interface GetFramesResponse {
  frames: readonly Image[];
  first: number;
  timesteps: number;
}

export interface GetMetricsResponse {
  rows: readonly MetricRow[];
  total_rows: number;
  next_step: number;
}

export interface GetRunResponse {
  run: Run | null;
}

export interface GetSpecResponse {
  model: ModelRef | null;
  cameras: readonly Camera[];
  action: ActionSpec | null;
  horizon: number;
  control_dt_s: number;
  goal_form: "images" | "recipe" | "text";
  skills: readonly string[];
  max_steps_per_goal: number;
  reached_threshold: number;
  goal_texts: readonly string[];
  robot_state_size: number;
}

export interface GetTrajectoryResponse {
  skills: readonly string[];
  goal_text: string;
  timesteps: number;
  labels: readonly LabelSegment[];
  hand_labels: readonly LabelSegment[];
  known_skills: readonly string[];
  actions: Tensor | readonly unknown[] | null;
}

export interface Goal {
  images: readonly Image[];
  recipe: readonly string[];
  text: string;
}

export interface GroundRequest {
  model: ModelRef | null;
  image: Image | null;
  phrases: readonly string[];
}

export interface GroundResponse {
  groundings: readonly Grounding[];
  model: ModelRef | null;
  timing: Timing | null;
  unknown: readonly string[];
  unknown_phrases: readonly UnknownPhrase[];
}

export interface Grounding {
  phrase: string;
  heatmap: Tensor | readonly unknown[] | null;
  x: number;
  y: number;
  presence: number;
}

export interface Image {
  encoding: "raw_rgb8" | "raw_gray8" | "png" | "jpeg" | "webp";
  height: number;
  width: number;
  data: string;
  camera: string;
}

export type JsonValue = unknown;

export interface LabelSegment {
  start: number;
  end: number;
  skill: string;
}

export interface ListArtifactsResponse {
  artifacts: readonly Artifact[];
}

export interface ListDatasetProblemsResponse {
  problems: readonly DatasetProblem[];
}

export interface ListDatasetsResponse {
  datasets: readonly Dataset[];
  next_page_token: string;
}

export interface ListFitsResponse {
  fits: readonly Fit[];
  next_page_token: string;
}

export interface ListModelsResponse {
  models: readonly Model[];
}

export interface ListRunsResponse {
  runs: readonly Run[];
  next_page_token: string;
}

export interface ListSkillsResponse {
  skills: readonly string[];
  model: ModelRef | null;
  height: number;
  width: number;
  channels: number;
  action_size: number;
  action_choices: number;
  lag: number | null;
  camera: string;
  fps: number;
}

export interface ListTasksResponse {
  tasks: readonly Task[];
}

export interface Measure {
  name: string;
  unit: string;
  needs_reference: boolean;
}

export interface MetricRow {
  step: number;
  metrics: Readonly<Record<string, number>>;
}

export interface Model {
  ref: ModelRef | null;
  active: boolean;
  card: Record<string, unknown>;
  time_ns: number;
}

export interface ModelRef {
  name: string;
  version: string;
}

export interface Observation {
  images: readonly Image[];
  state: Tensor | readonly unknown[] | null;
}

export interface Predicate {
  name: string;
  text: string;
  group: string;
  needs_reference: boolean;
}

export interface Problem {
  status: number;
  type: string;
  title: string;
  code: string;
  detail: string;
  field: string;
  hint: string;
  request_id: string;
}

export interface PublishPolicyRequest {
  run: string;
  model_name: string;
}

export interface PublishPolicyResponse {
  model: ModelRef | null;
}

export interface Recipe {
  skills: readonly string[];
}

export interface RenderRequest {
  session: string;
  cameras: readonly string[];
  height: number;
  width: number;
}

export interface RenderResponse {
  frames: Readonly<Record<string, Tensor | readonly unknown[]>>;
}

export interface ResetRequest {
  session: string;
  envs: readonly number[];
  seed: number | null;
  cameras: readonly string[];
  recipes: readonly Recipe[];
}

export interface ResetResponse {
  frames: Readonly<Record<string, Tensor | readonly unknown[]>>;
  truth: Truth | null;
}

export interface RestoreRequest {
  session: string;
  snapshot: string;
  envs: readonly number[];
  sources: readonly number[];
}

export interface RestoreResponse {
  step_id: number;
}

export interface ResumeFitRequest {
  id: string;
}

export interface ResumeFitResponse {
  fit: Fit | null;
}

export interface ResumeRunRequest {
  id: string;
}

export interface ResumeRunResponse {
  run: Run | null;
}

export interface RewardRequest {
  model: ModelRef | null;
  frames: Readonly<Record<string, Tensor | readonly unknown[]>>;
  images: readonly Image[];
  goal_text: string;
  rivals: readonly string[];
  mode: "binary" | "raw" | null;
}

export interface RewardResponse {
  rewards: readonly number[];
  similarities: readonly number[];
  winners: readonly number[];
  texts: readonly string[];
  truncated: boolean;
  model: ModelRef | null;
  timing: Timing | null;
  unknown: readonly string[];
  in_distribution: readonly number[];
  did_you_mean: string;
}

export interface Run {
  id: string;
  kind: string;
  state: "queued" | "running" | "succeeded" | "failed" | "cancelled";
  config: Record<string, unknown>;
  step: number;
  steps: number;
  metrics: Readonly<Record<string, number>>;
  model: ModelRef | null;
  error: string;
  time_ns: number;
  truth: string;
}

export interface SaveLabelsRequest {
  dataset: string;
  index: number;
  segments: readonly LabelSegment[];
}

export interface SaveLabelsResponse {

}

export interface Segment {
  start: number;
  end: number;
  skill: string;
  confidence: number;
}

export interface SegmentRequest {
  model: ModelRef | null;
  frames: Tensor | readonly unknown[] | null;
  images: readonly Image[];
  actions: Tensor | readonly unknown[] | null;
  min_segment: number;
  smoothing: number;
  min_kept: number;
  video: string;
  resize: boolean;
  min_confidence: number;
  fps: number;
}

export interface SegmentResponse {
  labels: readonly number[];
  confidence: readonly number[];
  segments: readonly Segment[];
  skills: readonly string[];
  model: ModelRef | null;
  timing: Timing | null;
  in_distribution: readonly number[];
  time_s: readonly number[];
  fps: number;
}

export interface SnapshotRequest {
  session: string;
}

export interface SnapshotResponse {
  snapshot: string;
}

export interface StartFitRequest {
  dataset: string;
  model_name: string;
  config: Record<string, unknown>;
  idempotency_key: string;
}

export interface StartFitResponse {
  fit: Fit | null;
}

export interface StartRunRequest {
  kind: string;
  config: Record<string, unknown>;
  idempotency_key: string;
}

export interface StartRunResponse {
  run: Run | null;
}

export interface StepRequest {
  session: string;
  step_id: number;
  actions: Tensor | readonly unknown[] | null;
  cameras: readonly string[];
  action_repeat: number;
}

export interface StepResponse {
  step_id: number;
  frames: Readonly<Record<string, Tensor | readonly unknown[]>>;
  reward: Tensor | readonly unknown[] | null;
  terminated: Tensor | readonly unknown[] | null;
  truncated: Tensor | readonly unknown[] | null;
  diverged: Tensor | readonly unknown[] | null;
  final_frames: Readonly<Record<string, Tensor | readonly unknown[]>>;
  truth: Truth | null;
}

export interface Task {
  name: string;
  world: string;
  goal_text: string;
  cameras: readonly Camera[];
  action: ActionSpec | null;
  control_dt_s: number;
  skills: readonly string[];
  max_episode_steps: number;
  predicates: readonly Predicate[];
  has_expert: boolean;
  conditions: readonly string[];
  min_skills: number;
  max_skills: number;
  has_explorer: boolean;
  measures: readonly Measure[];
  reward_free: boolean;
}

export interface Tensor {
  datatype: "BOOL" | "UINT8" | "UINT16" | "UINT32" | "INT32" | "INT64" | "FP32" | "FP64";
  shape: readonly number[];
  raw: string;
}

export interface Timing {
  queue_ns: number;
  decode_ns: number;
  infer_ns: number;
  encode_ns: number;
  total_ns: number;
  batch_size: number;
}

export interface Truth {
  state: Tensor | readonly unknown[] | null;
  reward: Tensor | readonly unknown[] | null;
  success: Tensor | readonly unknown[] | null;
}

export interface UnknownPhrase {
  phrase: string;
  words: readonly string[];
}

export interface WatchFitResponse {
  sequence: number;
  fit: Fit | null;
}

export interface WatchRunResponse {
  sequence: number;
  run: Run | null;
}

export interface Calls {
  "orchestrator/start-run": { request: Sent<StartRunRequest>; reply: StartRunResponse };
  "orchestrator/get-run": { request: { "id"?: string }; reply: GetRunResponse };
  "orchestrator/list-runs": { request: { "page_size"?: number; "page_token"?: string }; reply: ListRunsResponse };
  "orchestrator/get-metrics": { request: { "id"?: string; "from_step"?: number; "max_rows"?: number; "keep_extremes"?: boolean }; reply: GetMetricsResponse };
  "orchestrator/cancel-run": { request: Sent<CancelRunRequest>; reply: CancelRunResponse };
  "orchestrator/resume-run": { request: Sent<ResumeRunRequest>; reply: ResumeRunResponse };
  "orchestrator/delete-run": { request: Sent<DeleteRunRequest>; reply: DeleteRunResponse };
  "orchestrator/list-artifacts": { request: { "id"?: string }; reply: ListArtifactsResponse };
  "orchestrator/list-datasets": { request: { "page_size"?: number; "page_token"?: string }; reply: ListDatasetsResponse };
  "orchestrator/list-dataset-problems": { request: { "dataset"?: string }; reply: ListDatasetProblemsResponse };
  "orchestrator/get-trajectory": { request: { "dataset"?: string; "index"?: number }; reply: GetTrajectoryResponse };
  "orchestrator/get-frames": { request: { "dataset"?: string; "index"?: number; "camera"?: string; "first"?: number; "count"?: number; "max_side"?: number }; reply: GetFramesResponse };
  "orchestrator/save-labels": { request: Sent<SaveLabelsRequest>; reply: SaveLabelsResponse };
  "segmentation/segment": { request: Sent<SegmentRequest>; reply: SegmentResponse };
  "segmentation/list-skills": { request: { "model.name"?: string; "model.version"?: string }; reply: ListSkillsResponse };
  "segmentation/start-fit": { request: Sent<StartFitRequest>; reply: StartFitResponse };
  "segmentation/get-fit": { request: { "id"?: string }; reply: GetFitResponse };
  "segmentation/list-fits": { request: { "page_size"?: number; "page_token"?: string }; reply: ListFitsResponse };
  "segmentation/get-fit-metrics": { request: { "id"?: string; "from_step"?: number; "max_rows"?: number; "keep_extremes"?: boolean }; reply: GetFitMetricsResponse };
  "segmentation/cancel-fit": { request: Sent<CancelFitRequest>; reply: CancelFitResponse };
  "segmentation/resume-fit": { request: Sent<ResumeFitRequest>; reply: ResumeFitResponse };
  "segmentation/delete-fit": { request: Sent<DeleteFitRequest>; reply: DeleteFitResponse };
  "segmentation/list-models": { request: Record<string, never>; reply: ListModelsResponse };
  "segmentation/activate-model": { request: Sent<ActivateModelRequest>; reply: ActivateModelResponse };
  "segmentation/delete-model": { request: Sent<DeleteModelRequest>; reply: DeleteModelResponse };
  "imitation/get-spec": { request: { "model.name"?: string; "model.version"?: string }; reply: GetSpecResponse };
  "imitation/act": { request: Sent<ActRequest>; reply: ActResponse };
  "imitation/act-batch": { request: Sent<ActBatchRequest>; reply: ActBatchResponse };
  "imitation/publish-policy": { request: Sent<PublishPolicyRequest>; reply: PublishPolicyResponse };
  "imitation/start-fit": { request: Sent<StartFitRequest>; reply: StartFitResponse };
  "imitation/get-fit": { request: { "id"?: string }; reply: GetFitResponse };
  "imitation/list-fits": { request: { "page_size"?: number; "page_token"?: string }; reply: ListFitsResponse };
  "imitation/get-fit-metrics": { request: { "id"?: string; "from_step"?: number; "max_rows"?: number; "keep_extremes"?: boolean }; reply: GetFitMetricsResponse };
  "imitation/cancel-fit": { request: Sent<CancelFitRequest>; reply: CancelFitResponse };
  "imitation/resume-fit": { request: Sent<ResumeFitRequest>; reply: ResumeFitResponse };
  "imitation/delete-fit": { request: Sent<DeleteFitRequest>; reply: DeleteFitResponse };
  "imitation/list-models": { request: Record<string, never>; reply: ListModelsResponse };
  "imitation/activate-model": { request: Sent<ActivateModelRequest>; reply: ActivateModelResponse };
  "imitation/delete-model": { request: Sent<DeleteModelRequest>; reply: DeleteModelResponse };
  "reward/reward": { request: Sent<RewardRequest>; reply: RewardResponse };
  "reward/ground": { request: Sent<GroundRequest>; reply: GroundResponse };
  "reward/describe": { request: Sent<DescribeRequest>; reply: DescribeResponse };
  "reward/embed-goal": { request: Sent<EmbedGoalRequest>; reply: EmbedGoalResponse };
  "reward/start-fit": { request: Sent<StartFitRequest>; reply: StartFitResponse };
  "reward/get-fit": { request: { "id"?: string }; reply: GetFitResponse };
  "reward/list-fits": { request: { "page_size"?: number; "page_token"?: string }; reply: ListFitsResponse };
  "reward/get-fit-metrics": { request: { "id"?: string; "from_step"?: number; "max_rows"?: number; "keep_extremes"?: boolean }; reply: GetFitMetricsResponse };
  "reward/cancel-fit": { request: Sent<CancelFitRequest>; reply: CancelFitResponse };
  "reward/resume-fit": { request: Sent<ResumeFitRequest>; reply: ResumeFitResponse };
  "reward/delete-fit": { request: Sent<DeleteFitRequest>; reply: DeleteFitResponse };
  "reward/list-models": { request: Record<string, never>; reply: ListModelsResponse };
  "reward/activate-model": { request: Sent<ActivateModelRequest>; reply: ActivateModelResponse };
  "reward/delete-model": { request: Sent<DeleteModelRequest>; reply: DeleteModelResponse };
  "sim/list-tasks": { request: Record<string, never>; reply: ListTasksResponse };
  "sim/create-session": { request: Sent<CreateSessionRequest>; reply: CreateSessionResponse };
  "sim/reset": { request: Sent<ResetRequest>; reply: ResetResponse };
  "sim/step": { request: Sent<StepRequest>; reply: StepResponse };
  "sim/render": { request: Sent<RenderRequest>; reply: RenderResponse };
  "sim/snapshot": { request: Sent<SnapshotRequest>; reply: SnapshotResponse };
  "sim/restore": { request: Sent<RestoreRequest>; reply: RestoreResponse };
  "sim/draw-recipes": { request: Sent<DrawRecipesRequest>; reply: DrawRecipesResponse };
  "sim/check": { request: Sent<CheckRequest>; reply: CheckResponse };
  "sim/expert-actions": { request: Sent<ExpertActionsRequest>; reply: ExpertActionsResponse };
  "sim/close-session": { request: Sent<CloseSessionRequest>; reply: CloseSessionResponse };
}
