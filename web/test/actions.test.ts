import assert from "node:assert/strict";
import { test } from "node:test";
import { parseActions } from "../src/panels/segments/actions";

test("tables that `freerein segment` reads are read alike", () => {
  assert.deepEqual(parseActions("0.1, 0.2\r\n-1e-1,3\r\n", 0), [
    [0.1, 0.2],
    [-0.1, 3],
  ]);
  assert.deepEqual(parseActions('"dx",dy\n\n1,2\n', 0), [[1, 2]]);
  assert.deepEqual(parseActions("action\n0\n2\n", 3), [[0], [2]]);
  assert.deepEqual(parseActions("0,1\n1,0\n", 0).length, 2);
});

const REFUSED: readonly (readonly [string, string, number, RegExp])[] = [
  ["a line that counts the columns", "0,1,2\n0.5,0.1,0\n", 0, /Line 1 .* counts the columns/],
  ["an index without a name", ",dx,dy\n0,0.5,0.1\n", 0, /Line 1, column 1, must have a name/],
  ["a name that is there twice", "x,x\n1,2\n", 0, /different names/],
  ["a choice that is not whole", "1\n1.5\n", 3, /Line 2, column 1, must be a whole number in \[0, 2\]; got 1.5/],
  ["a choice that there is not", "3\n", 3, /must be a whole number in \[0, 2\]; got 3/],
  ["lines that differ in length", "1,2\n\n1\n", 0, /Line 3 must have 2 numbers, as many as line 1; it has 1/],
  ["an empty cell", "1,\n", 0, /Line 1, column 2, must be a finite number; got “”/],
  ["what is not finite", "1,nan\n", 0, /column 2, must be a finite number; got “nan”/],
  ["a number that only scripts know", "1,0x10\n", 0, /got “0x10”/],
  ["names alone", "x,y\n", 0, /names alone/],
  ["nothing", "\n", 0, /no lines/],
];

for (const [what, text, choices, expected] of REFUSED) {
  test(`${what} is refused by line and column`, () => {
    assert.throws(() => parseActions(text, choices), expected);
  });
}
