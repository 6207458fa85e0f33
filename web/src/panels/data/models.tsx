/** Models of the learned services: cards, which version answers, and where each is in use. */
import { useState } from "preact/hooks";
import { call, LEARNED, type LearnedService } from "../../api/client";
import { asProblem, type Problem } from "../../api/problem";
import { useRemote } from "../../api/remote";
import type { Model } from "../../api/types";
import { Link } from "../../parts/link";
import { Empty, Failed, Shown } from "../../parts/notice";
import { say } from "../../parts/say";
import { isOver, listJobs, type Job } from "../runs/job";
import { Card } from "./model_card";

export function Models() {
  const [jobs] = useRemote(async (signal) => (await listJobs(signal)).jobs, "jobs");
  return (
    <>
      {LEARNED.map((each) => (
        <ServiceModels key={each} service={each} jobs={jobs.state === "ready" ? jobs.value : []} />
      ))}
    </>
  );
}

function ServiceModels({ service, jobs }: { service: LearnedService; jobs: readonly Job[] }) {
  const [remote, reload] = useRemote(
    async (signal) => (await call(`${service}/list-models`, {}, { signal })).models,
    service,
  );
  return (
    <section aria-labelledby={`models-${service}`}>
      <h2 id={`models-${service}`} class="models-title">
        {service}
      </h2>
      <Shown remote={remote} what="the models" retry={reload}>
        {(models) =>
          models.length === 0 ? (
            <Empty title="No models">
              <Link to={{ view: "runs", start: "fit" }}>Fit one</Link> to a dataset.
            </Empty>
          ) : (
            <div class="cards">
              {models.map((each) => (
                <ModelCard
                  key={`${each.ref!.name}/${each.ref!.version}`}
                  service={service}
                  model={each}
                  jobs={jobs}
                  onActivated={reload}
                />
              ))}
            </div>
          )
        }
      </Shown>
    </section>
  );
}

interface ModelCardProps {
  readonly service: LearnedService;
  readonly model: Model;
  readonly jobs: readonly Job[];
  readonly onActivated: () => void;
}

function ModelCard({ service, model, jobs, onActivated }: ModelCardProps) {
  const [problem, setProblem] = useState<Problem | null>(null);
  const { name, version } = model.ref!;
  const activate = async (): Promise<void> => {
    setProblem(null);
    try {
      await call(`${service}/activate-model`, { name, version });
      say(`${name} ${version} is active`);
      onActivated();
    } catch (error) {
      setProblem(asProblem(error));
    }
  };
  const users = jobs.filter((each) => names(each.config, name, version));
  const maker = jobs.find((each) => each.model?.version === version && each.model.name === name);
  return (
    <section class="card" aria-labelledby={`model-${version}`}>
      <h3 id={`model-${version}`} class="model-name">
        {name} <code class="faint">{version}</code> {model.active && <span class="state good">active</span>}
      </h3>
      <p class="faint">
        {model.time_ns > 0 ? `published ${new Date(model.time_ns / 1e6).toLocaleString()}` : "comes with freerein"}
        {maker && (
          <>
            ; <Link to={{ view: "runs", job: `${maker.owner}/${maker.id}` }}>how it was made</Link>
          </>
        )}
      </p>
      {users.length > 0 && (
        <p>
          Named by{" "}
          {users.slice(0, 5).map((each, index) => (
            <>
              {index > 0 && ", "}
              <Link key={each.id} to={{ view: "runs", job: `${each.owner}/${each.id}` }}>
                {each.kind}
              </Link>
              {isOver(each.state) ? "" : " (not over)"}
            </>
          ))}
          {users.length > 5 && ` and ${users.length - 5} more`}.
        </p>
      )}
      {!model.active && (
        <button type="button" aria-label={`Activate ${name} ${version}`} onClick={() => void activate()}>
          Activate
        </button>
      )}
      {problem && <Failed problem={problem} />}
      <Card card={model.card} />
    </section>
  );
}

/** Whether a configuration names a version, or a name without a version. */
function names(config: Job["config"], name: string, version: string): boolean {
  const text = JSON.stringify(config);
  return (
    text.includes(`"${version}"`) ||
    ["model", "model_name", "reward_model"].some((key) => config[key] === name && !config.version)
  );
}
