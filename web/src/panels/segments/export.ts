/** Segments as files: WebVTT for players, CSV for `freerein dataset label`. */
import type { Segment } from "./edit";

/** Returns subtitles: each skill is shown while it lasts. */
export function webVtt(segments: readonly Segment[], timeOf: (timestep: number) => number): string {
  const cues = segments
    .filter((each) => each.skill !== "")
    .map((each) => `${clock(timeOf(each.start))} --> ${clock(timeOf(each.end))}\n${each.skill}\n`);
  return ["WEBVTT\n", ...cues].join("\n");
}

/** Returns a table with a row for each segment, in timesteps. */
export function csv(segments: readonly Segment[], trajectory: number): string {
  const rows = segments.filter((each) => each.skill !== "");
  const lines = rows.map((each) => `${trajectory},${each.start},${each.end},${each.skill}\n`);
  return ["trajectory,start,end,skill\n", ...lines].join("");
}

/** Returns a time in seconds as hours:minutes:seconds.milliseconds. */
export function clock(seconds: number): string {
  const ms = Math.round(seconds * 1000);
  const two = (value: number): string => String(value).padStart(2, "0");
  const rest = String(ms % 1000).padStart(3, "0");
  return `${two(Math.floor(ms / 3_600_000))}:${two(Math.floor(ms / 60_000) % 60)}:${two(Math.floor(ms / 1000) % 60)}.${rest}`;
}
