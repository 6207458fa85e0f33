/** The state of the page as the query of its URL, such as `?view=segments&t=6.41`. */

export type Query = Readonly<Record<string, string>>;

/** Returns the keys and values of a query; of a repeated key, the last. */
export function parseQuery(search: string): Query {
  return Object.fromEntries(new URLSearchParams(search));
}

/** Returns a query as text: `view` first, the others by name, without empty values; `/` where nothing is left. */
export function formatQuery(query: Query): string {
  const kept = Object.entries(query).filter(([, value]) => value !== "");
  kept.sort(([a], [b]) => (a === "view" ? -1 : b === "view" ? 1 : a < b ? -1 : 1));
  return kept.length > 0 ? `/?${new URLSearchParams(kept)}` : "/";
}

/** Returns the query after changes; an empty value removes a key, and another view forgets what the last one held. */
export function changed(query: Query, changes: Query): Query {
  const kept = changes.view !== undefined && changes.view !== query.view ? {} : query;
  return Object.fromEntries(Object.entries({ ...kept, ...changes }).filter(([, value]) => value !== ""));
}
