/** A dropped video: the form that has it segmented. */
import { useState } from "preact/hooks";
import { call, upload } from "../../api/client";
import { asProblem, type Problem } from "../../api/problem";
import { useRemote } from "../../api/remote";
import type { ListSkillsResponse } from "../../api/types";
import { Failed, Shown } from "../../parts/notice";
import { parseActions } from "./actions";
import { VideoFrames } from "./frames";
import { describeModel, timesOfVideo, type Recording } from "./recording";

export function VideoForm(props: {
  file: File | null;
  onFile: (file: File) => void;
  onRecording: (recording: Recording) => void;
}) {
  const [remote, retry] = useRemote(listModels, "segmentation models");
  return (
    <Shown remote={remote} what="segmentation models" retry={retry}>
      {(models) => <Form {...props} models={models} />}
    </Shown>
  );
}

/** Returns what every active segmentation model expects. */
export async function listModels(signal: AbortSignal): Promise<ListSkillsResponse[]> {
  const { models } = await call("segmentation/list-models", {}, { signal });
  const names = models.filter((each) => each.active).map((each) => each.ref!.name);
  return Promise.all(names.map((name) => call("segmentation/list-skills", { "model.name": name }, { signal })));
}

interface FormProps {
  readonly file: File | null;
  readonly models: readonly ListSkillsResponse[];
  readonly onFile: (file: File) => void;
  readonly onRecording: (recording: Recording) => void;
}

function Form({ file, models, onFile, onRecording }: FormProps) {
  const [chosen, setChosen] = useState("");
  const [isBusy, setBusy] = useState(false);
  const [problem, setProblem] = useState<Problem | null>(null);
  const model = models.find((each) => each.model!.name === chosen) ?? models[0];
  const segment = async (event: Event): Promise<void> => {
    event.preventDefault();
    const form = new FormData(event.currentTarget as HTMLFormElement);
    if (!file || !model) return;
    setBusy(true);
    setProblem(null);
    try {
      onRecording(await segmentVideo(file, model, form.get("actions") as File, Number(form.get("smoothing"))));
    } catch (error) {
      setProblem(asProblem(error));
    } finally {
      setBusy(false);
    }
  };
  if (!model) return <p>No segmentation model is active. Fit one under Runs, or activate one under Data and models.</p>;
  return (
    <form class="stacked" onSubmit={(event) => void segment(event)}>
      <label>
        Video (mp4, m4v or mov; or drop one anywhere here)
        <input
          type="file"
          accept="video/mp4,video/quicktime,.m4v"
          onChange={(event) => event.currentTarget.files?.[0] && onFile(event.currentTarget.files[0])}
        />
      </label>
      {file && <p class="faint">{file.name}</p>}
      <label>
        Model
        <select name="model" value={model.model!.name} onChange={(event) => setChosen(event.currentTarget.value)}>
          {models.map((each) => (
            <option key={each.model!.name} value={each.model!.name}>
              {each.model!.name}: {each.skills.join(", ")}
            </option>
          ))}
        </select>
      </label>
      <p class="faint">
        It was trained on {model.width} × {model.height} {model.channels === 1 ? "gray" : "colour"} frames; a video is
        stretched to that.
      </p>
      {model.action_size > 0 && (
        <label>
          Executed actions (CSV, a row of {model.action_size} {model.action_size === 1 ? "number" : "numbers"} for each
          timestep; this model needs them)
          <input type="file" name="actions" accept=".csv,text/csv,text/plain" required />
        </label>
      )}
      <label>
        Smoothing, in timesteps
        <input type="number" name="smoothing" min={0} max={100} step={0.5} defaultValue="1" />
      </label>
      <button type="submit" class="main-action" disabled={!file || isBusy}>
        {isBusy ? "Segmenting …" : "Segment"}
      </button>
      {problem && <Failed problem={problem} />}
    </form>
  );
}

async function segmentVideo(
  file: File,
  model: ListSkillsResponse,
  actions: File | null,
  smoothing: number,
): Promise<Recording> {
  const form = new FormData();
  form.set("video", file);
  form.set("resize", "true");
  form.set("smoothing", String(smoothing));
  form.set("model.name", model.model!.name);
  if (actions) form.set("actions", JSON.stringify(parseActions(await actions.text(), model.action_choices)));
  const answer = await upload("segmentation/segment", form);
  return {
    title: file.name,
    timesteps: answer.labels.length,
    time_s: timesOfVideo(answer.time_s),
    skills: answer.skills,
    segments: answer.segments.map((each) => ({ start: each.start, end: each.end, skill: each.skill })),
    confidence: answer.confidence,
    inDistribution: answer.in_distribution,
    frames: await VideoFrames.open(file, (timestep) => answer.time_s[timestep]!),
    labelledBy: describeModel(answer.model),
    saved: null,
  };
}
