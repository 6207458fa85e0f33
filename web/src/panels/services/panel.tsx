/** Services: ready, version, latency, queue, rejects; one that is away is named, with what to do. */
import { SERVICES, prefixOf, send, type Service } from "../../api/client";
import { useRemote } from "../../api/remote";
import { Shown } from "../../parts/notice";
import { useTicks } from "../../parts/ticks";
import { readiness } from "./health";
import { parseMetrics, quantile, sum, type Sample } from "./prometheus";

const PERIOD_MS = 5000;
const DOES: Record<Service, string> = {
  orchestrator: "runs, datasets, this page",
  segmentation: "a skill for every timestep",
  imitation: "actions towards goals",
  reward: "rewards from sentences",
  sim: "worlds",
};

export function ServicesPanel() {
  const turn = useTicks(PERIOD_MS);
  return (
    <>
      <h1>Services</h1>
      <p class="lede">The five programs behind this page, how long their calls take, and what they refuse.</p>
      <div class="cards">
        {SERVICES.map((each) => (
          <ServiceCard key={each} service={each} turn={turn} />
        ))}
      </div>
    </>
  );
}

function ServiceCard({ service, turn }: { service: Service; turn: number }) {
  const state = readiness.value[service];
  const [remote, retry] = useRemote((signal) => figuresOf(service, signal), service, turn);
  return (
    <section class="card service" aria-labelledby={`service-${service}`}>
      <h2 id={`service-${service}`}>
        {service} <span class={`state ${state === "ready" ? "good" : state === "unknown" ? "" : "bad"}`}>{state}</span>
      </h2>
      <p class="faint">{DOES[service]}</p>
      {state === "away" ? (
        <p class="service-away">
          Nobody answers. Start all services with <code>freerein up</code>, or look at why with{" "}
          <code>freerein doctor {service}</code>.
        </p>
      ) : (
        <Shown remote={remote} what="figures" retry={retry}>
          {(figures) => (
            <dl class="figures">
              {Object.entries(figures).map(([name, value]) => (
                <div key={name}>
                  <dt>{name}</dt>
                  <dd>{value}</dd>
                </div>
              ))}
            </dl>
          )}
        </Shown>
      )}
    </section>
  );
}

const versions = new Map<Service, string>();

async function figuresOf(service: Service, signal: AbortSignal): Promise<Record<string, string>> {
  const metrics = parseMetrics(await (await send(`${prefixOf(service)}/metrics`, { signal })).text());
  if (!versions.has(service)) {
    const document = (await (await send(`${prefixOf(service)}/openapi.json`, { signal })).json()) as {
      info: { version: string };
    };
    versions.set(service, document.info.version);
  }
  const isUnary = (labels: Sample["labels"]): boolean => labels.method !== "other";
  const isReject = (labels: Sample["labels"]): boolean =>
    ["overloaded", "too_large", "deadline_exceeded"].includes(labels.code ?? "");
  return {
    version: versions.get(service)!,
    calls: String(sum(metrics, "freerein_calls_total", isUnary)),
    "median (p50)": milliseconds(quantile(metrics, "freerein_call_seconds", 0.5, isUnary)),
    "slowest 1 % (p99)": milliseconds(quantile(metrics, "freerein_call_seconds", 0.99, isUnary)),
    waiting: String(sum(metrics, "freerein_queued_items")),
    refused: String(sum(metrics, "freerein_calls_total", isReject)),
    "open streams": String(sum(metrics, "freerein_open_streams")),
    "free disk": gigabytes(sum(metrics, "freerein_data_free_bytes")),
  };
}

function milliseconds(seconds: number | null): string {
  if (seconds === null) return "none yet";
  const ms = seconds * 1000;
  return `${ms < 10 ? ms.toFixed(1) : ms.toFixed(0)} ms`;
}

function gigabytes(bytes: number): string {
  return bytes > 0 ? `${(bytes / 1e9).toFixed(1)} GB` : "unknown";
}
