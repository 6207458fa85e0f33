/** What a part of the page asks of a service: loading, there, or failed. */
import { useEffect, useRef, useState } from "preact/hooks";
import { asProblem, type Problem } from "./problem";

export type Remote<T> =
  | { readonly state: "loading" }
  | { readonly state: "ready"; readonly value: T }
  | { readonly state: "failed"; readonly problem: Problem };

const RETRY_MS = 3000;

/** Loads a value whenever `key` changes; one whose service is away is asked for again until it answers.
 *
 * @param moment A number; when it changes the value is loaded again, and the last one stays until then.
 * @returns The value, and a function that loads it again.
 */
export function useRemote<T>(
  load: (signal: AbortSignal) => Promise<T>,
  key: string,
  moment = 0,
): [Remote<T>, () => void] {
  const [remote, setRemote] = useState<Remote<T>>({ state: "loading" });
  const [turn, setTurn] = useState(0);
  const loaded = useRef(key);
  useEffect(() => {
    const aborting = new AbortController();
    let again = 0;
    if (loaded.current !== key) setRemote({ state: "loading" });
    loaded.current = key;
    load(aborting.signal).then(
      (value) => !aborting.signal.aborted && setRemote({ state: "ready", value }),
      (error: unknown) => {
        if (aborting.signal.aborted) return;
        const problem = asProblem(error);
        setRemote({ state: "failed", problem });
        if (problem.isAway) again = window.setTimeout(() => setTurn((before) => before + 1), RETRY_MS);
      },
    );
    return () => {
      aborting.abort();
      window.clearTimeout(again);
    };
  }, [key, turn, moment]);
  return [remote, () => setTurn((before) => before + 1)];
}
