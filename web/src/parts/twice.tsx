/** A button that is pressed twice: what it does cannot be undone. */
import { useState } from "preact/hooks";

export function Twice(props: { name: string; again: string; disabled: boolean; act: () => void }) {
  const [isAsked, setAsked] = useState(false);
  const press = (): void => {
    if (isAsked) props.act();
    setAsked(!isAsked);
  };
  return (
    <button type="button" disabled={props.disabled} onClick={press} onBlur={() => setAsked(false)}>
      {isAsked ? props.again : props.name}
    </button>
  );
}
