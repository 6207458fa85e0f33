/** A trajectory with its labels, wherever it comes from. */
import type { ModelRef } from "../../api/types";
import type { Segment } from "./edit";
import type { Frames } from "./frames";

/** Below it an answer is not to be trusted; docs/use.md says so of every model. */
export const UNFAMILIAR = 0.03;

export interface Recording {
  readonly title: string;
  readonly timesteps: number;
  /** When each of the timesteps begins, and the last one ends, in seconds: one more than timesteps. */
  readonly time_s: readonly number[];
  readonly skills: readonly string[];
  /** In order; between them nothing has a skill. */
  readonly segments: readonly Segment[];
  /** Of each timestep, in [0, 1]; empty where a person labelled it. */
  readonly confidence: readonly number[];
  /** Of each timestep, in [0, 1]; empty where no model says so. */
  readonly inDistribution: readonly number[];
  /** Null where the browser cannot show the pictures. */
  readonly frames: Frames | null;
  /** Who made the labels, such as `model bins ca2ec60cd3d9`. */
  readonly labelledBy: string;
  /** Where labels can be saved; null where they cannot. */
  readonly saved: { readonly dataset: string; readonly index: number } | null;
}

/** Returns times with a constant number of timesteps per second. */
export function timesAtRate(timesteps: number, fps: number): number[] {
  return Array.from({ length: timesteps + 1 }, (_, timestep) => timestep / fps);
}

const ONE_FRAME_S = 0.1;

/** Returns times of a video, given when its timesteps begin; the last one lasts as long as the others at the median. */
export function timesOfVideo(begins: readonly number[]): number[] {
  const lengths = begins.slice(1).map((each, index) => each - begins[index]!);
  const median = lengths.sort((a, b) => a - b)[lengths.length >> 1] ?? ONE_FRAME_S;
  return [...begins, begins.at(-1)! + median];
}

/** Returns when a timestep begins, in seconds; of the one after the last, when the last one ends. */
export function timeOf(recording: Recording, timestep: number): number {
  return recording.time_s[timestep]!;
}

const ROUNDING_S = 0.001; // times in addresses are rounded to it

/** Returns the timestep at a time in seconds, within the recording. */
export function timestepAt(recording: Recording, seconds: number): number {
  const timestep = recording.time_s.findLastIndex((begin) => begin < seconds + ROUNDING_S);
  return Math.min(Math.max(timestep, 0), recording.timesteps - 1);
}

/** Returns runs of equal labels as segments; labels below 0 have none. */
export function segmentsOf(labels: readonly number[], skills: readonly string[]): Segment[] {
  const segments: Segment[] = [];
  labels.forEach((label, timestep) => {
    const last = segments.at(-1);
    const skill = skills[label] ?? "";
    if (last && last.end === timestep && last.skill === skill)
      segments[segments.length - 1] = { ...last, end: timestep + 1 };
    else segments.push({ start: timestep, end: timestep + 1, skill });
  });
  return segments.filter((each) => each.skill !== "");
}

/** Returns the mean confidence of a segment; null without any. */
export function confidenceOf(recording: Recording, segment: Segment): number | null {
  const within = recording.confidence.slice(segment.start, segment.end);
  return within.length > 0 ? within.reduce((total, each) => total + each, 0) / within.length : null;
}

/** Returns the spans of timesteps that are unlike what the model was fitted on. */
export function unfamiliarSpans(recording: Recording): { start: number; end: number }[] {
  const labels = recording.inDistribution.map((each) => (each < UNFAMILIAR ? 0 : -1));
  return segmentsOf(labels, ["unfamiliar"]);
}

export function describeModel(model: ModelRef | null): string {
  return model ? `model ${model.name} ${model.version}` : "a model";
}
