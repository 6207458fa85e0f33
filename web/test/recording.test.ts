import assert from "node:assert/strict";
import { test } from "node:test";
import { webVtt } from "../src/panels/segments/export";
import { timeOf, timesAtRate, timesOfVideo, timestepAt, type Recording } from "../src/panels/segments/recording";

const recordingOf = (time_s: readonly number[]): Recording => ({
  title: "",
  timesteps: time_s.length - 1,
  time_s,
  skills: [],
  segments: [],
  confidence: [],
  inDistribution: [],
  frames: null,
  labelledBy: "",
  saved: null,
});

test("subtitles of a video of a variable rate that begins late are at its own times", () => {
  const recording = recordingOf(timesOfVideo([0.5, 0.6, 0.7, 1.2]));
  const segments = [
    { start: 0, end: 3, skill: "reach" },
    { start: 3, end: 4, skill: "pour" },
  ];
  const text = webVtt(segments, (timestep) => timeOf(recording, timestep));
  assert.match(text, /00:00:00.500 --> 00:00:01.200\nreach/);
  assert.match(text, /00:00:01.200 --> 00:00:01.300\npour/);
});

test("a time, rounded as in an address, is found in its timestep, and one outside at the nearer end", () => {
  const recording = recordingOf(timesAtRate(90, 30));
  const rounded = (timestep: number): number => Math.round(timeOf(recording, timestep) * 1000) / 1000;
  assert.deepEqual(
    [0, 1, 2, 50, 89].map((timestep) => timestepAt(recording, rounded(timestep))),
    [0, 1, 2, 50, 89],
  );
  assert.deepEqual(
    [-1, 99, NaN].map((seconds) => timestepAt(recording, seconds)),
    [0, 89, 0],
  );
});

test("a single frame has a length", () => {
  assert.deepEqual(timesOfVideo([0]), [0, 0.1]);
});
