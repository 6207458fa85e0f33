import assert from "node:assert/strict";
import { test } from "node:test";
import { toBase64 } from "../src/api/tensors";
import type { ActResponse, GetSpecResponse, Tensor } from "../src/api/types";

/** What a browser has and Node has not. */
Object.assign(globalThis, {
  window: Object.assign(new EventTarget(), { setInterval: () => 0, clearInterval: () => undefined }),
  ImageData: class {
    readonly data: Uint8ClampedArray;
    constructor(width: number, height: number) {
      this.data = new Uint8ClampedArray(4 * width * height);
    }
  },
});
const { Episode, outcomeOf } = await import("../src/panels/policy/episode");

const IMAGE: Tensor = { datatype: "UINT8", shape: [1, 1, 1, 3], raw: toBase64(new Uint8Array(3)) };
const ACTIONS: Tensor = { datatype: "FP32", shape: [1, 1], raw: toBase64(new Uint8Array(4)) };
const SPEC = {
  model: { name: "m", version: "1" },
  cameras: [{ name: "front" }, { name: "wrist" }],
  reached_threshold: 0.8,
} as unknown as GetSpecResponse;
const FRAMES = { front: IMAGE, wrist: IMAGE };

/** Replies of the services; `asked` lists the calls, and acts wait for `answer`. */
function services() {
  const asked: { name: string; body: Record<string, unknown> }[] = [];
  const waiting: (() => void)[] = [];
  const replies: Record<string, unknown> = {
    "create-session": { session: "s", task: { cameras: SPEC.cameras } },
    act: { actions: ACTIONS, goal_index: 0, goal_confidence: 0, in_distribution: 1, state: "" },
  };
  globalThis.fetch = async (path, init) => {
    const name = String(path).split("/").at(-1)!;
    asked.push({ name, body: JSON.parse(String(init!.body)) });
    if (name === "act") await new Promise<void>((resolve) => waiting.push(resolve));
    return Response.json(replies[name] ?? { frames: FRAMES });
  };
  const count = (name: string): number => asked.filter((each) => each.name === name).length;
  return { asked, count, answer: () => waiting.shift()!() };
}

const settled = (): Promise<void> => new Promise((resolve) => setImmediate(resolve));

async function until(holds: () => boolean): Promise<void> {
  while (!holds()) await settled();
}

async function opened() {
  const service = services();
  const episode = new Episode(SPEC, "blocks", 7);
  await until(() => episode.status.peek() === "ready");
  episode.give({ form: "text", text: "a red block" });
  return { service, episode };
}

test("a second step, or an act, before the first has ended is no second act", async () => {
  const { service, episode } = await opened();
  const [first, second] = [episode.stepOnce(), episode.stepOnce()];
  const acting = episode.run();
  await until(() => service.count("act") === 1);
  service.answer();
  await Promise.all([first, second]);
  assert.equal(episode.executed.peek().length, 1);
  await until(() => service.count("act") === 2);
  void episode.pause();
  service.answer();
  await acting;
  assert.deepEqual(
    service.asked.filter((each) => each.name === "step").map((each) => each.body.step_id),
    [1, 2],
  );
  episode.close();
});

test("after a pause the executed actions are whole, and acting again leaves one loop", async () => {
  const { service, episode } = await opened();
  const before = episode.run();
  await until(() => service.count("act") === 1);
  const paused = episode.pause();
  const after = episode.run();
  service.answer();
  await Promise.all([paused, before]);
  assert.equal(episode.executed.peek().length, 1);
  await until(() => service.count("act") === 2);
  await settled();
  assert.equal(service.count("act"), 2);
  void episode.pause();
  service.answer();
  await after;
  episode.close();
});

test("the images of all cameras of the policy are sent", async () => {
  const { service, episode } = await opened();
  const stepping = episode.stepOnce();
  await until(() => service.count("act") === 1);
  service.answer();
  await stepping;
  const { observation } = service.asked.find((each) => each.name === "act")!.body;
  const { images } = observation as { images: { camera: string }[] };
  assert.deepEqual(
    images.map((each) => each.camera),
    ["front", "wrist"],
  );
  episode.close();
});

test("a second part that is abandoned is not called reached", () => {
  const reply = (goal_index: number, goal_abandoned: boolean, goal_confidence: number): ActResponse =>
    ({ goal_index, goal_abandoned, goal_confidence }) as ActResponse;
  const outcomes = [
    outcomeOf(null, reply(0, false, 0.1), 0.8),
    outcomeOf(null, reply(1, false, 0.9), 0.8),
    outcomeOf(reply(1, false, 0.9), reply(2, true, 0.1), 0.8),
    outcomeOf(reply(2, true, 0.1), reply(3, true, 0.1), 0.8),
    outcomeOf(reply(3, true, 0.1), reply(4, true, 0.9), 0.8),
    outcomeOf(reply(4, true, 0.9), reply(4, true, 0.9), 0.8),
  ];
  assert.deepEqual(outcomes, ["", "reached", "abandoned", "abandoned", "reached", ""]);
});
