/** Small drawings for buttons that have a name of their own. */
const PATHS = {
  play: "M5 3v10l8-5z",
  pause: "M4 3h3v10H4zM9 3h3v10H9z",
  before: "M10 3 5 8l5 5 1.4-1.4L7.8 8l3.6-3.6z",
  after: "M6 3l5 5-5 5-1.4-1.4L8.2 8 4.6 4.4z",
  boundaryBefore: "M3 3h2v10H3zM13 3v10L6 8z",
  boundaryAfter: "M11 3h2v10h-2zM3 3v10l7-5z",
} as const;

export function Icon({ name }: { name: keyof typeof PATHS }) {
  return (
    <svg class="icon" viewBox="0 0 16 16" width="16" height="16" aria-hidden="true">
      <path d={PATHS[name]} fill="currentColor" />
    </svg>
  );
}
