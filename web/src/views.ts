/** The views in the order in which people want to see them. All but the first are loaded when they are opened. */
import type { ComponentType } from "preact";
import { SegmentsPanel } from "./panels/segments/panel";

export interface View {
  readonly name: string;
  readonly title: string;
  readonly load: () => Promise<ComponentType>;
}

export const VIEWS: readonly View[] = [
  { name: "segments", title: "Segments", load: async () => SegmentsPanel },
  { name: "policy", title: "Policy", load: async () => (await import("./panels/policy/panel")).PolicyPanel },
  { name: "reward", title: "Reward", load: async () => (await import("./panels/reward/panel")).RewardPanel },
  { name: "runs", title: "Runs and fits", load: async () => (await import("./panels/runs/panel")).RunsPanel },
  { name: "data", title: "Data and models", load: async () => (await import("./panels/data/panel")).DataPanel },
  { name: "services", title: "Services", load: async () => (await import("./panels/services/panel")).ServicesPanel },
];
