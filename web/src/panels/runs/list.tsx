/** All jobs of all services, newest first. */
import { useState } from "preact/hooks";
import { useRemote } from "../../api/remote";
import { Link } from "../../parts/link";
import { Empty, Failed, Shown } from "../../parts/notice";
import { useTicks } from "../../parts/ticks";
import { amend, query } from "../../url/location";
import { FEW_JOBS, listJobs, MOST_JOBS, type Job, type Jobs } from "./job";
import { StateBadge } from "./state_badge";
import { truthSeen } from "./truth";

const PERIOD_MS = 3000;
const TIME = new Intl.DateTimeFormat(undefined, { dateStyle: "short", timeStyle: "medium" });

export function JobList() {
  const turn = useTicks(PERIOD_MS);
  const [most, setMost] = useState(FEW_JOBS);
  const [remote, retry] = useRemote((signal) => listJobs(signal, most), "jobs", turn + (most === FEW_JOBS ? 0 : 0.5));
  return (
    <Shown remote={remote} what="runs and fits" retry={retry}>
      {(jobs) => (
        <Table {...jobs} retry={retry} more={jobs.areMore && most === FEW_JOBS ? () => setMost(MOST_JOBS) : null} />
      )}
    </Shown>
  );
}

function Table({ jobs, away, retry, more }: Jobs & { retry: () => void; more: (() => void) | null }) {
  const wanted = (query.value.filter ?? "").toLowerCase();
  const found = jobs.filter((each) =>
    `${each.kind} ${each.about} ${each.state} ${each.id}`.toLowerCase().includes(wanted),
  );
  return (
    <>
      {away.map(({ owner, problem }) => (
        <Failed key={owner} problem={problem} retry={retry} />
      ))}
      {jobs.length === 0 ? (
        <Empty title="No runs and no fits yet">
          Start one above, or with <code>freerein run</code>. It survives the death of any process.
        </Empty>
      ) : (
        <>
          <label class="filter">
            Filter
            <input
              type="search"
              value={query.value.filter ?? ""}
              onInput={(event) => amend({ filter: event.currentTarget.value })}
            />
          </label>
          <div class="scrolled" tabIndex={0} role="region" aria-label="Runs and fits">
            <table class="jobs">
              <thead>
                <tr>
                  {["What", "State", "Steps", "Changed", "Compare"].map((each) => (
                    <th key={each} scope="col">
                      {each}
                    </th>
                  ))}
                </tr>
              </thead>
              <tbody>
                {found.map((each) => (
                  <Row key={each.id} job={each} />
                ))}
              </tbody>
            </table>
          </div>
          <p class="faint">
            {found.length} of {jobs.length} shown.{" "}
            {more && (
              <button type="button" onClick={more}>
                Show older ones
              </button>
            )}
          </p>
        </>
      )}
    </>
  );
}

function Row({ job }: { job: Job }) {
  const name = `${job.owner}/${job.id}`;
  const first = query.value.compare;
  const truth = truthSeen(job);
  return (
    <tr>
      <td>
        <Link to={{ view: "runs", job: name, compare: "" }}>{job.kind}</Link> <span class="faint">{job.about}</span>
        {truth && (
          <span class="state truth" title={truth}>
            saw the truth
          </span>
        )}
      </td>
      <td>
        <StateBadge state={job.state} />
      </td>
      <td class="number">
        {job.step} / {job.steps}
      </td>
      <td>{job.time > 0 ? <time dateTime={new Date(job.time).toISOString()}>{TIME.format(job.time)}</time> : "–"}</td>
      <td>
        {first === undefined || first === name ? (
          <button
            type="button"
            class="quiet"
            aria-pressed={first === name}
            aria-label={`Compare ${job.kind} ${job.about}`}
            onClick={() => amend({ compare: first === name ? "" : name })}
          >
            {first === name ? "chosen" : "choose"}
          </button>
        ) : (
          <Link to={{ view: "runs", job: first, with: name, compare: "" }}>with chosen</Link>
        )}
      </td>
    </tr>
  );
}
