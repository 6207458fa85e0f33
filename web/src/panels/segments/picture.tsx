/** Frames on canvases: the one of the timestep, and a strip of small ones over the whole recording. */
import { useSignalEffect } from "@preact/signals";
import { useEffect, useRef, useState } from "preact/hooks";
import { asProblem, type Problem } from "../../api/problem";
import type { Editor } from "./editor";
import type { Frames } from "./frames";
import { UNFAMILIAR } from "./recording";

const THUMBNAIL_HEIGHT = 54;
/** Below it pixels are drawn as squares: smoothed, they say less. */
const COARSE_WIDTH = 60;

/** The frame of the timestep, and what it is labelled with. */
export function Stage({ editor }: { editor: Editor }) {
  const { recording } = editor;
  const canvas = useRef<HTMLCanvasElement>(null);
  const wanted = useRef(-1);
  const [problem, setProblem] = useState<Problem | null>(null);
  useSignalEffect(() => {
    const timestep = editor.timestep.value;
    wanted.current = timestep;
    if (recording.frames && canvas.current)
      draw(recording.frames, canvas.current, timestep, () => wanted.current === timestep).then(
        () => setProblem(null),
        (error: unknown) => setProblem(asProblem(error)),
      );
  });
  const segment = editor.segments[editor.current.value]!;
  const confidence = recording.confidence[editor.timestep.value];
  const familiar = recording.inDistribution[editor.timestep.value];
  return (
    <figure class="stage">
      {recording.frames ? (
        <canvas
          ref={canvas}
          class={recording.frames.width < COARSE_WIDTH ? "coarse" : ""}
          role="img"
          aria-label={`Frame ${editor.timestep.value} of ${recording.timesteps}`}
          width={recording.frames.width}
          height={recording.frames.height}
        />
      ) : (
        <p class="no-picture">This browser has no decoder for the video. Its labels are complete all the same.</p>
      )}
      <figcaption>
        <span class={`skill-name ${skillClass(recording.skills, segment.skill)}`}>{segment.skill || "no skill"}</span>
        {problem && (
          <span class="field-error" role="alert">
            This frame cannot be shown. {problem.detail}
          </span>
        )}
        {confidence !== undefined && <span>confidence {confidence.toFixed(2)}</span>}
        {familiar !== undefined && familiar < UNFAMILIAR && (
          <span class="unfamiliar-flag">unlike the training data</span>
        )}
      </figcaption>
    </figure>
  );
}

/** Draws a frame unless another is wanted by the time it is there. */
async function draw(
  frames: Frames,
  canvas: HTMLCanvasElement,
  timestep: number,
  isWanted: () => boolean,
): Promise<void> {
  const context = canvas.getContext("2d")!;
  await new Promise(requestAnimationFrame);
  if (!isWanted()) return;
  await frames.draw(context, timestep, { x: 0, y: 0, width: canvas.width, height: canvas.height });
}

export function Filmstrip({ editor }: { editor: Editor }) {
  const canvas = useRef<HTMLCanvasElement>(null);
  const { frames, timesteps } = editor.recording;
  useEffect(() => {
    if (!frames || !canvas.current) return undefined;
    const element = canvas.current;
    let turn = 0;
    const redraw = (): void => {
      turn += 1;
      void drawStrip(frames, element, timesteps, turn, () => turn);
    };
    const watching = new ResizeObserver(redraw);
    watching.observe(element);
    return () => {
      turn += 1;
      watching.disconnect();
    };
  }, [frames]);
  return frames ? <canvas ref={canvas} class="filmstrip" height={THUMBNAIL_HEIGHT} aria-hidden="true" /> : null;
}

async function drawStrip(
  frames: Frames,
  canvas: HTMLCanvasElement,
  timesteps: number,
  turn: number,
  now: () => number,
) {
  canvas.width = canvas.clientWidth;
  const context = canvas.getContext("2d")!;
  const width = (frames.width / frames.height) * THUMBNAIL_HEIGHT;
  const count = Math.max(1, Math.round(canvas.width / width));
  for (let index = 0; index < count && now() === turn; index += 1) {
    const timestep = Math.min(timesteps - 1, Math.floor(((index + 0.5) / count) * timesteps));
    const box = { x: (index * canvas.width) / count, y: 0, width: canvas.width / count, height: THUMBNAIL_HEIGHT };
    const drawn = frames.drawAlone?.(context, timestep, box) ?? frames.draw(context, timestep, box);
    await drawn.catch(() => false);
  }
}

/** Returns the class that colours a skill. */
export function skillClass(skills: readonly string[], skill: string): string {
  if (skill === "") return "skill-none";
  const index = skills.indexOf(skill);
  return `skill-${(index >= 0 ? index : skills.length + skill.length) % 10}`;
}
