import assert from "node:assert/strict";
import { test } from "node:test";
import { fromBase64, numbersOf, toBase64 } from "../src/api/tensors";

test("bytes are the same after a way through base64, also many", () => {
  const bytes = Uint8Array.from({ length: 100_001 }, (_, index) => index % 256);
  assert.deepEqual(fromBase64(toBase64(bytes)), bytes);
});

test("elements are read little-endian in their datatype", () => {
  const raw = toBase64(new Uint8Array(new Float32Array([0.5, -2]).buffer));
  assert.deepEqual(numbersOf({ datatype: "FP32", shape: [2], raw }), [0.5, -2]);
  const whole = toBase64(new Uint8Array(new BigInt64Array([-1n, 7n]).buffer));
  assert.deepEqual(numbersOf({ datatype: "INT64", shape: [2], raw: whole }), [-1, 7]);
});
