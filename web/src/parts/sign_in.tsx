/** Takes the token once; the service sets a cookie that no script can read. */
import { useState } from "preact/hooks";
import { needsToken, send, signedOut } from "../api/client";
import { asProblem, type Problem } from "../api/problem";

/** Asks whether a token is needed. */
export async function askSession(): Promise<void> {
  try {
    const session = (await (await send("/session")).json()) as { token_needed: boolean; signed_in: boolean };
    needsToken.value = session.token_needed;
    signedOut.value = session.token_needed && !session.signed_in;
  } catch {
    // The view says who is away.
  }
}

export function SignIn() {
  const [problem, setProblem] = useState<Problem | null>(null);
  const [isBusy, setBusy] = useState(false);
  const signIn = async (event: Event): Promise<void> => {
    event.preventDefault();
    const token = new FormData(event.currentTarget as HTMLFormElement).get("token");
    setBusy(true);
    try {
      const body = JSON.stringify({ token });
      await send("/session", { method: "POST", headers: { "content-type": "application/json" }, body });
      signedOut.value = false;
    } catch (error) {
      setProblem(asProblem(error));
    } finally {
      setBusy(false);
    }
  };
  return (
    <form class="sign-in card" onSubmit={(event) => void signIn(event)}>
      <h1>Sign in</h1>
      <p>
        These services need a token: the value of <code>FREEREIN_TOKEN</code> that they were started with.
      </p>
      <label>
        Token
        <input name="token" type="password" autoComplete="current-password" required aria-invalid={problem !== null} />
      </label>
      {problem && (
        <p class="field-error" role="alert">
          {problem.detail}
        </p>
      )}
      <button type="submit" class="main-action" disabled={isBusy}>
        Sign in
      </button>
    </form>
  );
}
