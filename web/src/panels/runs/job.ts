/** Runs and fits alike: jobs of a service, with the same calls under two names. */
import { call, LEARNED, type LearnedService } from "../../api/client";
import { asProblem, Problem } from "../../api/problem";
import type { Artifact, Fit, MetricRow, ModelRef, Run } from "../../api/types";

export type Owner = "orchestrator" | LearnedService;
export const OWNERS: readonly Owner[] = ["orchestrator", ...LEARNED];
export type State = Run["state"];

export interface Job {
  readonly owner: Owner;
  readonly id: string;
  /** Kind of a run; of a fit its method. */
  readonly kind: string;
  /** What it is about, such as a task or a dataset. */
  readonly about: string;
  readonly state: State;
  readonly config: Readonly<Record<string, unknown>>;
  readonly step: number;
  readonly steps: number;
  readonly metrics: Readonly<Record<string, number>>;
  readonly model: ModelRef | null;
  readonly error: string;
  /** What it is told that no learner may see, and what for; empty for nothing. */
  readonly truth: string;
  /** Unix time of the last event in milliseconds; 0 for none. */
  readonly time: number;
}

export function isOver(state: State): boolean {
  return state === "succeeded" || state === "failed" || state === "cancelled";
}

export function jobOfRun(run: Run): Job {
  const about = ["task", "dataset", "model_name"]
    .map((key) => run.config[key])
    .filter((each) => typeof each === "string" && each);
  return { ...common(run), owner: "orchestrator", kind: run.kind, about: about.join(" → "), truth: run.truth };
}

export function jobOfFit(fit: Fit, owner: LearnedService): Job {
  const kind = `fit ${String(fit.config.method ?? owner)}`;
  return { ...common(fit), owner, kind, about: `${fit.dataset} → ${fit.model_name || "default"}`, truth: "" };
}

function common(job: Run | Fit) {
  const { id, state, config, step, steps, metrics, error } = job;
  return {
    id,
    state,
    config,
    step,
    steps,
    metrics: metrics ?? {},
    model: job.model ?? null,
    error,
    time: job.time_ns / 1e6,
  };
}

/** Returns a job out of a message of its service, such as an event. */
export function jobOf(message: { run?: Run | null; fit?: Fit | null }, owner: Owner): Job {
  if (message.run) return jobOfRun(message.run);
  return jobOfFit(message.fit!, owner as LearnedService);
}

export interface Jobs {
  readonly jobs: readonly Job[];
  /** Whether a service has older ones, too. */
  readonly areMore: boolean;
  /** Services that did not answer. */
  readonly away: readonly { readonly owner: Owner; readonly problem: Problem }[];
}

export const FEW_JOBS = 100;
export const MOST_JOBS = 1000;

/** Returns the newest jobs of all services; one that is away hides only its own.
 *
 * @param most Number of jobs of each service, at most 1000.
 */
export async function listJobs(signal: AbortSignal, most = MOST_JOBS): Promise<Jobs> {
  const answers = await Promise.all(
    OWNERS.map(async (owner) => ({ owner, found: await listOf(owner, most, signal).catch(asProblem) })),
  );
  const jobs = answers.flatMap(({ found }) => (found instanceof Problem ? [] : found));
  const away = answers.flatMap(({ owner, found }) => (found instanceof Problem ? [{ owner, problem: found }] : []));
  if (away.length === OWNERS.length) throw away[0]!.problem;
  const areMore = answers.some(({ found }) => !(found instanceof Problem) && found.length >= most);
  return { jobs: jobs.sort((a, b) => b.time - a.time), areMore, away };
}

/** Returns the newest jobs of a service; its pages may be shorter than asked for. */
async function listOf(owner: Owner, most: number, signal: AbortSignal): Promise<Job[]> {
  const jobs: Job[] = [];
  let page_token = "";
  do {
    const page = await pageOf(owner, { page_size: most, page_token }, signal);
    jobs.push(...page.jobs);
    page_token = page.next;
  } while (page_token !== "" && jobs.length < most);
  return jobs;
}

type PageRequest = { readonly page_size: number; readonly page_token: string };

async function pageOf(owner: Owner, request: PageRequest, signal: AbortSignal): Promise<{ jobs: Job[]; next: string }> {
  if (owner === "orchestrator") {
    const { runs, next_page_token } = await call("orchestrator/list-runs", request, { signal });
    return { jobs: runs.map(jobOfRun), next: next_page_token };
  }
  const { fits, next_page_token } = await call(`${owner}/list-fits`, request, { signal });
  return { jobs: fits.map((fit) => jobOfFit(fit, owner)), next: next_page_token };
}

/** Path of the job's stream of events. */
export function watchPath(owner: Owner, id: string): string {
  return owner === "orchestrator" ? `/v1/watch-run?id=${id}` : `/services/${owner}/v1/watch-fit?id=${id}`;
}

export async function cancel(job: Job): Promise<void> {
  await (job.owner === "orchestrator"
    ? call("orchestrator/cancel-run", { id: job.id })
    : call(`${job.owner}/cancel-fit`, { id: job.id }));
}

export async function resume(job: Job): Promise<void> {
  await (job.owner === "orchestrator"
    ? call("orchestrator/resume-run", { id: job.id })
    : call(`${job.owner}/resume-fit`, { id: job.id }));
}

export async function remove(job: Job): Promise<void> {
  await (job.owner === "orchestrator"
    ? call("orchestrator/delete-run", { id: job.id })
    : call(`${job.owner}/delete-fit`, { id: job.id }));
}

const MOST_ROWS = 10_000;

/** Returns rows of metrics from a step on, and the step that returns only later ones. */
export async function metricsOf(
  owner: Owner,
  id: string,
  fromStep: number,
): Promise<{ rows: readonly MetricRow[]; next: number }> {
  const request = { id, from_step: fromStep, max_rows: MOST_ROWS, keep_extremes: true };
  const reply = await (owner === "orchestrator"
    ? call("orchestrator/get-metrics", request)
    : call(`${owner}/get-fit-metrics`, request));
  return { rows: reply.rows, next: reply.next_step };
}

export async function artifactsOf(job: Job): Promise<readonly Artifact[]> {
  return job.owner === "orchestrator" ? (await call("orchestrator/list-artifacts", { id: job.id })).artifacts : [];
}

export function artifactPath(job: Job, name: string): string {
  return `/v1/get-artifact?${new URLSearchParams({ id: job.id, name })}`;
}
