/** All jobs of all services, newest first. */
import { useEffect, useMemo, useRef, useState } from "preact/hooks";
import { useRemote } from "../../api/remote";
import { Link } from "../../parts/link";
import { Empty, Failed, Shown } from "../../parts/notice";
import { useTicks } from "../../parts/ticks";
import { amend, query } from "../../url/location";
import { FEW_JOBS, listJobs, MOST_JOBS, type Job, type Jobs } from "./job";
import { StateBadge } from "./state_badge";

const PERIOD_MS = 3000;
const FIRST_ROWS = 60;
const MORE_ROWS = 200;
const DAY = new Intl.DateTimeFormat(undefined, { dateStyle: "short" });
const TIME = new Intl.DateTimeFormat(undefined, { timeStyle: "short" });
const WHOLE = new Intl.DateTimeFormat(undefined, { dateStyle: "medium", timeStyle: "medium" });

/** Asks for the newest jobs alone until older ones are looked for. */
export function JobList() {
  const turn = useTicks(PERIOD_MS);
  const [most, setMost] = useState(FEW_JOBS);
  const [remote, retry] = useRemote((signal) => listJobs(signal, most), "jobs", turn + (most === FEW_JOBS ? 0 : 0.5));
  const wanted = query.value.filter ?? "";
  useEffect(() => {
    if (wanted !== "") setMost(MOST_JOBS);
  }, [wanted]);
  return (
    <Shown remote={remote} what="runs and fits" retry={retry}>
      {(jobs) => <Table {...jobs} retry={retry} onEnd={() => setMost(MOST_JOBS)} />}
    </Shown>
  );
}

/** Draws the first jobs, and more as their end is scrolled to: a thousand rows take a browser a second. */
function Table({ jobs, away, areMore, retry, onEnd }: Jobs & { retry: () => void; onEnd: () => void }) {
  const wanted = (query.value.filter ?? "").toLowerCase();
  const found = jobs.filter((each) =>
    `${each.kind} ${each.about} ${each.state} ${each.id}`.toLowerCase().includes(wanted),
  );
  const [count, setCount] = useState(FIRST_ROWS);
  const showMore = (): void => {
    if (count < found.length) setCount(count + MORE_ROWS);
    else if (areMore) onEnd();
  };
  return (
    <>
      {away.map(({ owner, problem }) => (
        <Failed key={owner} problem={problem} retry={retry} />
      ))}
      {jobs.length === 0 ? (
        <Empty title="No runs and no fits yet">
          <Link to={{ view: "runs", start: "run", kind: "collect" }}>Record demonstrations</Link> in a world, then{" "}
          <Link to={{ view: "runs", start: "fit" }}>fit a model</Link> to them. <code>freerein run</code> does the same.
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
                {found.slice(0, count).map((each) => (
                  <Row key={each.id} job={each} compared={query.value.compare} />
                ))}
              </tbody>
            </table>
          </div>
          <End key={`${count} ${found.length}`} onSeen={showMore} />
          <p class="faint">
            {found.length} of {jobs.length}
            {areMore && " newest"} shown.
          </p>
        </>
      )}
    </>
  );
}

/** The time of today, the day of others. */
function Time({ time }: { time: number }) {
  const day = DAY.format(time);
  return (
    <time dateTime={new Date(time).toISOString()} title={WHOLE.format(time)}>
      {day === DAY.format(Date.now()) ? TIME.format(time) : day}
    </time>
  );
}

/** What is called when it is scrolled to. */
function End({ onSeen }: { onSeen: () => void }) {
  const mark = useRef<HTMLDivElement>(null);
  useEffect(() => {
    const watching = new IntersectionObserver(([seen]) => seen?.isIntersecting && onSeen(), { rootMargin: "600px" });
    watching.observe(mark.current!);
    return () => watching.disconnect();
  }, []);
  return <div ref={mark} />;
}

interface RowProps {
  readonly job: Job;
  /** Name of the job that was chosen to compare. */
  readonly compared: string | undefined;
}

/** Drawn again when the job or the choice has changed. */
function Row({ job, compared }: RowProps) {
  return useMemo(() => rowOf(job, compared), [job.time, compared]);
}

function rowOf(job: Job, first: string | undefined) {
  const name = `${job.owner}/${job.id}`;
  return (
    <tr>
      <td>
        <Link to={{ view: "runs", job: name, compare: "" }}>{job.kind}</Link> <span class="faint">{job.about}</span>
        {job.truth && (
          <span class="state truth" title={job.truth}>
            sees the truth
          </span>
        )}
      </td>
      <td>
        <StateBadge state={job.state} />
      </td>
      <td class="number">
        {job.step} / {job.steps}
      </td>
      <td>{job.time > 0 ? <Time time={job.time} /> : "–"}</td>
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
