/** Executed actions out of a table: a row of numbers for each timestep, with or without a line of names. */
import { Problem } from "../../api/problem";

/** @throws Problem that names the first row that is not like the others. */
export function parseActions(text: string, isDiscrete: boolean): number[][] {
  const lines = text.split(/\r?\n/).filter((line) => line.trim() !== "");
  const rows = lines.map((line) => line.split(/[,;\t]| +/).map((each) => (each.trim() === "" ? NaN : Number(each))));
  const hasNames = rows[0]?.some(Number.isNaN) ?? false;
  const actions = hasNames ? rows.slice(1) : rows;
  const bad = actions.findIndex((row) => row.length !== actions[0]!.length || row.some(Number.isNaN));
  if (bad >= 0 || actions.length === 0) {
    const line = lines[bad + (hasNames ? 1 : 0)] ?? "";
    const hint = "Write a row for each timestep, such as 0.1,-0.2,0.";
    throw new Problem(
      0,
      "invalid_input",
      `Every row of actions must have the same count of numbers; got “${line.slice(0, 60)}”.`,
      hint,
    );
  }
  return isDiscrete ? actions.map((row) => row.map(Math.round)) : actions;
}
