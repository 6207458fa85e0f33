import assert from "node:assert/strict";
import { test } from "node:test";
import { configOf, constantsOf, fieldsOf, parseField, type Schema } from "../src/form/schema";

const SCHEMA: Schema = {
  required: ["task"],
  properties: {
    method: { const: "skills" },
    form: { enum: ["returns"] },
    count: { type: "integer", minimum: 1, maximum: 1000, default: 100, description: "Trajectories." },
    task: { type: "string" },
    lr: { type: "number", minimum: 1e-7, maximum: 1, default: 0.001 },
    behaviour: { enum: ["expert", "random"], default: "expert" },
    skills: { type: "array", items: { type: "string" }, default: [] },
    context: { anyOf: [{ type: "integer", minimum: 0, maximum: 200 }, { enum: ["all"] }], default: "all" },
    config: { type: "object", default: {} },
  },
};
const FIELDS = fieldsOf(SCHEMA);

test("needed fields come first, and constants are not asked for", () => {
  const keys = FIELDS.map((field) => field.key);
  assert.deepEqual(keys, ["task", "count", "lr", "behaviour", "skills", "context", "config"]);
  assert.deepEqual(constantsOf(SCHEMA), { method: "skills", form: "returns" });
});

test("a configuration has what differs from the defaults, each value in its type", () => {
  const texts = { task: "blocks", count: "5", lr: "0.001", skills: "a, b", context: "5", config: '{"steps": 600}' };
  const { config, errors } = configOf(FIELDS, texts);
  assert.deepEqual(config, { task: "blocks", count: 5, skills: ["a", "b"], context: 5, config: { steps: 600 } });
  assert.deepEqual(errors, {});
});

test("an error says what was expected and what came", () => {
  const { errors } = configOf(FIELDS, { count: "1.5", lr: "2", config: "{steps" });
  assert.equal(errors.task, "task is needed.");
  assert.match(errors.count!, /whole number; got “1.5”/);
  assert.match(errors.lr!, /1e-7 to 1; got 2/);
  assert.match(errors.config!, /JSON/);
});

test("a word of a choice beside numbers needs no quotes", () => {
  const context = FIELDS.find((field) => field.key === "context")!;
  assert.deepEqual(parseField(context, "all"), { value: "all" });
  assert.equal(context.bounds, "0 to 200, or all");
});
