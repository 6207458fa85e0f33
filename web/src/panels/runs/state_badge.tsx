/** The state of a job, as a word. */
import type { State } from "./job";

const CLASSES: Record<State, string> = {
  queued: "",
  running: "active",
  succeeded: "good",
  failed: "bad",
  cancelled: "",
};

export function StateBadge({ state }: { state: State }) {
  return <span class={`state ${CLASSES[state]}`}>{state}</span>;
}
