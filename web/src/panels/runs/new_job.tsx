/** A form for each kind of run and each method of a fit, made from the schema of its configuration. */
import { useState } from "preact/hooks";
import { call, LEARNED, prefixOf, send, type LearnedService } from "../../api/client";
import { asProblem, type Problem } from "../../api/problem";
import { useRemote } from "../../api/remote";
import { configOf, configSchemas, constantsOf, fieldsOf, type Schema } from "../../form/schema";
import { ConfigFields, KnownNames, type Names } from "../../form/fields";
import { Failed, Shown } from "../../parts/notice";
import { amend, open, query } from "../../url/location";

interface Choice {
  readonly title: string;
  readonly service: "orchestrator" | LearnedService;
  readonly schema: Schema;
}

export function NewJob({ what }: { what: "run" | "fit" }) {
  const [remote, retry] = useRemote((signal) => choicesOf(what, signal), what);
  return (
    <Shown remote={remote} what="the kinds" retry={retry}>
      {(choices) => <Chooser what={what} choices={choices} />}
    </Shown>
  );
}

/** Returns what can be started; methods of a service that is away are missing. */
async function choicesOf(what: "run" | "fit", signal: AbortSignal): Promise<Choice[]> {
  const services = what === "run" ? (["orchestrator"] as const) : LEARNED;
  const request = what === "run" ? "StartRunRequest" : "StartFitRequest";
  const answers = await Promise.allSettled(
    services.map(async (service) => {
      const document: unknown = await (await send(`${prefixOf(service)}/openapi.json`, { signal })).json();
      return configSchemas(document, request).map((schema) => ({ title: schema.title ?? service, service, schema }));
    }),
  );
  const refused = answers.find((each) => each.status === "rejected");
  if (refused && answers.every((each) => each.status === "rejected")) throw refused.reason;
  return answers.flatMap((each) => (each.status === "fulfilled" ? each.value : []));
}

/** Returns the names of datasets and tasks, as far as their services answer. */
async function namesOf(signal: AbortSignal): Promise<Names> {
  const [datasets, tasks] = await Promise.allSettled([
    call("orchestrator/list-datasets", { page_size: 1000 }, { signal }),
    call("sim/list-tasks", {}, { signal }),
  ]);
  return {
    dataset: datasets.status === "fulfilled" ? datasets.value.datasets.map((each) => each.name) : [],
    task: tasks.status === "fulfilled" ? tasks.value.tasks.map((each) => each.name) : [],
  };
}

function Chooser({ what, choices }: { what: "run" | "fit"; choices: readonly Choice[] }) {
  const nameOf = (choice: Choice): string => (what === "run" ? choice.title : `${choice.service}: ${choice.title}`);
  const [names] = useRemote(namesOf, "names");
  const chosen = choices.find((each) => nameOf(each) === query.value.kind) ?? choices[0];
  if (!chosen) return <p>The services describe no kinds. They may be of an older version than this page.</p>;
  return (
    <>
      <label class="filter">
        {what === "run" ? "Kind" : "Method"}
        <select value={nameOf(chosen)} onChange={(event) => amend({ kind: event.currentTarget.value })}>
          {choices.map((each) => (
            <option key={nameOf(each)}>{nameOf(each)}</option>
          ))}
        </select>
      </label>
      {chosen.schema.description && <p>{chosen.schema.description}</p>}
      <JobForm key={nameOf(chosen)} choice={chosen} names={names.state === "ready" ? names.value : {}} />
    </>
  );
}

function JobForm({ choice, names }: { choice: Choice; names: Names }) {
  const isFit = choice.service !== "orchestrator";
  const fields = fieldsOf(choice.schema);
  const [texts, setTexts] = useState<Readonly<Record<string, string>>>({});
  const [target, setTarget] = useState({ dataset: query.peek().dataset ?? "", model: "" });
  const [problem, setProblem] = useState<Problem | null>(null);
  const [isTried, setTried] = useState(false);
  const { config, errors } = configOf(fields, texts);
  const start = async (event: Event): Promise<void> => {
    event.preventDefault();
    setTried(true);
    if (Object.keys(errors).length > 0) return focusFirst(Object.keys(errors)[0]!);
    setProblem(null);
    try {
      const whole = { ...constantsOf(choice.schema), ...config };
      const idempotency_key = newKey();
      if (isFit) {
        const service = choice.service as LearnedService;
        const request = { dataset: target.dataset, model_name: target.model, config: whole, idempotency_key };
        const { fit } = await call(`${service}/start-fit`, request);
        open({ view: "runs", start: "", kind: "", dataset: "", job: `${service}/${fit!.id}` });
      } else {
        const kind = choice.title.split(" ")[0]!;
        const { run } = await call("orchestrator/start-run", { kind, config: whole, idempotency_key });
        open({ view: "runs", start: "", kind: "", dataset: "", job: `orchestrator/${run!.id}` });
      }
    } catch (error) {
      setProblem(asProblem(error));
    }
  };
  return (
    <form class="card job-form" onSubmit={(event) => void start(event)} noValidate>
      {Object.entries(names).map(([key, each]) => (
        <datalist key={key} id={`names-${key}`}>
          {each.map((name) => (
            <option key={name} value={name} />
          ))}
        </datalist>
      ))}
      {isFit && (
        <div class="field-grid">
          <label>
            dataset (needed)
            <input
              required
              list="names-dataset"
              value={target.dataset}
              onInput={(event) => setTarget({ ...target, dataset: event.currentTarget.value })}
            />
            <KnownNames names={names.dataset} />
          </label>
          <label>
            model_name
            <input
              value={target.model}
              placeholder="default"
              onInput={(event) => setTarget({ ...target, model: event.currentTarget.value })}
            />
          </label>
        </div>
      )}
      <ConfigFields
        fields={fields}
        names={names}
        texts={texts}
        errors={isTried ? errors : {}}
        onText={(key, text) => setTexts({ ...texts, [key]: text })}
      />
      {problem && <Failed problem={problem} />}
      <div class="buttons">
        <button type="submit" class="main-action">
          Start
        </button>
      </div>
      <details>
        <summary>What is sent</summary>
        <pre tabIndex={0}>{JSON.stringify({ ...constantsOf(choice.schema), ...config }, null, 2)}</pre>
      </details>
    </form>
  );
}

/** Returns 32 random hexadecimal digits; `randomUUID` is missing beyond loopback without TLS. */
function newKey(): string {
  return [...crypto.getRandomValues(new Uint8Array(16))].map((each) => each.toString(16).padStart(2, "0")).join("");
}

function focusFirst(key: string): void {
  document.getElementById(`field-${key}`)?.focus();
}
