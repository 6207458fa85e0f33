/** Curves of a job that grow while it runs: rows in order of steps, no step twice. */
import type { Points } from "../../curves/thin";

export interface Row {
  readonly step: number;
  readonly metrics: Readonly<Record<string, number>>;
}

export type Series = Readonly<Record<string, Points>>;

/** Returns series with further rows; a row whose step is not beyond the last one of a metric is left out. */
export function appended(series: Series, rows: readonly Row[]): Series {
  const grown: Record<string, { x: number[]; y: number[] }> = {};
  for (const { step, metrics } of rows) {
    for (const [name, value] of Object.entries(metrics)) {
      grown[name] ??= { x: [...(series[name]?.x ?? [])], y: [...(series[name]?.y ?? [])] };
      const { x, y } = grown[name];
      if (x.length > 0 && step <= x.at(-1)!) continue;
      x.push(step);
      y.push(value);
    }
  }
  return { ...series, ...grown };
}

/** Returns the names of curves in the order in which people look for them: returns, then losses, then the rest. */
export function inOrder(names: readonly string[]): string[] {
  const rank = (name: string): number => (/return|reward|success/.test(name) ? 0 : /loss|accuracy/.test(name) ? 1 : 2);
  return [...names].sort((a, b) => rank(a) - rank(b) || (a < b ? -1 : 1));
}

/** What happened at a step of a job. */
export interface Mark {
  readonly step: number;
  readonly kind: "resumed" | "interrupted" | "cancelled" | "failed";
  readonly text: string;
}

/** A job after an event, as far as marks need it. */
export interface Moment {
  readonly state: string;
  readonly step: number;
  readonly error: string;
}

/** Returns what an event marks on the curves: interruptions, resumes and ends that are no success. */
export function markOf(before: Moment | null, after: Moment): Mark | null {
  const wasOver = before !== null && ["failed", "cancelled", "succeeded"].includes(before.state);
  if (wasOver && (after.state === "queued" || after.state === "running"))
    return { step: before.step, kind: "resumed", text: "resumed" };
  if (after.state === "cancelled") return { step: after.step, kind: "cancelled", text: "cancelled" };
  if (after.state === "failed") return { step: after.step, kind: "failed", text: `failed: ${after.error}` };
  if (after.error !== "" && after.error !== before?.error)
    return { step: after.step, kind: "interrupted", text: after.error };
  return null;
}

/** Returns the steps after which a job saved a checkpoint; none where they would be too many to tell apart. */
export function checkpointSteps(config: Readonly<Record<string, unknown>>, step: number): number[] {
  const every = config.checkpoint_every;
  if (typeof every !== "number" || every <= 0 || step / every > 60) return [];
  return Array.from({ length: Math.floor(step / every) }, (_, index) => (index + 1) * every);
}
