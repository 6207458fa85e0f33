/** Which jobs saw what no learner is given: true states, true rewards, true labels. */
import type { Job } from "./job";

const PRIVILEGED_REWARDS = ["oracle", "vice"];

/** Returns what a job saw of the truth, in words; empty for nothing. */
export function truthSeen(job: Pick<Job, "kind" | "config">): string {
  if (job.kind === "evaluate") return "measures against true states";
  const reward = String(job.config.reward ?? "");
  if (job.kind === "ppo" && PRIVILEGED_REWARDS.includes(reward)) return `trained on the privileged reward ${reward}`;
  const steps = Array.isArray(job.config.steps)
    ? (job.config.steps as { kind?: string; config?: Record<string, unknown> }[])
    : [];
  const seen = steps.map((each) => truthSeen({ kind: each.kind ?? "", config: each.config ?? {} })).find(Boolean);
  return seen ?? (job.kind === "skills" ? "its evaluation measures against true states" : "");
}
