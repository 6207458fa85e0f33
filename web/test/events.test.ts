import assert from "node:assert/strict";
import { test } from "node:test";
import { EventParser } from "../src/events/parser";

const STREAM = ': waiting\n\nid: 4\ndata: {"a":1}\n\nid: 5\r\ndata: two\r\ndata: lines\r\n\r\n';

test("events are the same however the stream is cut into pieces", () => {
  const expected = [
    { id: "4", data: '{"a":1}' },
    { id: "5", data: "two\nlines" },
  ];
  for (let size = 1; size <= STREAM.length; size += 1) {
    const parser = new EventParser();
    const pieces = Array.from({ length: Math.ceil(STREAM.length / size) }, (_, i) =>
      STREAM.slice(i * size, (i + 1) * size),
    );
    assert.deepEqual(
      pieces.flatMap((piece) => parser.push(piece)),
      expected,
      `pieces of ${size}`,
    );
  }
});

test("an event that the stream broke off is none", () => {
  assert.deepEqual(new EventParser().push("id: 6\ndata: half"), []);
});
