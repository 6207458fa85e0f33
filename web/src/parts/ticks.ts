/** A number that grows while the page is seen: what depends on it is asked for again. */
import { useEffect, useState } from "preact/hooks";

export function useTicks(periodMs: number): number {
  const [ticks, setTicks] = useState(0);
  useEffect(() => {
    const timer = window.setInterval(() => {
      if (document.visibilityState === "visible") setTicks((before) => before + 1);
    }, periodMs);
    return () => window.clearInterval(timer);
  }, [periodMs]);
  return ticks;
}
