/** Calls of an episode as they are written by hand: with curl, and with the Python clients. */
import type { Goal } from "./goal";

export interface Written {
  readonly name: string;
  readonly curl: string;
  readonly python: string;
}

interface Calls {
  readonly origin: string;
  readonly task: string;
  readonly seed: number;
  readonly session: string;
  readonly stepId: number;
  readonly camera: string;
  readonly model: string;
  readonly actions: readonly number[];
  readonly goal: Goal;
}

/** Returns the newest calls of an episode. */
export function written(calls: Calls): Written[] {
  return [create(calls), act(calls), step(calls)];
}

function create({ origin, task, seed }: Calls): Written {
  const body = JSON.stringify({ task, seed });
  return {
    name: "CreateSession",
    curl: `curl ${origin}/services/sim/v1/create-session --json ${quoted(body)}`,
    python: `from freerein.envs import SimEnv\n\nenv = SimEnv(${JSON.stringify(task)}, "localhost:9104", cameras=("front",))\nframe, _ = env.reset(seed=${seed})`,
  };
}

function act({ origin, camera, model, goal }: Calls): Written {
  const parts =
    goal.form === "images"
      ? goal.landmarks.map((_, index) => `-F goal.images=@landmark${index + 1}.png`)
      : goal.form === "recipe"
        ? goal.skills.map((each) => `-F goal.recipe=${each}`)
        : [`-F goal.text=${quoted(goal.text)}`];
  const images = "tuple(images.encode(each) for each in landmarks)";
  const python =
    goal.form === "images"
      ? `Goal(${images})`
      : goal.form === "recipe"
        ? `Goal(recipe=${tuple(goal.skills)})`
        : `Goal(text=${JSON.stringify(goal.text)})`;
  return {
    name: "Act",
    curl: [
      `curl ${origin}/services/imitation/v1/act?tensors=list -F model.name=${model}`,
      `-F observation.images=@${camera}.png`,
      ...parts,
    ].join(" \\\n  "),
    python: [
      "from freerein import images",
      "from freerein.clients import Channel, ImitationClient, SyncClient",
      "from freerein.types.common import Goal, ModelRef, Observation",
      "from freerein.types.imitation import ActRequest",
      "",
      'with SyncClient(ImitationClient(Channel("localhost:9102"))) as policy:',
      `    goal = ${python}`,
      `    seen = Observation((images.encode(frame, camera=${JSON.stringify(camera)}),))`,
      `    reply = policy.act(ActRequest(model=ModelRef(${JSON.stringify(model)}), observation=seen, goal=goal))`,
    ].join("\n"),
  };
}

function step({ origin, session, stepId, camera, actions }: Calls): Written {
  const shown = actions.map((each) => Math.round(each * 1e4) / 1e4);
  const body = JSON.stringify({ session, step_id: stepId, actions: [shown], cameras: [camera] });
  return {
    name: "Step",
    curl: `curl ${origin}/services/sim/v1/step?tensors=list --json ${quoted(body)}`,
    python: "frame, *_ = env.step(reply.actions[0])",
  };
}

/** Quotes for a shell. */
function quoted(text: string): string {
  return `'${text.replaceAll("'", "'\\''")}'`;
}

function tuple(items: readonly string[]): string {
  return `(${items.map((each) => JSON.stringify(each)).join(", ")}${items.length === 1 ? "," : ""})`;
}
