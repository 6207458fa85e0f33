/** The views in the order in which people want to see them, in one file: only what draws curves is loaded later. */
import type { ComponentType } from "preact";
import { DataPanel } from "./panels/data/panel";
import { PolicyPanel } from "./panels/policy/panel";
import { RewardPanel } from "./panels/reward/panel";
import { RunsPanel } from "./panels/runs/panel";
import { SegmentsPanel } from "./panels/segments/panel";
import { ServicesPanel } from "./panels/services/panel";

export interface View {
  readonly name: string;
  readonly title: string;
  readonly Panel: ComponentType;
}

export const VIEWS: readonly View[] = [
  { name: "segments", title: "Segments", Panel: SegmentsPanel },
  { name: "policy", title: "Policy", Panel: PolicyPanel },
  { name: "reward", title: "Reward", Panel: RewardPanel },
  { name: "runs", title: "Runs and fits", Panel: RunsPanel },
  { name: "data", title: "Data and models", Panel: DataPanel },
  { name: "services", title: "Services", Panel: ServicesPanel },
];
