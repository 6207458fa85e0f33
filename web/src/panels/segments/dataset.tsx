/** A trajectory of a dataset: its labels, those of a model on demand, and those that a person saves. */
import { useEffect, useState } from "preact/hooks";
import { call } from "../../api/client";
import { asProblem, type Problem } from "../../api/problem";
import { useRemote } from "../../api/remote";
import { fromBase64 } from "../../api/tensors";
import type { Dataset, GetTrajectoryResponse, Image, ListSkillsResponse } from "../../api/types";
import { Link } from "../../parts/link";
import { Empty, Failed, Loading, Shown } from "../../parts/notice";
import { Typed } from "../../parts/typed";
import { amend, query } from "../../url/location";
import { withEdits } from "./editor";
import { PagedFrames } from "./frames";
import { describeModel, timesAtRate, type Recording } from "./recording";
import { listModels } from "./video";

const PAGE = 64;
const WHOLE_SIDE = 1024;

interface DatasetSourceProps {
  readonly children: (recording: Recording, form: preact.JSX.Element) => preact.ComponentChildren;
}

export function DatasetSource({ children }: DatasetSourceProps) {
  const [remote, retry] = useRemote(
    async (signal) => (await call("orchestrator/list-datasets", { page_size: 1000 }, { signal })).datasets,
    "datasets",
  );
  return (
    <Shown remote={remote} what="the datasets" retry={retry}>
      {(datasets) => <Chosen datasets={datasets.filter((each) => each.error === "")} children={children} />}
    </Shown>
  );
}

function Chosen({ datasets, children }: DatasetSourceProps & { datasets: readonly Dataset[] }) {
  const dataset = datasets.find((each) => each.name === query.value.dataset) ?? datasets[0];
  if (!dataset) {
    return (
      <Empty title="No datasets yet">
        <Link to={{ view: "runs", start: "run", kind: "collect" }}>Record one</Link> in a world, or import a folder of
        yours: <code>freerein dataset import</code>.
      </Empty>
    );
  }
  const index = Math.min(
    Math.max(Math.round(Number(query.value.index ?? 0)) || 0, 0),
    Math.max(dataset.trajectories - 1, 0),
  );
  return (
    <Trajectory
      key={`${dataset.name}/${index}`}
      datasets={datasets}
      dataset={dataset}
      index={index}
      children={children}
    />
  );
}

type TrajectoryProps = DatasetSourceProps & { datasets: readonly Dataset[]; dataset: Dataset; index: number };

function Trajectory({ datasets, dataset, index, children }: TrajectoryProps) {
  const [remote, retry] = useRemote(
    (signal) => call("orchestrator/get-trajectory", { dataset: dataset.name, index }, { signal }),
    `${dataset.name}/${index}`,
  );
  const [recording, setRecording] = useState<Recording | null>(null);
  const trajectory = remote.state === "ready" ? remote.value : null;
  useEffect(() => {
    if (trajectory) setRecording(withEdits(recordingOf(dataset, index, trajectory)));
  }, [trajectory]);
  const form = (
    <div class="stacked">
      <Picker datasets={datasets} dataset={dataset} index={index} />
      {trajectory && <SegmentForm dataset={dataset} index={index} trajectory={trajectory} onRecording={setRecording} />}
    </div>
  );
  if (remote.state === "failed") return <Failed problem={remote.problem} retry={retry} />;
  return recording ? <>{children(recording, form)}</> : <Loading what="the trajectory" />;
}

function recordingOf(dataset: Dataset, index: number, trajectory: GetTrajectoryResponse): Recording {
  const isByHand = trajectory.hand_labels.length > 0;
  const labels = isByHand ? trajectory.hand_labels : trajectory.labels;
  const nobody = `nobody yet; it contains ${trajectory.skills.join(", ") || "unknown skills"}`;
  return {
    title: `${dataset.name}, trajectory ${index}${trajectory.goal_text ? `: ${trajectory.goal_text}` : ""}`,
    timesteps: trajectory.timesteps,
    time_s: timesAtRate(trajectory.timesteps, dataset.fps || 1),
    skills: trajectory.known_skills,
    segments: labels.filter((each) => each.skill !== ""),
    confidence: [],
    inDistribution: [],
    frames: framesOf(dataset, index),
    labelledBy: isByHand ? "a person" : labels.length > 0 ? describeModel(dataset.labelled_by ?? null) : nobody,
    saved: { dataset: dataset.name, index },
  };
}

