/** Segments: a recording with its skill bar, to look at, to correct, and to take away. */
import { signal } from "@preact/signals";
import { useEffect, useState } from "preact/hooks";
import type { ComponentChildren } from "preact";
import { Icon } from "../../parts/icon";
import { Link } from "../../parts/link";
import { open, query } from "../../url/location";
import { DatasetSource } from "./dataset";
import { openDemonstration } from "./demonstration";
import { Editor } from "./editor";
import { Stage } from "./picture";
import { timeOf, type Recording } from "./recording";
import { SegmentTable } from "./table";
import { TakeAway } from "./take_away";
import { KEYS, Timeline } from "./timeline";
import { VideoForm } from "./video";

const SOURCES = [
  { name: "demonstration", title: "Demonstration" },
  { name: "dataset", title: "A dataset" },
  { name: "video", title: "Your video" },
];

/** The video of this visit, and its labels. */
const file = signal<File | null>(null);
const segmented = signal<Recording | null>(null);

function show(recording: Recording | null): void {
  segmented.peek()?.frames?.close?.();
  segmented.value = recording;
}

export function SegmentsPanel() {
  const source = SOURCES.some((each) => each.name === query.value.source) ? query.value.source! : "demonstration";
  const take = (taken: File): void => {
    file.value = taken;
    show(null);
    if (source !== "video") open({ view: "segments", source: "video", t: "" });
  };
  const drop = (event: DragEvent): void => {
    const [dropped] = event.dataTransfer?.files ?? [];
    if (!dropped) return;
    event.preventDefault();
    take(dropped);
  };
  const form = source === "video" && <VideoForm file={file.value} onFile={take} onRecording={show} />;
  return (
    <div onDragOver={(event) => event.preventDefault()} onDrop={drop}>
      <div class="heading">
        <h1>Segments</h1>
        <nav aria-label="Recordings">
          <ul class="choices">
            {SOURCES.map((each) => (
              <li key={each.name}>
                <Link to={{ view: "segments", source: each.name, t: "" }} current={each.name === source}>
                  {each.title}
                </Link>
              </li>
            ))}
          </ul>
        </nav>
      </div>
      <p class="lede">
        Which skill is in use at each moment of a recording, found by a model. Drag a boundary or rename a skill to
        correct it.
      </p>
      {source === "demonstration" && <Viewer recording={openDemonstration()} />}
      {source === "dataset" && (
        <DatasetSource>
          {(recording, picker) => <Viewer recording={recording} aside={picker} asideTitle="Trajectory" />}
        </DatasetSource>
      )}
      {source === "video" &&
        (segmented.value ? (
          <Viewer recording={segmented.value} aside={form} asideTitle="Segment another video" />
        ) : (
          <div class="card narrow">{form}</div>
        ))}
    </div>
  );
}

/** A recording, its labels and what can be done to them. */
export function Viewer({
  recording,
  aside,
  asideTitle,
}: {
  recording: Recording;
  aside?: ComponentChildren;
  asideTitle?: string;
}) {
  const [editor, setEditor] = useState<Editor | null>(null);
  useEffect(() => {
    const opened = new Editor(recording);
    setEditor(opened);
    return () => opened.close();
  }, [recording]);
  if (editor === null || editor.recording !== recording) return null;
  const answerUndo = (event: KeyboardEvent): void => {
    if (!(event.ctrlKey || event.metaKey) || event.target instanceof HTMLInputElement) return;
    const isRedo = event.key === "y" || (event.key === "Z" && event.shiftKey);
    if (isRedo) editor.redo();
    else if (event.key === "z") editor.undo();
    else return;
    event.preventDefault();
  };
  return (
    <div class="viewer" onKeyDown={answerUndo}>
      <section class="viewer-main" aria-label="Recording">
        <h2 class="recording-title">{recording.title}</h2>
        <Stage editor={editor} />
        <Timeline editor={editor} />
        <Transport editor={editor} />
      </section>
      <aside class="viewer-side" aria-label="Labels">
        {aside && (
          <details class="aside" open={recording.saved !== null}>
            <summary>{asideTitle}</summary>
            {aside}
          </details>
        )}
        <h2>
          Labels{" "}
          <span class="faint">
            by {editor.isChanged ? "you and " : ""}
            {recording.labelledBy}
          </span>
        </h2>
        <SegmentTable editor={editor} />
        <div class="buttons">
          <button type="button" disabled={!editor.isChanged} onClick={() => editor.undo()}>
            Undo
          </button>
          <button type="button" disabled={editor.edited.value.future.length === 0} onClick={() => editor.redo()}>
            Redo
          </button>
          <button type="button" onClick={() => editor.split()}>
            Cut here
          </button>
        </div>
        <TakeAway editor={editor} />
        <details class="keys">
          <summary>Keys on the skill bar</summary>
          <dl id="timeline-keys">
            {KEYS.map(([key, does]) => (
              <div key={key}>
                <dt>{key}</dt>
                <dd>{does}</dd>
              </div>
            ))}
          </dl>
        </details>
      </aside>
    </div>
  );
}

function Transport({ editor }: { editor: Editor }) {
  const isPlaying = editor.isPlaying.value;
  const buttons = [
    ["Boundary before", "boundaryBefore", () => editor.goToBoundary(-1)],
    ["Timestep before", "before", () => editor.goTo(editor.timestep.value - 1)],
    [isPlaying ? "Pause" : "Play", isPlaying ? "pause" : "play", () => editor.togglePlaying()],
    ["Timestep after", "after", () => editor.goTo(editor.timestep.value + 1)],
    ["Boundary after", "boundaryAfter", () => editor.goToBoundary(1)],
  ] as const;
  const seconds = timeOf(editor.recording, editor.timestep.value);
  return (
    <div class="transport">
      {buttons.map(([name, icon, act], index) => (
        <button key={index} type="button" aria-label={name} title={name} onClick={act}>
          <Icon name={icon} />
        </button>
      ))}
      <output class="clock">
        {seconds.toFixed(2)} s{" "}
        <span class="faint">
          timestep {editor.timestep.value} of {editor.recording.timesteps}
        </span>
      </output>
      <ul class="legend" aria-label="Legend">
        <li>
          <span class="legend-height" aria-hidden="true" /> height: confidence
        </li>
        <li>
          <span class="legend-unfamiliar" aria-hidden="true" /> unlike the training data
        </li>
      </ul>
    </div>
  );
}
