/** The query of the address bar as a signal: reload and back work. */
import { signal } from "@preact/signals";
import { changed, formatQuery, parseQuery, type Query } from "./query";

const WRITE_MS = 250; // browsers refuse more than a few changes of the history per second

export const query = signal<Query>(parseQuery(location.search));

let pending = 0;

/** Opens another state, to which back returns. */
export function open(changes: Query): void {
  write();
  query.value = changed(query.value, changes);
  history.pushState(null, "", formatQuery(query.value));
}

/** Changes the state in place: back skips it. Many changes are written together. */
export function amend(changes: Query): void {
  query.value = changed(query.value, changes);
  if (pending === 0) pending = window.setTimeout(write, WRITE_MS);
}

function write(): void {
  if (pending === 0) return;
  window.clearTimeout(pending);
  pending = 0;
  history.replaceState(null, "", formatQuery(query.value));
}

window.addEventListener("popstate", () => {
  query.value = parseQuery(location.search);
});
window.addEventListener("pagehide", write);

/** Address of a state, for links. */
export function address(changes: Query): string {
  return formatQuery(changed(query.value, changes));
}