function framesOf(dataset: Dataset, index: number): PagedFrames {
  const { width, height } = dataset.cameras[0]!;
  const load = async (first: number, count: number): Promise<Blob[]> =>
    (await loadFrames(dataset, index, first, count, 0)).map(
      (each) => new Blob([fromBase64(each.data)], { type: `image/${each.encoding}` }),
    );
  return new PagedFrames(width, height, load);
}

/** Returns `count` frames from `first` on, at the end of the trajectory fewer; a reply may have fewer than asked for. */
async function loadFrames(dataset: Dataset, index: number, first: number, count: number, max_side: number) {
  const frames: Image[] = [];
  for (;;) {
    const asked = { first: first + frames.length, count: count - frames.length };
    const reply = await call("orchestrator/get-frames", { dataset: dataset.name, index, ...asked, max_side });
    frames.push(...reply.frames);
    if (frames.length >= count || first + frames.length >= reply.timesteps) return frames;
  }
}

function Picker({ datasets, dataset, index }: { datasets: readonly Dataset[]; dataset: Dataset; index: number }) {
  return (
    <>
      <label>
        Dataset
        <select
          value={dataset.name}
          onChange={(event) => amend({ dataset: event.currentTarget.value, index: "", t: "" })}
        >
          {datasets.map((each) => (
            <option key={each.name}>{each.name}</option>
          ))}
        </select>
      </label>
      <label>
        Trajectory, 0 to {dataset.trajectories - 1}
        <Typed
          type="number"
          min={0}
          max={dataset.trajectories - 1}
          value={index}
          onValue={(text) => amend({ index: text, t: "" })}
        />
      </label>
    </>
  );
}

interface SegmentFormProps {
  readonly dataset: Dataset;
  readonly index: number;
  readonly trajectory: GetTrajectoryResponse;
  readonly onRecording: (recording: Recording) => void;
}

/** Has a model label the trajectory; only models of its size of frames and actions are offered. */
function SegmentForm({ dataset, index, trajectory, onRecording }: SegmentFormProps) {
  const [remote, retry] = useRemote(listModels, "segmentation models");
  const [problem, setProblem] = useState<Problem | null>(null);
  const [isBusy, setBusy] = useState(false);
  const segment = async (event: Event): Promise<void> => {
    event.preventDefault();
    const name = new FormData(event.currentTarget as HTMLFormElement).get("model") as string;
    setBusy(true);
    setProblem(null);
    try {
      onRecording(await segmented(dataset, index, trajectory, name));
    } catch (error) {
      setProblem(asProblem(error));
    } finally {
      setBusy(false);
    }
  };
  return (
    <Shown remote={remote} what="segmentation models" retry={retry}>
      {(models) => {
        const fitting = models.filter((each) => fits(each, dataset));
        if (fitting.length === 0)
          return (
            <p class="faint">No active segmentation model takes its frames and actions. Fit one under Runs and fits.</p>
          );
        return (
          <form class="stacked" onSubmit={(event) => void segment(event)}>
            <label>
              Model
              <select name="model">
                {fitting.map((each) => (
                  <option key={each.model!.name}>{each.model!.name}</option>
                ))}
              </select>
            </label>
            <button type="submit" class="main-action" disabled={isBusy}>
              {isBusy ? "Segmenting …" : "Segment"}
            </button>
            <p class="faint">
              The model sees the frames as JPEG files, so labels may differ from those of <code>freerein segment</code>.
            </p>
            {problem && <Failed problem={problem} />}
          </form>
        );
      }}
    </Shown>
  );
}

function fits(model: ListSkillsResponse, dataset: Dataset): boolean {
  const [camera] = dataset.cameras;
  const hasSize = camera?.height === model.height && camera.width === model.width && camera.channels === model.channels;
  return hasSize && (model.action_size === 0 || model.action_size === dataset.action?.size);
}

async function segmented(
  dataset: Dataset,
  index: number,
  trajectory: GetTrajectoryResponse,
  model: string,
): Promise<Recording> {
  const images: Image[] = [];
  while (images.length < trajectory.timesteps)
    images.push(...(await loadFrames(dataset, index, images.length, PAGE, WHOLE_SIDE)));
  const request = { model: { name: model }, images, actions: trajectory.actions ?? undefined, smoothing: 1 };
  const answer = await call("segmentation/segment", request);
  return {
    ...recordingOf(dataset, index, trajectory),
    skills: answer.skills,
    segments: answer.segments,
    confidence: answer.confidence,
    inDistribution: answer.in_distribution,
    labelledBy: describeModel(answer.model),
  };
}
