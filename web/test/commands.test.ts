import assert from "node:assert/strict";
import { test } from "node:test";
import { written } from "../src/panels/policy/commands";

const CALLS = {
  origin: "http://127.0.0.1:8100",
  task: "grid",
  seed: 7,
  session: "5e55",
  stepId: 3,
  cameras: ["top"],
  model: "goals",
  actions: [0.5],
  goal: { form: "text", text: "it's done" },
  needsToken: false,
} as const;

test("calls have the cameras of the policy, and a URL that every shell takes as it is", () => {
  const [create, act, step] = written(CALLS);
  assert.match(create!.python, /cameras=\("top",\)\)/);
  assert.match(act!.curl, /^curl 'http:\S+\?tensors=list' .*-F observation.images=@top.png/s);
  assert.match(step!.curl, /"step_id":3,"actions":\[\[0.5\]\],"cameras":\["top"\]/);
});

test("a token is read from the environment where one is needed", () => {
  const [create, act] = written({ ...CALLS, needsToken: true });
  assert.match(create!.curl, /-H "Authorization: Bearer \$FREEREIN_TOKEN"/);
  assert.match(create!.python, /import os\n.*token=os.environ\["FREEREIN_TOKEN"\]\)/s);
  assert.match(act!.python, /Channel\("localhost:9102", token=/);
});

test("images of several cameras say which is whose", () => {
  const [create, act] = written({ ...CALLS, cameras: ["top", "wrist"] });
  assert.match(create!.python, /^frames, _ = /m);
  assert.match(act!.curl, /"camera":"wrist","data":"'\$\(base64 -w0 wrist.png\)'"/);
});

test("without a step there is none to repeat", () => {
  assert.deepEqual(
    written({ ...CALLS, actions: [] }).map((each) => each.name),
    ["CreateSession", "Act"],
  );
});
