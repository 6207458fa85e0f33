/** Strips over control steps: executed actions with the newest chunk as ghosts, and how the goal flag fills. */
import type { ActResponse, GetSpecResponse } from "../../api/types";
import { UNFAMILIAR } from "../segments/recording";
import { chunkOf, type Moment } from "./episode";

const SHOWN_STEPS = 120;
const GHOST_ROOM = 12;

interface StripsProps {
  readonly spec: GetSpecResponse;
  readonly history: readonly Moment[];
  readonly reply: ActResponse | null;
}

export function Strips({ spec, history, reply }: StripsProps) {
  const shown = history.slice(-SHOWN_STEPS);
  const chunk = reply ? chunkOf(reply).slice(0, GHOST_ROOM) : [];
  const width = SHOWN_STEPS + GHOST_ROOM;
  const last = shown.at(-1);
  const names = spec.action?.names ?? [];
  return (
    <section class="strips" aria-label="Over control steps">
      <Strip label="goal confidence" text={last ? last.confidence.toFixed(2) : "–"} width={width}>
        <path class="fill" d={area(shown.map((each) => each.confidence))} />
        <line class="threshold" x1={0} x2={width} y1={1 - spec.reached_threshold} y2={1 - spec.reached_threshold} />
        {shown.map(
          (each, index) =>
            each.event && (
              <line key={index} class={`event ${each.event.replace(" ", "-")}`} x1={index} x2={index} y1={0} y2={1} />
            ),
        )}
      </Strip>
      {names.map((name, axis) => (
        <Strip key={name} label={name} text={last?.actions[axis]?.toFixed(2) ?? "–"} width={width}>
          <line class="zero" x1={0} x2={width} y1={0.5} y2={0.5} />
          <path
            class="line"
            d={steps(
              shown.map((each) => heightOf(each.actions[axis] ?? 0, spec)),
              0,
            )}
          />
          <path
            class="ghost"
            d={steps(
              chunk.map((each) => heightOf(each[axis] ?? 0, spec)),
              shown.length,
            )}
          />
        </Strip>
      ))}
      <Strip label="in_distribution" text={last ? last.familiar.toFixed(2) : "–"} width={width}>
        <path class="fill pale" d={area(shown.map((each) => each.familiar))} />
        {shown.map(
          (each, index) =>
            each.familiar < UNFAMILIAR && <rect key={index} class="on-warning" x={index} y={0} width={1} height={1} />,
        )}
      </Strip>
    </section>
  );
}

function Strip(props: { label: string; text: string; width: number; children: preact.ComponentChildren }) {
  return (
    <div class="strip">
      <span class="strip-label">{props.label}</span>
      <svg viewBox={`0 0 ${props.width} 1`} preserveAspectRatio="none" aria-hidden="true">
        {props.children}
      </svg>
      <output class="strip-value">{props.text}</output>
    </div>
  );
}

/** Returns where a value lies from the top, 0 to 1: continuous actions are in [-1, 1], discrete ones in [0, choices). */
function heightOf(value: number, spec: GetSpecResponse): number {
  const choices = spec.action?.choices ?? 0;
  return choices > 0 ? 1 - value / Math.max(choices - 1, 1) : (1 - value) / 2;
}

function steps(heights: readonly number[], from: number): string {
  return heights
    .map(
      (each, index) =>
        `${index === 0 ? "M" : "L"}${from + index} ${each.toFixed(3)}L${from + index + 1} ${each.toFixed(3)}`,
    )
    .join("");
}

function area(values: readonly number[]): string {
  if (values.length === 0) return "";
  return `M0 1${values.map((each, index) => `V${(1 - each).toFixed(3)}H${index + 1}`).join("")}V1Z`;
}
