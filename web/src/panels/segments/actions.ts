/** Executed actions out of a CSV file, by the rules of `freerein segment`: src/freerein/data/action_table.py. */
import { Problem } from "../../api/problem";

const NUMBER = /^\s*[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?\s*$/i;
const NOT_FINITE = /^\s*[+-]?(inf|infinity|nan)\s*$/i;
const MOST = 3.4028234663852886e38;
const EXAMPLE = "For example the lines 0.5,-0.1 and 0.5,0; a first line such as x,y may name the numbers.";
const INDEX_HINT = "Name it, or leave it out: pandas writes a table without its index by to_csv(FILE, index=False).";

interface Line {
  /** From 1. */
  readonly number: number;
  readonly cells: readonly string[];
}

/** Returns the actions of each timestep.
 *
 * @param choices Number of choices of discrete actions; 0 for continuous ones.
 * @throws Problem with the line, and the column, of the first that is not as it must be.
 */
export function parseActions(text: string, choices: number): number[][] {
  const lines = linesOf(text);
  const names = lines[0]?.cells.some(isNumber) ? undefined : lines[0];
  if (names) checkNames(names);
  const rows = names ? lines.slice(1) : lines;
  if (rows.length === 0)
    throw refused(
      `The file must have the action of an image in each line; it has ${names ? "names alone" : "no lines"}.`,
    );
  const actions = rows.map((line) => numbersOf(line, choices));
  const first = lines[0]!;
  const other = rows.find(({ cells }) => cells.length !== first.cells.length);
  if (other)
    throw refused(
      `Line ${other.number} must have ${first.cells.length} numbers, as many as line ${first.number}; ` +
        `it has ${other.cells.length}.`,
    );
  if (!names) checkNoCount(rows);
  return actions;
}

function linesOf(text: string): Line[] {
  const lines = text.split(/\r\n|\n|\r/).map((line, index) => ({ number: index + 1, text: line }));
  return lines
    .filter((line) => line.text !== "")
    .map(({ number, text }) => ({ number, cells: text.split(",").map((cell) => cell.replace(/^"(.*)"$/, "$1")) }));
}

function numbersOf({ number, cells }: Line, choices: number): number[] {
  return cells.map((cell, index) => {
    const place = `Line ${number}, column ${index + 1},`;
    const value = Number(cell);
    if (!NUMBER.test(cell) || Math.abs(value) > MOST) throw refused(`${place} must be a finite number; got “${cell}”.`);
    if (choices > 0 && !(Number.isInteger(value) && value >= 0 && value < choices))
      throw refused(
        `${place} must be a whole number in [0, ${choices - 1}]; got ${value}.`,
        "The model's actions are choices, counted from 0.",
      );
    return value;
  });
}

/** Refuses a column without a name, and a name that is there twice: pandas writes its index so. */
function checkNames({ number, cells }: Line): void {
  const names = cells.map((each) => each.trim());
  const nameless = names.findIndex((each) => /^(Unnamed: \d+(_level_\d+)?)?$/.test(each));
  if (nameless >= 0)
    throw refused(
      `Line ${number}, column ${nameless + 1}, must have a name, or a number as all others; got “${names[nameless]}”.`,
      INDEX_HINT,
    );
  if (new Set(names).size !== names.length)
    throw refused(`Line ${number} must have different names; one is there twice.`, "Rename a column.");
}

/** Refuses a first line that counts the columns, as pandas writes for a table without names of its own. */
function checkNoCount([first, ...others]: readonly Line[]): void {
  const counts = first!.cells.every((cell, index) => cell.trim() === String(index));
  const areWhole = others.every(({ cells }) => cells.every((cell) => /^\s*\d+\s*$/.test(cell)));
  if (counts && first!.cells.length > 1 && !areWhole)
    throw refused(
      `Line ${first!.number} must be an action, or names; it counts the columns.`,
      "Write the table without such a line: DataFrame.to_csv(FILE, index=False, header=False).",
    );
}

function isNumber(cell: string): boolean {
  return NUMBER.test(cell) || NOT_FINITE.test(cell);
}

function refused(detail: string, hint = EXAMPLE): Problem {
  return new Problem(0, "invalid_input", detail, hint);
}
