/** An input whose text is taken once it is complete: at Enter, or when the focus goes. Redrawing leaves it alone. */
import type { PartialInputHTMLAttributes } from "preact";
import { useState } from "preact/hooks";

type Attribute = "class" | "min" | "max" | "disabled" | "placeholder" | "title" | "aria-label" | "aria-invalid";

interface TypedProps extends Pick<PartialInputHTMLAttributes<HTMLInputElement>, Attribute> {
  readonly type?: "number";
  readonly list?: string;
  readonly value: string | number;
  readonly onValue: (text: string) => void;
}

export function Typed({ value, onValue, ...attributes }: TypedProps) {
  const [text, setText] = useState<string | null>(null);
  return (
    <input
      {...attributes}
      value={text ?? value}
      onInput={(event) => setText(event.currentTarget.value)}
      onChange={(event) => {
        setText(null);
        onValue(event.currentTarget.value);
      }}
      onBlur={() => setText(null)}
    />
  );
}
