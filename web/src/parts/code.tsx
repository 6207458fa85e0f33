/** A command to copy. */
import { say } from "./say";

export function Code({ name, text }: { name: string; text: string }) {
  const copy = (): void => void navigator.clipboard?.writeText(text).then(() => say("Copied"));
  return (
    <div class="code">
      <pre tabIndex={0} aria-label={name} role="region">
        {text}
      </pre>
      <button type="button" class="quiet" aria-label={`Copy ${name}`} onClick={copy}>
        copy
      </button>
    </div>
  );
}
