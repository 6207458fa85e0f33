/** Labels as files, and as labels of a dataset. */
import { useState } from "preact/hooks";
import { call } from "../../api/client";
import { asProblem, type Problem } from "../../api/problem";
import { Failed } from "../../parts/notice";
import { saveFile } from "../../parts/save_file";
import { say } from "../../parts/say";
import type { Editor } from "./editor";
import { csv, webVtt } from "./export";
import { timeOf } from "./recording";

export function TakeAway({ editor }: { editor: Editor }) {
  const { recording } = editor;
  const name = recording.title
    .toLowerCase()
    .replace(/\.\w+$/, "")
    .replace(/[^a-z0-9]+/g, "-")
    .slice(0, 40);
  const asVtt = (): void =>
    saveFile(
      `${name}.vtt`,
      webVtt(editor.segments, (each) => timeOf(recording, each)),
      "text/vtt",
    );
  const asCsv = (): void => saveFile(`${name}.csv`, csv(editor.segments, recording.saved?.index ?? 0), "text/csv");
  return (
    <>
      <div class="buttons">
        <button type="button" onClick={asVtt}>
          Save WebVTT
        </button>
        <button type="button" onClick={asCsv}>
          Save CSV
        </button>
      </div>
      {recording.saved && <SaveLabels editor={editor} saved={recording.saved} />}
    </>
  );
}

function SaveLabels({ editor, saved }: { editor: Editor; saved: { dataset: string; index: number } }) {
  const [problem, setProblem] = useState<Problem | null>(null);
  const { isSaved } = editor;
  const save = async (): Promise<void> => {
    setProblem(null);
    const segments = editor.segments;
    try {
      await call("orchestrator/save-labels", {
        ...saved,
        segments: segments.map(({ start, end, skill }) => ({ start, end, skill })),
      });
      editor.saved.value = segments;
      say("Labels saved");
    } catch (error) {
      setProblem(asProblem(error));
    }
  };
  return (
    <>
      <button type="button" class="main-action" disabled={isSaved} onClick={() => void save()}>
        {isSaved ? "Saved" : `Save as labels of ${saved.dataset}`}
      </button>
      <p class="faint">They stand beside the dataset as labels by a person. No fit learns from them.</p>
      {problem && <Failed problem={problem} />}
    </>
  );
}
