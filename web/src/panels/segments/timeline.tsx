/** The skill bar: segments with confidence as height, what is unlike the training data, and the playhead. */
import { useRef } from "preact/hooks";
import { thin } from "../../curves/thin";
import type { Segment } from "./edit";
import type { Editor } from "./editor";
import { Filmstrip, skillClass } from "./picture";
import { timeOf, timestepAt, unfamiliarSpans, type Recording } from "./recording";

const GRAB_PX = 9;
const HEIGHT = 100;
const MOST_POINTS = 1200;

export function Timeline({ editor }: { editor: Editor }) {
  const { recording } = editor;
  const bar = useRef<HTMLDivElement>(null);
  const timestepOf = (event: PointerEvent): number => {
    const { left, width } = bar.current!.getBoundingClientRect();
    return ((event.clientX - left) / width) * recording.timesteps;
  };
  const grabbed = useRef(0);
  /** Returns the boundary that the pointer is at; 0 for none. */
  const boundaryAt = (at: number): number => {
    const near = editor.nearestBoundary(at);
    const distance = Math.abs((editor.segments[near]?.start ?? 0) - at);
    return near > 0 && (distance / recording.timesteps) * bar.current!.clientWidth <= GRAB_PX ? near : 0;
  };
  const press = (event: PointerEvent): void => {
    bar.current!.setPointerCapture(event.pointerId);
    const at = timestepOf(event);
    grabbed.current = boundaryAt(at);
    if (grabbed.current === 0) editor.goTo(Math.floor(at));
  };
  const move = (event: PointerEvent): void => {
    if (!bar.current!.hasPointerCapture(event.pointerId)) {
      bar.current!.classList.toggle("at-boundary", boundaryAt(timestepOf(event)) > 0);
      return;
    }
    if (grabbed.current > 0) editor.drag(grabbed.current, timestepOf(event));
    else editor.goTo(Math.floor(timestepOf(event)));
  };
  return (
    <div class="timeline">
      <Filmstrip editor={editor} />
      <div
        ref={bar}
        class="skill-bar"
        role="slider"
        tabIndex={0}
        aria-label="Time"
        aria-valuemin={0}
        aria-valuemax={recording.timesteps - 1}
        aria-valuenow={editor.timestep.value}
        aria-valuetext={editor.describe()}
        aria-describedby="timeline-keys"
        onPointerDown={press}
        onPointerMove={move}
        onPointerUp={() => editor.drop()}
        onPointerCancel={() => editor.drop()}
        onKeyDown={(event) => answerKey(event, editor)}
      >
        {editor.segments.map((each, index) => (
          <Bar key={index} segment={each} recording={recording} isCurrent={index === editor.current.value} />
        ))}
        <div class="playhead" style={{ left: percent(editor.timestep.value + 0.5, recording) }} />
      </div>
      <Unfamiliar recording={recording} />
      <Axis recording={recording} />
    </div>
  );
}

function Bar({ segment, recording, isCurrent }: { segment: Segment; recording: Recording; isCurrent: boolean }) {
  const width = percent(segment.end - segment.start, recording);
  return (
    <div
      class={`segment ${skillClass(recording.skills, segment.skill)} ${isCurrent ? "current" : ""}`}
      style={{ left: percent(segment.start, recording), width }}
    >
      <svg viewBox={`0 0 ${segment.end - segment.start} ${HEIGHT}`} preserveAspectRatio="none" aria-hidden="true">
        <path d={area(recording.confidence.slice(segment.start, segment.end))} />
      </svg>
      <span>{segment.skill || "–"}</span>
    </div>
  );
}

/** Returns the outline of confidences as steps from the bottom, each timestep one wide. */
function area(confidence: readonly number[]): string {
  if (confidence.length === 0) return "";
  const { x, y } = thin({ x: confidence.map((_, index) => index), y: confidence }, MOST_POINTS);
  const steps = x.map((_, index) => `V${((1 - y[index]!) * HEIGHT).toFixed(1)}H${x[index + 1] ?? confidence.length}`);
  return `M0 ${HEIGHT}${steps.join("")}V${HEIGHT}Z`;
}

function Unfamiliar({ recording }: { recording: Recording }) {
  const spans = unfamiliarSpans(recording);
  if (spans.length === 0) return null;
  return (
    <div class="unfamiliar">
      {spans.map((each) => (
        <div
          key={each.start}
          style={{ left: percent(each.start, recording), width: percent(each.end - each.start, recording) }}
        />
      ))}
    </div>
  );
}

function Axis({ recording }: { recording: Recording }) {
  const [begins, ends] = [timeOf(recording, 0), timeOf(recording, recording.timesteps)];
  const seconds = ends - begins;
  const step =
    [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1800, 3600].find((each) => seconds / each <= 8) ?? 3600;
  const first = Math.ceil(begins / step);
  const marks = Array.from({ length: Math.floor(ends / step) - first + 1 }, (_, index) => (first + index) * step);
  return (
    <div class="axis" aria-hidden="true">
      {marks.map((each, index) => (
        <span key={each} style={{ left: percent(placeOf(recording, each), recording) }}>
          {Math.round(each * 10) / 10}
          {index === 0 ? " s" : ""}
        </span>
      ))}
    </div>
  );
}

/** Returns where a time is, in timesteps and their fractions. */
function placeOf(recording: Recording, seconds: number): number {
  const timestep = timestepAt(recording, seconds);
  const begin = timeOf(recording, timestep);
  return timestep + (seconds - begin) / (timeOf(recording, timestep + 1) - begin);
}

function percent(timesteps: number, recording: Recording): string {
  return `${(100 * timesteps) / recording.timesteps}%`;
}

/** Keys of the focused timeline. */
export const KEYS: readonly (readonly [string, string])[] = [
  ["← →", "a timestep"],
  ["Shift ← →", "ten timesteps"],
  ["Page Up, Page Down", "boundary before, after"],
  ["Alt ← →", "move the nearest boundary"],
  ["Enter", "cut here"],
  ["Delete", "join to the segment before"],
  ["Space", "play"],
  ["Ctrl Z, Ctrl Y", "undo, redo"],
];

function answerKey(event: KeyboardEvent, editor: Editor): void {
  const direction = event.key === "ArrowLeft" ? -1 : event.key === "ArrowRight" ? 1 : 0;
  const actions: Record<string, () => void> = {
    Home: () => editor.goTo(0),
    End: () => editor.goTo(editor.recording.timesteps - 1),
    PageUp: () => editor.goToBoundary(-1),
    PageDown: () => editor.goToBoundary(1),
    Enter: () => editor.split(),
    Delete: () => editor.join(editor.current.value),
    " ": () => editor.togglePlaying(),
  };
  if (direction !== 0 && event.altKey) editor.nudge(direction);
  else if (direction !== 0) editor.goTo(editor.timestep.value + direction * (event.shiftKey ? 10 : 1));
  else if (actions[event.key] && !event.ctrlKey && !event.metaKey) actions[event.key]!();
  else return;
  event.preventDefault();
}
