/** The demonstration that ships with the page, already segmented. */
import framesUrl from "../../demonstration/frames.webp";
import labels from "../../demonstration/labels.json";
import { TiledFrames } from "./frames";
import { describeModel, type Recording } from "./recording";

export function openDemonstration(): Recording {
  return {
    title: `A robot sorts groceries: a demonstration in the world ${labels.world}`,
    timesteps: labels.confidence.length,
    fps: labels.fps,
    skills: labels.skills,
    segments: labels.segments,
    confidence: labels.confidence,
    inDistribution: labels.in_distribution,
    frames: new TiledFrames(framesUrl, labels.side, labels.side, labels.columns),
    labelledBy: describeModel(labels.model),
    saved: null,
  };
}
