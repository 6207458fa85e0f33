/** Errors of calls, as the services' problem documents (RFC 9457) have them. */

export class Problem extends Error {
  constructor(
    /** HTTP status; 0 where no reply came. */
    readonly status: number,
    /** Machine-readable code, such as `invalid_input`; docs/protocol.md lists them. */
    readonly code: string,
    /** What was expected, and what came. */
    readonly detail: string,
    /** What to do. */
    readonly hint = "",
    /** The invalid field, or empty. */
    readonly field = "",
    readonly requestId = "",
    /** Seconds after which another try is welcome; 0 where the reply does not say. */
    readonly retryAfterS = 0,
  ) {
    super(detail);
  }

  /** Whether nobody answers at the moment: another try may help. */
  get isAway(): boolean {
    return this.status === 0 || this.code === "unavailable";
  }
}

/** Returns the problem of a reply that is no success. */
export async function problemOf(reply: Response): Promise<Problem> {
  const body: unknown = await reply.json().catch(() => null);
  const text = (key: string): string => {
    const value = body !== null && typeof body === "object" ? (body as Record<string, unknown>)[key] : undefined;
    return typeof value === "string" ? value : "";
  };
  const detail = text("detail") || `The reply has status ${reply.status}.`;
  const code = text("code") || "internal";
  const retryAfterS = Number(reply.headers.get("retry-after")) || 0;
  return new Problem(reply.status, code, detail, text("hint"), text("field"), text("request_id"), retryAfterS);
}

/** The problem of a request without a reply. */
export function unreachable(): Problem {
  return new Problem(0, "unavailable", "The orchestrator does not answer.", "Start it: freerein up");
}

/** Returns any error as a problem. */
export function asProblem(error: unknown): Problem {
  if (error instanceof Problem) return error;
  return new Problem(0, "internal", error instanceof Error ? error.message : String(error));
}
