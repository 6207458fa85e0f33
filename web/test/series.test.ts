import assert from "node:assert/strict";
import { test } from "node:test";
import { appended, checkpointSteps, inOrder, markOf } from "../src/panels/runs/series";

const row = (step: number, value: number) => ({ step, metrics: { loss: value } });

test("rows that come again, as after a break, are no further points", () => {
  const once = appended({}, [row(1, 0.5), row(2, 0.4)]);
  const again = appended(once, [row(2, 0.4), row(3, 0.3)]);
  assert.deepEqual(again.loss, { x: [1, 2, 3], y: [0.5, 0.4, 0.3] });
  assert.deepEqual(once.loss!.x, [1, 2]);
});

test("metrics that are not in every row have their own steps", () => {
  const series = appended(appended({}, [row(1, 1)]), [{ step: 2, metrics: { loss: 1, validation: 7 } }]);
  assert.deepEqual(series.validation, { x: [2], y: [7] });
});

test("events mark interruptions, resumes and bad ends", () => {
  const running = { state: "running", step: 4, error: "" };
  const killed = { ...running, error: "The child process was killed by SIGKILL." };
  assert.equal(markOf(null, running), null);
  assert.equal(markOf(running, killed)!.kind, "interrupted");
  assert.equal(markOf(killed, killed), null);
  assert.equal(markOf({ ...running, state: "cancelled" }, { ...running, state: "queued" })!.kind, "resumed");
  assert.equal(markOf(running, { state: "failed", step: 5, error: "no" })!.text, "failed: no");
});

test("checkpoints are known from the configuration", () => {
  assert.deepEqual(checkpointSteps({ checkpoint_every: 50 }, 170), [50, 100, 150]);
  assert.deepEqual(checkpointSteps({}, 170), []);
});

test("returns come before losses, and both before the rest", () => {
  assert.deepEqual(inOrder(["lr", "train_loss", "episode_return"]), ["episode_return", "train_loss", "lr"]);
});
