/** The segments as a table: every number of the bar as text, and every edit without a mouse. */
import { useState } from "preact/hooks";
import { Typed } from "../../parts/typed";
import * as edit from "./edit";
import type { Editor } from "./editor";
import { skillClass } from "./picture";
import { confidenceOf, timeOf } from "./recording";

const MOST_ROWS = 100;

export function SegmentTable({ editor }: { editor: Editor }) {
  const count = editor.segments.length;
  const first = Math.min(Math.max(0, editor.current.value - MOST_ROWS / 2), Math.max(0, count - MOST_ROWS));
  const rows = editor.segments.slice(first, first + MOST_ROWS);
  return (
    <>
      <datalist id="skills">
        {editor.recording.skills.map((each) => (
          <option key={each} value={each} />
        ))}
      </datalist>
      <div class="scrolled" tabIndex={0} role="region" aria-label="Segments">
        <table class="segments">
          <thead>
            <tr>
              <th scope="col">Skill</th>
              <th scope="col">Begin</th>
              <th scope="col" class="end">
                End
              </th>
              <th scope="col">
                <abbr title="Mean confidence of its timesteps">Conf.</abbr>
              </th>
              <th scope="col">
                <span class="unseen">Edit</span>
              </th>
            </tr>
          </thead>
          <tbody>
            {rows.map((each, index) => (
              <Row key={first + index} editor={editor} index={first + index} segment={each} />
            ))}
          </tbody>
        </table>
      </div>
      {count > MOST_ROWS && (
        <p class="faint">
          {MOST_ROWS} of {count} segments, around the time shown.
        </p>
      )}
    </>
  );
}

function Row({ editor, index, segment }: { editor: Editor; index: number; segment: edit.Segment }) {
  const { recording } = editor;
  const confidence = confidenceOf(recording, segment);
  const number = `segment ${index + 1}`;
  return (
    <tr
      class={index === editor.current.value ? "current" : ""}
      aria-current={index === editor.current.value ? "true" : undefined}
    >
      <td>
        <button
          type="button"
          class={`swatch ${skillClass(recording.skills, segment.skill)}`}
          aria-label={`Show ${number}`}
          title={`Show ${number}`}
          onClick={() => editor.goTo(segment.start)}
        />
        <SkillInput editor={editor} index={index} skill={segment.skill} label={`Skill of ${number}`} />
      </td>
      <td>
        <Typed
          type="number"
          aria-label={`Begin of ${number}, in timesteps`}
          value={segment.start}
          disabled={index === 0}
          min={0}
          max={recording.timesteps - 1}
          onValue={(text) => text && editor.change(edit.moveBoundary(editor.edited.value, index, Number(text)))}
        />
      </td>
      <td class="number end" title={`${timeOf(recording, segment.end).toFixed(2)} s`}>
        {segment.end}
      </td>
      <td class="number">{confidence === null ? "–" : confidence.toFixed(2)}</td>
      <td>
        <button
          type="button"
          class="quiet"
          aria-label={`Join ${number} to the one before`}
          disabled={editor.segments.length < 2}
          onClick={() => editor.join(index)}
        >
          join
        </button>
      </td>
    </tr>
  );
}

function SkillInput(props: { editor: Editor; index: number; skill: string; label: string }) {
  const { editor, index, skill } = props;
  const [isBad, setBad] = useState(false);
  const rename = (name: string): void => {
    setBad(name !== "" && !edit.isSkillName(name));
    if (name === "" || edit.isSkillName(name)) editor.change(edit.rename(editor.edited.value, index, name));
  };
  return (
    <Typed
      class="skill-input"
      list="skills"
      aria-label={props.label}
      aria-invalid={isBad}
      title={isBad ? "A name has lower-case letters, digits, dots, dashes and underscores." : undefined}
      value={skill}
      placeholder="no skill"
      onValue={(text) => rename(text.trim())}
    />
  );
}
