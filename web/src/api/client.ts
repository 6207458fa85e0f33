/** Calls of the services, all through the orchestrator that served the page. */
import { signal } from "@preact/signals";
import { problemOf, unreachable } from "./problem";
import type { Calls } from "./types";

export type Call = keyof Calls;
export type Service = "orchestrator" | "segmentation" | "imitation" | "reward" | "sim";
export const SERVICES: readonly Service[] = ["orchestrator", "segmentation", "imitation", "reward", "sim"];
export type LearnedService = "segmentation" | "imitation" | "reward";
export const LEARNED: readonly LearnedService[] = ["segmentation", "imitation", "reward"];

/** Whether a token is asked for: a call was refused for want of one. */
export const signedOut = signal(false);

/** Whether the services need a token. */
export const needsToken = signal(false);

/** Returns the path of a call, such as `/services/sim/v1/step`. */
export function pathOf(call: string): string {
  const [service, name] = call.split("/") as [string, string];
  return `${prefixOf(service)}/v1/${name}`;
}

/** Returns what precedes the paths of a service. */
export function prefixOf(service: string): string {
  return service === "orchestrator" ? "" : `/services/${service}`;
}

/** Answers a call whose request is JSON or, of calls that only read, the query.
 *
 * @param query More of the query, such as `tensors=list`.
 */
export async function call<Name extends Call>(
  name: Name,
  request: Calls[Name]["request"],
  options: { signal?: AbortSignal; query?: string } = {},
): Promise<Calls[Name]["reply"]> {
  const reads = /\/(get|list)-/.test(name);
  const query = [reads ? formatFields(request) : "", options.query ?? ""].filter(Boolean).join("&");
  const path = pathOf(name) + (query && `?${query}`);
  const reply = await send(path, reads ? { signal: options.signal } : { ...json(request), signal: options.signal });
  return (await reply.json()) as Calls[Name]["reply"];
}

/** Answers a call whose request is a form with files. */
export async function upload<Name extends Call>(name: Name, form: FormData): Promise<Calls[Name]["reply"]> {
  return (await (await send(pathOf(name), { method: "POST", body: form })).json()) as Calls[Name]["reply"];
}

/** Sends a call that outlives the page; nobody reads the reply. */
export function sendLast<Name extends Call>(name: Name, request: Calls[Name]["request"]): void {
  void fetch(pathOf(name), { ...json(request), keepalive: true }).catch(() => undefined);
}

/** Returns a successful reply.
 *
 * @throws Problem of any other reply, or where none came.
 */
export async function send(path: string, init: RequestInit = {}): Promise<Response> {
  let reply: Response;
  try {
    reply = await fetch(path, { credentials: "same-origin", ...init });
  } catch (error) {
    if (init.signal?.aborted) throw error;
    throw unreachable();
  }
  if (reply.status === 401) signedOut.value = true;
  if (!reply.ok) throw await problemOf(reply);
  return reply;
}

function json(request: unknown): RequestInit {
  return { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(request) };
}

function formatFields(request: object): string {
  const fields = Object.entries(request).filter(([, value]) => value !== undefined && value !== "");
  return new URLSearchParams(fields.map(([key, value]) => [key, String(value)])).toString();
}
