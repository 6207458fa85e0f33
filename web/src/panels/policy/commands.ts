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
  readonly cameras: readonly string[];
  readonly model: string;
  /** Of the newest step; empty before the first. */
  readonly actions: readonly number[];
  readonly goal: Goal;
  /** Whether the services need the token of FREEREIN_TOKEN. */
  readonly needsToken: boolean;
}

/** Returns the newest calls of an episode. */
export function written(calls: Calls): Written[] {
  return [create(calls), act(calls), ...(calls.actions.length > 0 ? [step(calls)] : [])];
}

function create(calls: Calls): Written {
  const { task, seed, cameras } = calls;
  return {
    name: "CreateSession",
    curl: `${curl(calls, "sim/v1/create-session")} --json ${quoted(JSON.stringify({ task, seed }))}`,
    python: [
      ...(calls.needsToken ? ["import os", ""] : []),
      "from freerein.envs import SimEnv",
      "",
      `env = SimEnv(${JSON.stringify(task)}, "localhost:9104", cameras=${tuple(cameras)}${token(calls)})`,
      `${seen(cameras)}, _ = env.reset(seed=${seed})`,
    ].join("\n"),
  };
}

function act(calls: Calls): Written {
  const { cameras, model, goal } = calls;
  const parts =
    goal.form === "images"
      ? imageParts(
          "goal.images",
          goal.landmarks.map((_, index) => `landmark${index + 1}-`),
          cameras,
        )
      : goal.form === "recipe"
        ? goal.skills.map((each) => `-F goal.recipe=${each}`)
        : [`-F goal.text=${quoted(goal.text)}`];
  const python =
    goal.form === "images"
      ? cameras.length === 1
        ? "Goal(tuple(images.encode(each) for each in landmarks))"
        : "Goal(tuple(images.encode(each, camera=name) for frames in landmarks for name, each in frames.items()))"
      : goal.form === "recipe"
        ? `Goal(recipe=${tuple(goal.skills)})`
        : `Goal(text=${JSON.stringify(goal.text)})`;
  return {
    name: "Act",
    curl: [
      `${curl(calls, "imitation/v1/act?tensors=list")} -F model.name=${model}`,
      ...imageParts("observation.images", [""], cameras),
      ...parts,
    ].join(" \\\n  "),
    python: [
      ...(calls.needsToken ? ["import os", ""] : []),
      "from freerein import images",
      "from freerein.clients import Channel, ImitationClient, SyncClient",
      "from freerein.types.common import Goal, ModelRef, Observation",
      "from freerein.types.imitation import ActRequest",
      "",
      `with SyncClient(ImitationClient(Channel("localhost:9102"${token(calls)}))) as policy:`,
      `    goal = ${python}`,
      cameras.length === 1
        ? `    seen = Observation((images.encode(frame, camera=${JSON.stringify(cameras[0])}),))`
        : "    seen = Observation(tuple(images.encode(each, camera=name) for name, each in frames.items()))",
      `    reply = policy.act(ActRequest(model=ModelRef(${JSON.stringify(model)}), observation=seen, goal=goal))`,
    ].join("\n"),
  };
}

/** Returns images of all cameras as parts of a form: files or, of several cameras, JSON that names them. */
function imageParts(field: string, prefixes: readonly string[], cameras: readonly string[]): string[] {
  const files = prefixes.flatMap((prefix) => cameras.map((camera) => ({ camera, name: `${prefix}${camera}.png` })));
  if (cameras.length === 1) return files.map(({ name }) => `-F ${field}=@${name}`);
  const images = files.map(
    ({ camera, name }) => `{"encoding":"png","camera":"${camera}","data":"'$(base64 -w0 ${name})'"}`,
  );
  return [`-F '${field}=[${images.join(",")}]'`];
}

function step(calls: Calls): Written {
  const { session, stepId, cameras, actions } = calls;
  const shown = actions.map((each) => Math.round(each * 1e4) / 1e4);
  const body = JSON.stringify({ session, step_id: stepId, actions: [shown], cameras });
  return {
    name: "Step",
    curl: `${curl(calls, "sim/v1/step?tensors=list")} --json ${quoted(body)}`,
    python: `${seen(cameras)}, *_ = env.step(reply.actions[0])`,
  };
}

function curl({ origin, needsToken }: Calls, path: string): string {
  return `curl ${quoted(`${origin}/services/${path}`)}${needsToken ? ' -H "Authorization: Bearer $FREEREIN_TOKEN"' : ""}`;
}

function token({ needsToken }: Calls): string {
  return needsToken ? ', token=os.environ["FREEREIN_TOKEN"]' : "";
}

/** What `SimEnv` returns: the frame of one camera, or those of several by name. */
function seen(cameras: readonly string[]): string {
  return cameras.length === 1 ? "frame" : "frames";
}

/** Quotes for a shell. */
function quoted(text: string): string {
  return `'${text.replaceAll("'", "'\\''")}'`;
}

function tuple(items: readonly string[]): string {
  return `(${items.map((each) => JSON.stringify(each)).join(", ")}${items.length === 1 ? "," : ""})`;
}
