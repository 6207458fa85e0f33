/** Labels as files, and as labels of a dataset. */
import { saveFile } from "../../parts/save_file";
import type { Editor } from "./editor";
import { csv, webVtt } from "./export";
import { timeOf } from "./recording";

export function TakeAway({ editor }: { editor: Editor }) {
  const { recording } = editor;
  const name = recording.title.toLowerCase().replace(/\.\w+$/, "").replace(/[^a-z0-9]+/g, "-").slice(0, 40);
  const asVtt = (): void => saveFile(`${name}.vtt`, webVtt(editor.segments, (each) => timeOf(recording, each)), "text/vtt");
  const asCsv = (): void => saveFile(`${name}.csv`, csv(editor.segments, recording.saved?.index ?? 0), "text/csv");
  return (
    <div class="buttons">
      <button type="button" onClick={asVtt}>
        Save WebVTT
      </button>
      <button type="button" onClick={asCsv}>
        Save CSV
      </button>
    </div>
  );
}
