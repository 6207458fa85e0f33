/** Which services are ready, asked every few seconds while the page is seen. */
import { signal } from "@preact/signals";
import { SERVICES, prefixOf, type Service } from "../../api/client";
import { Link } from "../../parts/link";
import { query } from "../../url/location";

export type Readiness = "unknown" | "ready" | "not ready" | "away";

const FIRST_MS = 250;
const PERIOD_MS = 3000;
const PATIENCE_MS = 2500;

export const readiness = signal<Readonly<Record<Service, Readiness>>>({
  orchestrator: "unknown",
  segmentation: "unknown",
  imitation: "unknown",
  reward: "unknown",
  sim: "unknown",
});

/** Asks until the returned function is called; at first once the page is there, which it would hold up. */
export function watchHealth(): () => void {
  const ask = (): void => {
    if (document.visibilityState === "visible") void Promise.all(SERVICES.map(askOne));
  };
  const first = window.setTimeout(ask, FIRST_MS);
  const timer = window.setInterval(ask, PERIOD_MS);
  return () => {
    window.clearTimeout(first);
    window.clearInterval(timer);
  };
}

async function askOne(service: Service): Promise<void> {
  const found = await readinessOf(service);
  if (readiness.value[service] !== found) readiness.value = { ...readiness.value, [service]: found };
}

/** A service that is there says so itself, ready or not; of one that is away the orchestrator says it. */
async function readinessOf(service: Service): Promise<Readiness> {
  try {
    const reply = await fetch(`${prefixOf(service)}/readyz`, { signal: AbortSignal.timeout(PATIENCE_MS) });
    if (reply.ok) return "ready";
    const body = (await reply.json()) as { ready?: boolean };
    return body.ready === false ? "not ready" : "away";
  } catch {
    return "away";
  }
}

/** How many services are ready, as a link to the view that says more. */
export function Health() {
  const states = SERVICES.map((each) => readiness.value[each]);
  const ready = states.filter((each) => each === "ready").length;
  const missing = SERVICES.filter((each) => ["away", "not ready"].includes(readiness.value[each]));
  return (
    <span class={`health ${missing.length > 0 ? "warning" : ""}`}>
      <Link to={{ view: "services" }} current={query.value.view === "services"}>
        {missing.length === 0
          ? `${ready} of ${SERVICES.length} ready`
          : missing.map((each) => `${each} ${readiness.value[each]}`).join(", ")}
      </Link>
    </span>
  );
}
