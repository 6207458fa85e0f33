/** A stream of events that is taken up where it broke: no event is lost, and none comes twice. */
import { send } from "../api/client";
import { Problem, asProblem } from "../api/problem";
import { EventParser, type ServerEvent } from "./parser";

const FIRST_PAUSE_MS = 500;
const LONGEST_PAUSE_MS = 8000;
/** Refusals that end by themselves: a request timeout, and too many requests. */
const PASSING = [408, 429];

export interface Following {
  /** Ends it. */
  readonly signal: AbortSignal;
  /** Takes an event; returns whether it is the last one where the stream then ends. */
  readonly onEvent: (event: ServerEvent) => boolean;
  /** Is told of a break, and with null that the stream goes on. */
  readonly onBreak: (problem: Problem | null) => void;
}

/** Follows a stream to its end.
 *
 * @param path Path of the stream; `Last-Event-ID` resumes it.
 */
export async function follow(path: string, following: Following): Promise<void> {
  let lastId = "";
  let isOver = false;
  let pause = FIRST_PAUSE_MS;
  const take = (event: ServerEvent): void => {
    lastId = event.id;
    pause = FIRST_PAUSE_MS;
    isOver = following.onEvent(event);
  };
  while (!following.signal.aborted) {
    try {
      const headers: Record<string, string> = lastId === "" ? {} : { "last-event-id": lastId };
      const reply = await send(path, { headers, signal: following.signal });
      following.onBreak(null);
      await read(reply, take);
      if (isOver) return;
      throw new Problem(0, "unavailable", "The stream of events ended before the job did; it is taken up again.");
    } catch (error) {
      if (following.signal.aborted) return;
      const problem = asProblem(error);
      following.onBreak(problem);
      if (problem.status >= 400 && problem.status < 500 && !PASSING.includes(problem.status)) return;
      await sleep(Math.max(pause, 1000 * problem.retryAfterS), following.signal);
      pause = Math.min(2 * pause, LONGEST_PAUSE_MS);
    }
  }
}

async function read(reply: Response, take: (event: ServerEvent) => void): Promise<void> {
  const reader = reply.body!.pipeThrough(new TextDecoderStream()).getReader();
  const parser = new EventParser();
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return;
    parser.push(value).forEach(take);
  }
}

function sleep(ms: number, signal: AbortSignal): Promise<void> {
  return new Promise((resolve) => {
    const timer = setTimeout(resolve, ms);
    signal.addEventListener("abort", () => (clearTimeout(timer), resolve()), { once: true });
  });
}
