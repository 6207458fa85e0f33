/** Goal texts in parts: the noun phrases of a statement, and the words that a model does not know. */

const RELATIONS = / (?:to the (?:left|right) of|on top of|below|under|above|apart from|next to|near|onto|on) /;
const VERBS = /^(?:please )?(?:put|place|move|stack|set) /i;

/** Returns the noun phrases of a statement in the words of the model's training; of any other text, the text. */
export function phrasesOf(statement: string): string[] {
  const phrases = statement.split(RELATIONS).map((each) => each.trim().replace(/\.$/, "").replace(VERBS, ""));
  return [...new Set(phrases.filter((each) => each !== ""))];
}

export interface Part {
  readonly text: string;
  readonly isUnknown: boolean;
}

/** Returns a text in parts of known and unknown words; together they are the text. */
export function markUnknown(text: string, unknown: readonly string[]): Part[] {
  const words = new Set(unknown.map((each) => each.toLowerCase()));
  const parts = text.split(/([\p{L}\p{N}'-]+)/u).filter((each) => each !== "");
  return parts.map((each) => ({ text: each, isUnknown: words.has(each.toLowerCase()) }));
}
