/** Numbers as people read them. */

/** Returns a number with four digits that count. */
export function short(value: number | undefined | null): string {
  if (value === undefined || value === null) return "–";
  if (value === 0) return "0";
  const size = Math.abs(value);
  return size >= 1e5 || size < 1e-3 ? value.toExponential(2) : String(Number(value.toPrecision(4)));
}
