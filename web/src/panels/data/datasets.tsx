/** Datasets with a picture, their tags, and what a check says of them. */
import { useEffect, useRef, useState } from "preact/hooks";
import { call } from "../../api/client";
import { useRemote } from "../../api/remote";
import { fromBase64 } from "../../api/tensors";
import type { Dataset } from "../../api/types";
import { Link } from "../../parts/link";
import { Empty, Shown } from "../../parts/notice";

const STRIP = 4;
const STRIP_SIDE = 160;

export function Datasets() {
  const [remote, retry] = useRemote(
    async (signal) => (await call("orchestrator/list-datasets", { page_size: 1000 }, { signal })).datasets,
    "datasets",
  );
  return (
    <Shown remote={remote} what="the datasets" retry={retry}>
      {(datasets) =>
        datasets.length === 0 ? (
          <Empty title="No datasets yet">
            <Link to={{ view: "runs", start: "run", kind: "collect" }}>Record one</Link> in a world, or import a folder
            of yours: <code>freerein dataset import</code>.
          </Empty>
        ) : (
          <div class="cards wide">
            {datasets.map((each) => (
              <Card key={each.name} dataset={each} />
            ))}
          </div>
        )
      }
    </Shown>
  );
}

function Card({ dataset }: { dataset: Dataset }) {
  const title = <h2 id={`dataset-${dataset.name}`}>{dataset.name}</h2>;
  if (dataset.error) {
    return (
      <section class="card" aria-labelledby={`dataset-${dataset.name}`}>
        {title}
        <p class="field-error">{dataset.error}</p>
      </section>
    );
  }
  const cameras = dataset.cameras.map(
    (each) => `${each.name} ${each.width} × ${each.height}${each.channels === 1 ? " gray" : ""}`,
  );
  return (
    <section class="card dataset" aria-labelledby={`dataset-${dataset.name}`}>
      {title}
      {dataset.trajectories > 0 && <Pictures dataset={dataset} />}
      <p>
        {dataset.trajectories} trajectories, {dataset.timesteps} timesteps, {dataset.fps} per second.{" "}
        {cameras.join(", ")}.{" "}
        {dataset.action && dataset.action.size > 0 ? `Actions: ${dataset.action.names.join(", ")}.` : "No actions."}
      </p>
      {dataset.goal_text && <p>“{dataset.goal_text}”</p>}
      <Tags dataset={dataset} />
      <p class="faint">
        {[
          dataset.labelled_by
            ? `labelled by model ${dataset.labelled_by.name} ${dataset.labelled_by.version}`
            : "not labelled by a model",
          `${dataset.hand_labelled} labelled by hand`,
          `${dataset.with_truth} with truth, which only measures`,
        ].join("; ")}
      </p>
      <div class="buttons">
        <Link to={{ view: "segments", source: "dataset", dataset: dataset.name }}>Look at its trajectories</Link>
        <Link to={{ view: "runs", start: "fit", dataset: dataset.name }}>Fit a model to it</Link>
      </div>
      <Problems dataset={dataset.name} />
    </section>
  );
}

function Tags({ dataset }: { dataset: Dataset }) {
  const most = Math.max(1, ...Object.values(dataset.tags));
  if (Object.keys(dataset.tags).length === 0) return null;
  return (
    <ul class="tags" aria-label="Trajectories of each skill">
      {Object.entries(dataset.tags).map(([skill, count]) => (
        <li key={skill}>
          <span>{skill}</span>
          <svg viewBox="0 0 100 1" preserveAspectRatio="none" aria-hidden="true">
            <rect width={(100 * count) / most} height={1} />
          </svg>
          <span>{count}</span>
        </li>
      ))}
    </ul>
  );
}

/** The first trajectory in a few frames. */
function Pictures({ dataset }: { dataset: Dataset }) {
  const canvas = useRef<HTMLCanvasElement>(null);
  useEffect(() => {
    let isWanted = true;
    const draw = async (): Promise<void> => {
      const { timesteps } = await call("orchestrator/get-trajectory", { dataset: dataset.name, index: 0 });
      for (let index = 0; index < STRIP && isWanted; index += 1) {
        const first = Math.floor((index * (timesteps - 1)) / (STRIP - 1));
        const { frames } = await call("orchestrator/get-frames", {
          dataset: dataset.name,
          index: 0,
          first,
          count: 1,
          max_side: STRIP_SIDE,
        });
        const picture = await createImageBitmap(new Blob([fromBase64(frames[0]!.data)]));
        drawContained(canvas.current, picture, index);
      }
    };
    void draw().catch(() => undefined);
    return () => {
      isWanted = false;
    };
  }, [dataset.name]);
  return (
    <canvas
      ref={canvas}
      class="dataset-pictures"
      role="img"
      aria-label="Its first trajectory in four frames"
      width={STRIP * STRIP_SIDE}
      height={STRIP_SIDE}
    />
  );
}

function drawContained(canvas: HTMLCanvasElement | null, picture: ImageBitmap, index: number): void {
  const scale = Math.min(STRIP_SIDE / picture.width, STRIP_SIDE / picture.height);
  const [width, height] = [picture.width * scale, picture.height * scale];
  canvas
    ?.getContext("2d")!
    .drawImage(picture, index * STRIP_SIDE + (STRIP_SIDE - width) / 2, (STRIP_SIDE - height) / 2, width, height);
}

function Problems({ dataset }: { dataset: string }) {
  const [isAsked, setAsked] = useState(false);
  return (
    <details onToggle={(event) => setAsked((event.currentTarget as HTMLDetailsElement).open)}>
      <summary>Check it</summary>
      {isAsked && <Checked dataset={dataset} />}
    </details>
  );
}

function Checked({ dataset }: { dataset: string }) {
  const [remote, retry] = useRemote(
    async (signal) => (await call("orchestrator/list-dataset-problems", { dataset }, { signal })).problems,
    dataset,
  );
  return (
    <Shown remote={remote} what="the check" retry={retry}>
      {(problems) =>
        problems.length === 0 ? (
          <p>Nothing prevents or impairs learning skills from it.</p>
        ) : (
          <ul class="problems">
            {problems.map((each, index) => (
              <li key={index}>
                <span class={`state ${each.severity === "error" ? "bad" : "active"}`}>{each.severity}</span>{" "}
                <strong>{each.subject}</strong>: {each.detail} <span class="faint">{each.hint}</span>
              </li>
            ))}
          </ul>
        )
      }
    </Shown>
  );
}
