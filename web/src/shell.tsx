/** What surrounds every view: navigation, sign-in, the live region. */
import { useSignalEffect } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import { signedOut } from "./api/client";
import { SignIn, askSession } from "./parts/sign_in";
import { Link } from "./parts/link";
import { said, say } from "./parts/say";
import { Health, watchHealth } from "./panels/services/health";
import { query } from "./url/location";
import { VIEWS } from "./views";

export function Shell() {
  const view = VIEWS.find((each) => each.name === query.value.view) ?? VIEWS[0]!;
  useEffect(() => {
    void askSession();
    return watchHealth();
  }, []);
  useEffect(() => say(view.title), [view]);
  const { job, start } = query.value;
  const opened = useRef(`${view.name} ${job} ${start}`);
  useEffect(() => {
    const now = `${view.name} ${job} ${start}`;
    if (opened.current !== now && document.activeElement === document.body) focusMain();
    opened.current = now;
  }, [view, job, start]);
  useSignalEffect(() => {
    document.title = `${(VIEWS.find((each) => each.name === query.value.view) ?? VIEWS[0]!).title} · freerein`;
  });
  return (
    <>
      <a class="skip" href="#main">
        Skip to content
      </a>
      <header class="bar">
        <span class="wordmark">freerein</span>
        <nav aria-label="Views">
          <ul>
            {VIEWS.map((each) => (
              <li key={each.name}>
                <Link to={{ view: each.name }} current={each === view}>
                  {each.title}
                </Link>
              </li>
            ))}
          </ul>
        </nav>
        <Health />
      </header>
      <main id="main" tabIndex={-1}>
        {signedOut.value ? <SignIn /> : <view.Panel key={view.name} />}
      </main>
      <div class="unseen" aria-live="polite" role="status">
        {said.value}
      </div>
    </>
  );
}

/** Where the keys go on after what had the focus is gone, such as the button that opened what is there now. */
function focusMain(): void {
  document.getElementById("main")!.focus({ preventScroll: true });
}
