/** What the page says aloud to those who do not see it change. */
import { signal } from "@preact/signals";

export const said = signal("");

export function say(text: string): void {
  said.value = text;
}
