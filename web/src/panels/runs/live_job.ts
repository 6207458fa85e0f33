/** A job that is watched: its state and its curves, as events and metrics arrive. */
import { signal } from "@preact/signals";
import type { Problem } from "../../api/problem";
import type { Fit, Run } from "../../api/types";
import { follow } from "../../events/follow";
import type { ServerEvent } from "../../events/parser";
import { isOver, jobOf, metricsOf, watchPath, type Job, type Owner } from "./job";
import { appended, markOf, type Mark, type Series } from "./series";

const METRICS_MS = 400;

export class LiveJob {
  readonly job = signal<Job | null>(null);
  readonly series = signal<Series>({});
  readonly marks = signal<readonly Mark[]>([]);
  /** Why the stream is broken; null while it flows. */
  readonly broken = signal<Problem | null>(null);
  private readonly aborting = new AbortController();
  private nextStep = 0;
  private timer = 0;

  constructor(
    readonly owner: Owner,
    readonly id: string,
  ) {
    this.watch();
  }

  /** Follows the stream from its beginning; a resumed job is watched anew. */
  private watch(): void {
    void follow(watchPath(this.owner, this.id), {
      signal: this.aborting.signal,
      onEvent: (event) => this.take(event),
      onBreak: (problem) => {
        this.broken.value = problem;
      },
    });
  }

  close(): void {
    this.aborting.abort();
    window.clearTimeout(this.timer);
  }

  private take(event: ServerEvent): boolean {
    const after = jobOf(JSON.parse(event.data) as { run?: Run; fit?: Fit }, this.owner);
    const mark = markOf(this.job.peek(), after);
    if (mark) this.marks.value = [...this.marks.peek(), mark];
    this.job.value = after;
    this.scheduleMetrics(METRICS_MS);
    return isOver(after.state);
  }

  private scheduleMetrics(ms: number): void {
    if (this.timer === 0) this.timer = window.setTimeout(() => void this.loadMetrics(), ms);
  }

  private async loadMetrics(): Promise<void> {
    this.timer = 0;
    try {
      const { rows, next } = await metricsOf(this.owner, this.id, this.nextStep);
      if (this.aborting.signal.aborted) return;
      this.nextStep = next;
      this.series.value = appended(this.series.peek(), rows);
      if (rows.length > 0) this.scheduleMetrics(METRICS_MS); // rows that no event follows, as the last ones
    } catch {
      // The next event asks again.
    }
  }
}
