import assert from "node:assert/strict";
import { test } from "node:test";
import { thin } from "../src/curves/thin";

const x = Array.from({ length: 100_000 }, (_, index) => index);
const y = x.map((index) => Math.sin(index / 900) + (index === 54_321 ? 9 : 0));

test("a curve keeps its ends, its extremes and its order", () => {
  const { x: kept, y: values } = thin({ x, y }, 2000);
  assert.ok(kept.length <= 2000 && kept.length >= 1000);
  assert.deepEqual([kept[0], kept.at(-1)], [0, 99_999]);
  assert.ok(kept.includes(54_321) && Math.max(...values) === y[54_321]);
  assert.ok(kept.every((each, index) => index === 0 || each > kept[index - 1]!));
});

test("a short curve is left as it is", () => {
  const short = { x: [1, 2], y: [3, 4] };
  assert.equal(thin(short, 8), short);
});
