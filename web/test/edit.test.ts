import assert from "node:assert/strict";
import { test } from "node:test";
import * as edit from "../src/panels/segments/edit";
import { clock, csv, webVtt } from "../src/panels/segments/export";

const SEGMENTS = [
  { start: 0, end: 4, skill: "reach" },
  { start: 6, end: 9, skill: "pour" },
];

function covers(edited: edit.Edited, timesteps: number): boolean {
  const ends = edited.segments.map((each) => each.end);
  const begins = edited.segments.map((each) => each.start);
  const areInOrder = edited.segments.every((each) => each.start < each.end);
  return areInOrder && JSON.stringify([0, ...ends]) === JSON.stringify([...begins, timesteps]);
}

test("what no segment covers has no skill", () => {
  const names = edit.editing(SEGMENTS, 10).segments.map((each) => each.skill);
  assert.deepEqual(names, ["reach", "", "pour", ""]);
});

test("a boundary stops a timestep before those beside it", () => {
  const edited = edit.editing(SEGMENTS, 10);
  assert.equal(edit.moveBoundary(edited, 1, 99).segments[1]!.start, 5);
  assert.equal(edit.moveBoundary(edited, 1, -3).segments[1]!.start, 1);
  assert.equal(edit.moveBoundary(edited, 0, 3), edited);
});

test("whatever is edited, segments cover every timestep once, and undo goes back to the beginning", () => {
  let edited = edit.editing(SEGMENTS, 10);
  const first = edited.segments;
  let state = 7;
  const random = (below: number): number => {
    state = (state * 48271) % 2147483647;
    return state % below;
  };
  for (let turn = 0; turn < 300; turn += 1) {
    const index = random(edited.segments.length);
    const choices = [
      () => edit.moveBoundary(edited, index, random(12)),
      () => edit.split(edited, random(10)),
      () => edit.join(edited, index),
      () => edit.rename(edited, index, "stir"),
      () => edit.undo(edited),
      () => edit.redo(edited),
    ];
    edited = choices[random(choices.length)]!();
    assert.ok(covers(edited, 10), JSON.stringify(edited.segments));
  }
  while (edited.past.length > 0) edited = edit.undo(edited);
  assert.deepEqual(edited.segments, first);
});

test("a timestep is found in its segment, at its beginning too", () => {
  const { segments } = edit.editing(SEGMENTS, 10);
  assert.deepEqual(
    [0, 3, 4, 6, 9].map((timestep) => edit.indexAt(segments, timestep)),
    [0, 0, 1, 2, 3],
  );
});

test("a drag is undone as one edit", () => {
  const before = edit.editing(SEGMENTS, 10);
  const dragged = [1, 2, 3].reduce((now, to) => edit.moveBoundary(now, 1, to), before);
  assert.deepEqual(edit.undo(edit.asOneEdit(before, dragged)).segments, before.segments);
});

test("files hold what has a skill, in seconds and in timesteps", () => {
  const { segments } = edit.editing(SEGMENTS, 10);
  const text = webVtt(segments, (timestep) => timestep / 4);
  assert.ok(text.startsWith("WEBVTT\n\n00:00:00.000 --> 00:00:01.000\nreach\n"));
  assert.equal(csv(segments, 3), "trajectory,start,end,skill\n3,0,4,reach\n3,6,9,pour\n");
  assert.equal(clock(3723.4567), "01:02:03.457");
});

test("other labels are undone to the edits before them, unless they are of another recording", () => {
  const before = edit.rename(edit.editing(SEGMENTS, 10), 0, "stir");
  const again = edit.editingAgain(before, [{ start: 0, end: 10, skill: "pour" }], 10);
  assert.deepEqual(edit.undo(again).segments, before.segments);
  assert.deepEqual(edit.editingAgain(before, SEGMENTS, 12).past, []);
});
