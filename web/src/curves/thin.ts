/** Fewer points of a curve that looks the same: of each bucket the first, the least, the greatest and the last. */

export interface Points {
  readonly x: readonly number[];
  readonly y: readonly number[];
}

/** Returns a curve with at most about `most` points, extremes and both ends kept.
 *
 * @param most At least 8; a curve of no more points is returned as it is.
 */
export function thin(points: Points, most: number): Points {
  const count = points.x.length;
  if (count <= most) return points;
  const buckets = Math.max(1, Math.floor(most / 4));
  const kept: number[] = [];
  for (let bucket = 0; bucket < buckets; bucket += 1) {
    const begin = Math.floor((bucket * count) / buckets);
    const end = Math.floor(((bucket + 1) * count) / buckets);
    kept.push(...keptOf(points.y, begin, end));
  }
  return { x: kept.map((index) => points.x[index]!), y: kept.map((index) => points.y[index]!) };
}

function keptOf(y: readonly number[], begin: number, end: number): number[] {
  let least = begin;
  let greatest = begin;
  for (let index = begin; index < end; index += 1) {
    if (y[index]! < y[least]!) least = index;
    if (y[index]! > y[greatest]!) greatest = index;
  }
  return [...new Set([begin, least, greatest, end - 1])].sort((a, b) => a - b);
}
