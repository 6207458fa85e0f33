/** The states of what is not there: empty, loading, failed, away. */
import type { ComponentChildren } from "preact";
import type { Problem } from "../api/problem";
import type { Remote } from "../api/remote";

export function Empty(props: { title: string; children?: ComponentChildren }) {
  return (
    <div class="notice">
      <p class="notice-title">{props.title}</p>
      {props.children && <div class="notice-text">{props.children}</div>}
    </div>
  );
}

export function Loading(props: { what: string }) {
  return (
    <p class="loading" role="status">
      Loading {props.what} …
    </p>
  );
}

/** A call that failed, and what to do. One that is away is tried again without a click. */
export function Failed(props: { problem: Problem; retry?: () => void }) {
  const { problem } = props;
  return (
    <div class={`notice ${problem.isAway ? "away" : "failed"}`} role="alert">
      <p class="notice-title">{problem.isAway ? "Away" : "Failed"}</p>
      <div class="notice-text">
        <p>{problem.detail}</p>
        {problem.hint && <p>{problem.hint}</p>}
        {problem.requestId && <p class="faint">Request id: {problem.requestId}</p>}
      </div>
      {props.retry && (
        <button type="button" onClick={props.retry}>
          Try again
        </button>
      )}
    </div>
  );
}

/** What was asked for, or why it is not there. */
export function Shown<T>(props: {
  remote: Remote<T>;
  what: string;
  retry: () => void;
  children: (value: T) => ComponentChildren;
}) {
  const { remote } = props;
  if (remote.state === "loading") return <Loading what={props.what} />;
  if (remote.state === "failed") return <Failed problem={remote.problem} retry={props.retry} />;
  return <>{props.children(remote.value)}</>;
}
