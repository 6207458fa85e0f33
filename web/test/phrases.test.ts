import assert from "node:assert/strict";
import { test } from "node:test";
import { markUnknown, phrasesOf } from "../src/panels/reward/phrases";

test("a statement has two noun phrases, another text is one", () => {
  assert.deepEqual(phrasesOf("a yellow block to the left of a green block"), ["a yellow block", "a green block"]);
  assert.deepEqual(phrasesOf("a red block"), ["a red block"]);
  assert.deepEqual(phrasesOf("Put the sponge on the red block."), ["the sponge", "the red block"]);
});

test("unknown words are marked wherever they stand, and no letter is lost", () => {
  const text = "Put the Sponge on <b>, the sponge!";
  const parts = markUnknown(text, ["sponge"]);
  assert.equal(parts.map((each) => each.text).join(""), text);
  assert.deepEqual(
    parts.filter((each) => each.isUnknown).map((each) => each.text),
    ["Sponge", "sponge"],
  );
});
