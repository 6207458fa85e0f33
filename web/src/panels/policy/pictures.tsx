/** The camera beside the goal, the goal flag that fills, and all parts of the goal. */
import { useSignalEffect } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import { SHOWN_SIDE, type Episode, type Outcome } from "./episode";
import { nameOf, partsOf, type Goal, type Landmark } from "./goal";

export function Pictures({ episode }: { episode: Episode }) {
  const goal = episode.goal.value;
  const at = episode.reply.value?.goal_index ?? 0;
  return (
    <>
      <div class="live-pictures">
        <figure>
          <Camera episode={episode} />
          <figcaption>
            camera {episode.spec.cameras[0]!.name} of {episode.task}
          </figcaption>
        </figure>
        <figure>
          {goal?.form === "images" ? (
            <Still
              landmark={goal.landmarks[Math.min(at, goal.landmarks.length - 1)]!}
              name={`Goal image ${Math.min(at + 1, goal.landmarks.length)}`}
            />
          ) : (
            <div class="goal-words">{goal ? nameOf(goal, Math.min(at, partsOf(goal) - 1)) : "no goal yet"}</div>
          )}
          <figcaption>
            goal{goal && partsOf(goal) > 1 ? ` ${Math.min(at + 1, partsOf(goal))} of ${partsOf(goal)}` : ""}
          </figcaption>
        </figure>
        <Flag episode={episode} />
      </div>
      {goal && partsOf(goal) > 1 && <Parts goal={goal} at={at} outcomes={episode.outcomes.value} />}
    </>
  );
}

function Camera({ episode }: { episode: Episode }) {
  const canvas = useRef<HTMLCanvasElement>(null);
  useSignalEffect(() => {
    const picture = episode.picture.value;
    if (picture) canvas.current?.getContext("2d")!.putImageData(picture, 0, 0);
  });
  return (
    <canvas
      ref={canvas}
      class="picture"
      role="img"
      aria-label="What the camera sees"
      width={SHOWN_SIDE}
      height={SHOWN_SIDE}
    />
  );
}

function Still({ landmark, name }: { landmark: Landmark; name: string }) {
  const canvas = useRef<HTMLCanvasElement>(null);
  const { width, height } = landmark.picture;
  useEffect(() => canvas.current!.getContext("2d")!.drawImage(landmark.picture, 0, 0), [landmark]);
  return <canvas ref={canvas} class="picture" role="img" aria-label={name} width={width} height={height} />;
}

/** The goal flag: it fills with the confidence that the goal is reached, up to the threshold and beyond. */
function Flag({ episode }: { episode: Episode }) {
  const reply = episode.reply.value;
  const { reached_threshold: threshold, goal_form: form } = episode.spec;
  const confidence = reply?.goal_confidence ?? 0;
  // A text is reached after several steps in a row above the threshold.
  const isReached = reply?.goal_reached === true || (form !== "text" && confidence >= threshold);
  return (
    <div
      class={`flag ${isReached ? "reached" : ""}`}
      role="meter"
      aria-label="Goal confidence"
      aria-valuemin={0}
      aria-valuemax={1}
      aria-valuenow={Number(confidence.toFixed(2))}
    >
      <svg viewBox="0 0 40 100" aria-hidden="true">
        <rect class="flag-back" x={8} y={2} width={24} height={96} rx={3} />
        <rect class="flag-fill" x={8} y={2 + 96 * (1 - confidence)} width={24} height={96 * confidence} />
        <line class="flag-threshold" x1={2} x2={38} y1={2 + 96 * (1 - threshold)} y2={2 + 96 * (1 - threshold)} />
      </svg>
      <span>goal {isReached ? "reached" : confidence.toFixed(2)}</span>
      <span class="faint">reached from {threshold.toFixed(2)}</span>
    </div>
  );
}

const MARKS = { reached: "✓ ", abandoned: "✗ ", "": "" };

interface PartsProps {
  readonly goal: Goal;
  /** Index of the current part. */
  readonly at: number;
  readonly outcomes: readonly Outcome[];
}

function Parts({ goal, at, outcomes }: PartsProps) {
  return (
    <ol class="goal-parts" aria-label="Parts of the goal">
      {Array.from({ length: partsOf(goal) }, (_, index) => (
        <li
          key={index}
          class={outcomes[index] ?? (index === at ? "now" : "")}
          aria-current={index === at ? "step" : undefined}
        >
          {goal.form === "images" && <Still landmark={goal.landmarks[index]!} name={nameOf(goal, index)} />}
          <span>
            {MARKS[outcomes[index] ?? ""]}
            {goal.form === "images" ? index + 1 : nameOf(goal, index)}
          </span>
        </li>
      ))}
    </ol>
  );
}
