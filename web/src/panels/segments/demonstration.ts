/** The demonstration that ships with the page, already segmented. */
import framesUrl from "../../demonstration/frames.webp";
import labelsUrl from "../../demonstration/labels.json";
import { send } from "../../api/client";
import type { ModelRef } from "../../api/types";
import type { Segment } from "./edit";
import { TiledFrames } from "./frames";
import { describeModel, type Recording } from "./recording";

interface Labels {
  readonly world: string;
  readonly fps: number;
  readonly columns: number;
  readonly side: number;
  readonly model: ModelRef;
  readonly skills: readonly string[];
  readonly segments: readonly Segment[];
  readonly confidence: readonly number[];
  readonly in_distribution: readonly number[];
}

export async function openDemonstration(): Promise<Recording> {
  const labels = (await (await send(labelsUrl)).json()) as Labels;
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
