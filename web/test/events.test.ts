import assert from "node:assert/strict";
import { mock, test } from "node:test";
import { follow } from "../src/events/follow";
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

/** Follows a stream that is first refused, then whole; returns what was asked for when, in milliseconds. */
async function followedAfter(status: number, headers: Record<string, string>): Promise<number[]> {
  mock.timers.enable({ apis: ["setTimeout", "Date"] });
  const asked: number[] = [];
  globalThis.fetch = async () => {
    asked.push(Date.now());
    return asked.length === 1 ? Response.json({}, { status, headers }) : new Response('id: 1\ndata: "end"\n\n');
  };
  let isOver = false;
  const following = { signal: new AbortController().signal, onEvent: () => true, onBreak: () => undefined };
  void follow("/v1/watch-run", following).then(() => (isOver = true));
  while (!isOver) {
    await new Promise((resolve) => setImmediate(resolve));
    mock.timers.tick(500);
  }
  mock.timers.reset();
  return asked;
}

test("a stream that is refused for a while is taken up again, not before Retry-After", async () => {
  const [first, second] = await followedAfter(429, { "retry-after": "20" });
  assert.ok(second! - first! >= 20_000);
  assert.equal((await followedAfter(408, {})).length, 2);
});

test("a stream that is refused for good is not asked for again", async () => {
  assert.equal((await followedAfter(404, {})).length, 1);
});
