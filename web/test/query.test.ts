import assert from "node:assert/strict";
import { test } from "node:test";
import { changed, formatQuery, parseQuery } from "../src/url/query";

test("a state is the same after a way through the URL", () => {
  const query = { view: "segments", t: "6.41", dataset: "a&b=c" };
  assert.deepEqual(parseQuery(formatQuery(query).slice(1)), query);
});

test("the first state is the page's own address, and view comes first", () => {
  assert.equal(formatQuery({}), "/");
  assert.equal(formatQuery({ t: "1", view: "runs", run: "" }), "/?view=runs&t=1");
});

test("another view forgets what the last one held, the same one does not", () => {
  assert.deepEqual(changed({ view: "segments", t: "6" }, { view: "runs" }), { view: "runs" });
  assert.deepEqual(changed({ view: "segments", t: "6" }, { t: "" }), { view: "segments" });
});
