/** One job: state, curves that grow, events, artifacts, configuration; another one beside it to compare. */
import { useEffect, useState } from "preact/hooks";
import { asProblem, type Problem } from "../../api/problem";
import { useRemote } from "../../api/remote";
import { Link } from "../../parts/link";
import { Empty, Failed, Loading, Shown } from "../../parts/notice";
import { short } from "../../parts/numbers";
import { say } from "../../parts/say";
import { Twice } from "../../parts/twice";
import { open, query } from "../../url/location";
import { Artifacts } from "./artifacts";
import { Curve } from "./curve";
import { cancel, isOver, remove, resume, type Job, type Owner, OWNERS } from "./job";
import { LiveJob } from "./live_job";
import { checkpointSteps, inOrder } from "./series";
import { StateBadge } from "./state_badge";

const MOST_CURVES = 12;

/** Reads `orchestrator/ID` of the URL. */
function useLive(name: string | undefined, turn: number): LiveJob | null {
  const [live, setLive] = useState<LiveJob | null>(null);
  useEffect(() => {
    const [owner, id] = (name ?? "").split("/");
    const opened = OWNERS.includes(owner as Owner) && id ? new LiveJob(owner as Owner, id) : null;
    setLive(opened);
    return () => opened?.close();
  }, [name, turn]);
  return live;
}

export function JobDetail({ name }: { name: string }) {
  const [turn, setTurn] = useState(0);
  const live = useLive(name, turn);
  const other = useLive(query.value.with, 0);
  const job = live?.job.value;
  const broken = live?.broken.value ?? null;
  useEffect(() => {
    if (job) say(`${job.kind} ${job.state}`);
  }, [job?.state]);
  if (!job) return broken ? <Failed problem={broken} /> : <Loading what="the job" />;
  return (
    <article>
      <Head job={job} onResumed={() => setTurn(turn + 1)} />
      {broken && !isOver(job.state) && <Failed problem={broken} />}
      {job.error && (
        <div class={`notice ${job.state === "failed" ? "failed" : "away"}`} role="alert">
          <p class="notice-title">
            {job.state === "failed" ? "Why it failed" : isOver(job.state) ? "Its last error" : "Why it waits"}
          </p>
          <p>{job.error}</p>
        </div>
      )}
      <Curves live={live} other={other} job={job} />
      <Marks live={live} />
      <Artifacts job={job} />
      <details class="card">
        <summary>Configuration</summary>
        <ConfigTable config={job.config} other={other?.job.value?.config} />
      </details>
    </article>
  );
}

function Head({ job, onResumed }: { job: Job; onResumed: () => void }) {
  const [problem, setProblem] = useState<Problem | null>(null);
  const act = (work: (job: Job) => Promise<void>, then?: () => void) => () => {
    setProblem(null);
    work(job).then(then, (error: unknown) => setProblem(asProblem(error)));
  };
  return (
    <header class="job-head">
      <p>
        <Link to={{ view: "runs", job: "", with: "" }}>All runs and fits</Link>
      </p>
      <h2>
        {job.kind} <span class="faint">{job.about}</span> <StateBadge state={job.state} />
      </h2>
      {job.truth && (
        <p>
          <span class="state truth">sees the truth</span> {job.truth}
        </p>
      )}
      <div class="job-progress">
        <progress aria-label="Steps" max={Math.max(job.steps, 1)} value={job.step} />
        <span>
          {job.step} of {job.steps} steps
        </span>
        {job.model && (
          <span>
            model <code>{`${job.model.name} ${job.model.version}`}</code>
          </span>
        )}
        <code class="faint">{job.id}</code>
      </div>
      <div class="buttons">
        <button type="button" disabled={isOver(job.state)} onClick={act(cancel)}>
          Cancel
        </button>
        <button
          type="button"
          disabled={job.state !== "failed" && job.state !== "cancelled"}
          onClick={act(resume, onResumed)}
        >
          Resume
        </button>
        <Twice
          name="Delete"
          again="Delete for good"
          disabled={!isOver(job.state)}
          act={act(remove, () => open({ view: "runs", job: "", with: "" }))}
        />
        {query.value.with && <Link to={{ view: "runs", job: query.value.job ?? "", with: "" }}>Compare no longer</Link>}
      </div>
      {problem && <Failed problem={problem} />}
    </header>
  );
}

function Curves({ live, other, job }: { live: LiveJob; other: LiveJob | null; job: Job }) {
  const [showsAll, setShowsAll] = useState(false);
  const series = live.series.value;
  const names = inOrder(Object.keys(series));
  const [drawing, retry] = useRemote(() => import("uplot"), "uplot");
  const shown = showsAll ? names : names.slice(0, MOST_CURVES);
  if (names.length === 0) {
    return (
      <Empty title="No metrics yet">
        {isOver(job.state) ? "This job recorded none." : "They appear with its first steps."}
      </Empty>
    );
  }
  return (
    <section aria-label="Curves">
      {other?.job.value && (
        <p>
          <span class="line-sample" aria-hidden="true" /> this job <span class="line-sample other" aria-hidden="true" />{" "}
          {other.job.value.kind} {other.job.value.about}
        </p>
      )}
      <Shown remote={drawing} what="the curves" retry={retry}>
        {({ default: Plot }) => (
          <div class="curves">
            {shown.map((each) => (
              <Curve
                key={each}
                name={each}
                Plot={Plot}
                points={series[each]!}
                other={other?.series.value[each]}
                marks={live.marks.value}
                checkpoints={checkpointSteps(job.config, job.step)}
              />
            ))}
          </div>
        )}
      </Shown>
      {names.length > MOST_CURVES && (
        <button type="button" onClick={() => setShowsAll(!showsAll)}>
          {showsAll ? "Show fewer" : `Show all ${names.length} curves`}
        </button>
      )}
    </section>
  );
}

function Marks({ live }: { live: LiveJob }) {
  const marks = live.marks.value;
  if (marks.length === 0) return null;
  return (
    <section class="card" aria-label="Events">
      <h3>Events (dashed lines)</h3>
      <ul>
        {marks.map((each, index) => (
          <li key={index}>
            step {each.step}: <strong>{each.kind}</strong> {each.text !== each.kind && each.text}
          </li>
        ))}
      </ul>
    </section>
  );
}

function ConfigTable({ config, other }: { config: Job["config"]; other?: Job["config"] }) {
  const text = (value: unknown): string =>
    typeof value === "number" ? short(value) : typeof value === "string" ? value : JSON.stringify(value);
  return (
    <div class="scrolled" tabIndex={0} role="region" aria-label="Configuration">
      <table>
        <thead>
          <tr>
            <th scope="col">Key</th>
            <th scope="col">Value</th>
            {other && <th scope="col">Compared</th>}
          </tr>
        </thead>
        <tbody>
          {Object.entries(config).map(([key, value]) => (
            <tr key={key} class={other && text(other[key]) !== text(value) ? "current" : ""}>
              <th scope="row">{key}</th>
              <td>{text(value) || "–"}</td>
              {other && <td>{key in other ? text(other[key]) || "–" : "–"}</td>}
            </tr>
          ))}
        </tbody>
      </table>
    </div>
  );
}
