/** Inputs for the fields of a configuration; rarely changed ones are folded away. */
import type { Field } from "./schema";

/** Known names that a field may want, by its key. */
export type Names = Readonly<Record<string, readonly string[]>>;

interface FieldsProps {
  readonly names: Names;
  readonly fields: readonly Field[];
  readonly texts: Readonly<Record<string, string>>;
  readonly errors: Readonly<Record<string, string>>;
  readonly onText: (key: string, text: string) => void;
}

const MOST_SHOWN = 8;
const MOST_NAMES = 6;

export function ConfigFields(props: FieldsProps) {
  const needed = props.fields.filter((each) => each.needed).length;
  const shown = Math.max(needed, Math.min(MOST_SHOWN, props.fields.length));
  const hidden = props.fields.slice(shown);
  return (
    <>
      <Grid {...props} fields={props.fields.slice(0, shown)} />
      {hidden.length > 0 && (
        <details open={hidden.some((each) => props.errors[each.key] !== undefined)}>
          <summary>{hidden.length} more keys</summary>
          <Grid {...props} fields={hidden} />
        </details>
      )}
    </>
  );
}

/** A few of the names that there are; all of them are suggested while one types. */
export function KnownNames({ names }: { names: readonly string[] | undefined }) {
  if (names === undefined) return null;
  const first = names.slice(0, MOST_NAMES).join(", ");
  return (
    <span class="field-meaning">
      {names.length === 0 ? "There are none yet." : `There are: ${first}${names.length > MOST_NAMES ? ", …" : ""}`}
    </span>
  );
}

function Grid({ names, fields, texts, errors, onText }: FieldsProps) {
  return (
    <div class="field-grid">
      {fields.map((field) => {
        const text = texts[field.key] ?? field.initial;
        const error = errors[field.key];
        return (
          <div key={field.key}>
            <label for={`field-${field.key}`}>
              {field.key} {field.needed && <span class="faint">(needed)</span>}
            </label>
            <Input field={field} text={text} isBad={error !== undefined} onText={(next) => onText(field.key, next)} />
            {error && (
              <p class="field-error" role="alert">
                {error}
              </p>
            )}
            <p class="field-meaning" id={`meaning-${field.key}`}>
              {plain(field.meaning)} {field.bounds && <span>[{field.bounds}]</span>}{" "}
              <KnownNames names={names[field.key]} />
            </p>
          </div>
        );
      })}
    </div>
  );
}

function Input({
  field,
  text,
  isBad,
  onText,
}: {
  field: Field;
  text: string;
  isBad: boolean;
  onText: (text: string) => void;
}) {
  const shared = { id: `field-${field.key}`, "aria-describedby": `meaning-${field.key}`, "aria-invalid": isBad };
  if (field.kind === "boolean" || field.kind === "choice") {
    const choices = field.kind === "boolean" ? ["true", "false"] : field.choices;
    return (
      <select {...shared} value={text} onChange={(event) => onText(event.currentTarget.value)}>
        {choices.map((each) => (
          <option key={each}>{each}</option>
        ))}
      </select>
    );
  }
  const mode = field.kind === "integer" ? "numeric" : field.kind === "number" ? "decimal" : "text";
  const hint = field.kind === "list" ? "a, b, c" : field.kind === "json" ? "{ }" : "";
  if (field.kind === "json") {
    return (
      <textarea
        {...shared}
        rows={2}
        value={text}
        placeholder={hint}
        onInput={(event) => onText(event.currentTarget.value)}
      />
    );
  }
  return (
    <input
      {...shared}
      list={`names-${field.key}`}
      inputMode={mode}
      value={text}
      placeholder={hint}
      onInput={(event) => onText(event.currentTarget.value)}
    />
  );
}

/** Words of docstrings without their code marks. */
function plain(meaning: string): string {
  return meaning.replaceAll("`", "");
}
