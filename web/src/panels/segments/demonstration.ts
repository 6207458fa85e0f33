/** The demonstration that ships with the page, already segmented. */
import framesUrl from "../../demonstration/frames.webp";
import labels from "../../demonstration/labels.json";
import { TiledFrames } from "./frames";
import { describeModel, timesAtRate, type Recording } from "./recording";

let opened: Recording | undefined;

export function openDemonstration(): Recording {
  return (opened ??= {
    title: `A robot sorts groceries: a demonstration in the world ${labels.world}`,
    timesteps: labels.confidence.length,
    time_s: timesAtRate(labels.confidence.length, labels.fps),
    skills: labels.skills,
    segments: labels.segments,
    confidence: labels.confidence,
    inDistribution: labels.in_distribution,
    frames: new TiledFrames(framesUrl, labels.side, labels.side, labels.columns),
    labelledBy: describeModel(labels.model),
    saved: null,
  });
}
