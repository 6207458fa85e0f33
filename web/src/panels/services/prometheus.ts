/** Metrics in the Prometheus text format, as far as the page needs them. */

export interface Sample {
  readonly name: string;
  readonly labels: Readonly<Record<string, string>>;
  readonly value: number;
}

const LINE = /^(\w+)(?:\{(.*)\})? (\S+)$/;
const LABEL = /(\w+)="((?:[^"\\]|\\.)*)"/g;

/** Returns the samples of a text. */
export function parseMetrics(text: string): Sample[] {
  return text.split("\n").flatMap((line) => {
    const [, name, labels = "", value] = LINE.exec(line) ?? [];
    if (name === undefined) return [];
    const pairs = [...labels.matchAll(LABEL)].map(([, key, each]) => [key, each]);
    return [{ name, labels: Object.fromEntries(pairs) as Record<string, string>, value: Number(value) }];
  });
}

/** Returns the sum of the samples of a name whose labels are as given. */
export function sum(
  samples: readonly Sample[],
  name: string,
  isMeant: (labels: Sample["labels"]) => boolean = () => true,
) {
  const meant = samples.filter((each) => each.name === name && isMeant(each.labels));
  return meant.reduce((total, each) => total + each.value, 0);
}

/** Returns a quantile of a histogram in its unit, interpolated within its bucket; null without any call.
 *
 * @param name Name of the histogram, without `_bucket`.
 */
export function quantile(
  samples: readonly Sample[],
  name: string,
  share: number,
  isMeant: (labels: Sample["labels"]) => boolean = () => true,
): number | null {
  const counts = new Map<number, number>();
  for (const each of samples.filter((sample) => sample.name === `${name}_bucket` && isMeant(sample.labels))) {
    const bound = each.labels.le === "+Inf" ? Infinity : Number(each.labels.le);
    counts.set(bound, (counts.get(bound) ?? 0) + each.value);
  }
  const buckets = [...counts].sort(([a], [b]) => a - b);
  const rank = share * (buckets.at(-1)?.[1] ?? 0);
  if (rank === 0) return null;
  let [lower, below] = [0, 0];
  for (const [bound, count] of buckets) {
    if (count >= rank) return bound === Infinity ? lower : lower + ((rank - below) / (count - below)) * (bound - lower);
    [lower, below] = [bound, count];
  }
  return lower;
}
