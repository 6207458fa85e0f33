/** The card of a model: what it was trained on, how, and with which figures. */
import { short } from "../../parts/numbers";

const MOST_FIGURES = 6;

export function Card({ card }: { card: Readonly<Record<string, unknown>> }) {
  const figures = Object.entries((card.figures ?? {}) as Record<string, unknown>).filter(
    ([, value]) => typeof value === "number",
  );
  const words = ["method", "task", "supervision"].filter((key) => typeof card[key] === "string");
  return (
    <>
      <dl class="card-words">
        {words.map((key) => (
          <div key={key}>
            <dt>{key}</dt>
            <dd>{String(card[key])}</dd>
          </div>
        ))}
      </dl>
      {figures.length > 0 && (
        <dl class="figures">
          {figures.slice(0, MOST_FIGURES).map(([key, value]) => (
            <div key={key}>
              <dt>{key}</dt>
              <dd>{short(value as number)}</dd>
            </div>
          ))}
        </dl>
      )}
      <details>
        <summary>Whole card</summary>
        <pre tabIndex={0} role="region" aria-label="Card">
          {JSON.stringify(card, null, 2)}
        </pre>
      </details>
    </>
  );
}
