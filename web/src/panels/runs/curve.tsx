/** One metric over steps, of one job or of two, by uPlot; its numbers are there as text. */
import { useEffect, useRef } from "preact/hooks";
import type uPlot from "uplot";
import { thin, type Points } from "../../curves/thin";
import { short } from "../../parts/numbers";
import type { Mark } from "./series";

const HEIGHT = 170;
const TABLE_ROWS = 12;
/** Distances of marks on the axis of steps. */
const WHOLE_STEPS = [1, 10, 100, 1e3, 1e4, 1e5, 1e6].flatMap((each) => [each, 2 * each, 5 * each]);

export type PlotClass = typeof uPlot;

interface CurveProps {
  readonly Plot: PlotClass;
  readonly name: string;
  readonly points: Points;
  readonly other?: Points;
  readonly marks: readonly Mark[];
  readonly checkpoints: readonly number[];
}

export function Curve(props: CurveProps) {
  const { name, points, other } = props;
  const box = useRef<HTMLDivElement>(null);
  const plot = useRef<uPlot | null>(null);
  const drawn = useRef(props);
  drawn.current = props;
  useEffect(() => {
    const element = box.current!;
    const make = (): void => {
      plot.current?.destroy();
      plot.current = new props.Plot(
        optionsOf(element, () => drawn.current),
        dataOf(drawn.current, element.clientWidth),
        element,
      );
    };
    make();
    const theme = matchMedia("(prefers-color-scheme: dark)");
    theme.addEventListener("change", make);
    const watching = new ResizeObserver(() => plot.current?.setSize({ width: element.clientWidth, height: HEIGHT }));
    watching.observe(element);
    return () => {
      theme.removeEventListener("change", make);
      watching.disconnect();
      plot.current?.destroy();
      plot.current = null;
    };
  }, [name, other === undefined]);
  useEffect(() => plot.current?.setData(dataOf(props, box.current!.clientWidth)), [points, other, props.marks]);
  return (
    <figure class="curve">
      <figcaption>
        {name} <span class="curve-last">{short(points.y.at(-1))}</span>
        {other && <span class="curve-other">{short(other.y.at(-1))}</span>}
      </figcaption>
      <div ref={box} class="curve-plot" role="img" aria-label={`${name}: ${summary(points)}`} />
      <details>
        <summary>Numbers</summary>
        <NumberTable name={name} points={points} other={other} />
      </details>
    </figure>
  );
}

/** Returns aligned columns of both curves, thinned to what the width can show. */
function dataOf({ Plot, points, other }: CurveProps, width: number): uPlot.AlignedData {
  const most = Math.max(200, 2 * width);
  const first = thin(points, most);
  if (!other) return [[...first.x], [...first.y]];
  const second = thin(other, most);
  return Plot.join([
    [[...first.x], [...first.y]],
    [[...second.x], [...second.y]],
  ]);
}

function optionsOf(element: HTMLElement, props: () => CurveProps): uPlot.Options {
  const color = (name: string): string => getComputedStyle(element).getPropertyValue(name).trim();
  const axis = {
    stroke: color("--faint"),
    grid: { stroke: color("--line"), width: 1 },
    ticks: { show: false },
    font: "12px system-ui",
  };
  const line = { width: 1.6, points: { show: false }, spanGaps: true };
  return {
    width: element.clientWidth,
    height: HEIGHT,
    legend: { show: false },
    cursor: { sync: { key: "steps" }, points: { size: 6 } },
    scales: { x: { time: false } },
    axes: [
      { ...axis, size: 24, space: 60, incrs: WHOLE_STEPS },
      { ...axis, size: 52, values: (_, splits) => splits.map((each) => short(each)) },
    ],
    series: [
      {},
      { ...line, stroke: color("--accent"), points: { show: props().points.x.length < 3, size: 6 } },
      ...(props().other ? [{ ...line, stroke: color("--warning"), dash: [6, 4] }] : []),
    ],
    hooks: { draw: [(plot) => drawMarks(plot, props(), color("--bad"), color("--faint"))] },
  };
}

/** Draws a line for each event, and a tick at the bottom for each checkpoint. */
function drawMarks(plot: uPlot, { marks, checkpoints }: CurveProps, strong: string, faint: string): void {
  const { ctx: context, bbox } = plot;
  context.save();
  context.lineWidth = devicePixelRatio;
  const lineAt = (step: number, top: number): void => {
    const x = plot.valToPos(step, "x", true);
    context.beginPath();
    context.moveTo(x, top);
    context.lineTo(x, bbox.top + bbox.height);
    context.stroke();
  };
  context.strokeStyle = faint;
  checkpoints.forEach((step) => lineAt(step, bbox.top + bbox.height - 5 * devicePixelRatio));
  context.strokeStyle = strong;
  context.setLineDash([3, 3]);
  marks.forEach((mark) => lineAt(mark.step, bbox.top));
  context.restore();
}

function NumberTable({ name, points, other }: { name: string; points: Points; other?: Points }) {
  const count = Math.min(points.x.length, TABLE_ROWS);
  const shown = Array.from({ length: count }, (_, row) =>
    Math.round((row * (points.x.length - 1)) / Math.max(1, count - 1)),
  );
  const beside = new Map(other?.x.map((step, index) => [step, other.y[index]]));
  return (
    <table>
      <thead>
        <tr>
          <th scope="col">Step</th>
          <th scope="col">{name}</th>
          {other && <th scope="col">compared</th>}
        </tr>
      </thead>
      <tbody>
        {shown.map((index) => (
          <tr key={index}>
            <td>{points.x[index]}</td>
            <td>{short(points.y[index])}</td>
            {other && <td>{short(beside.get(points.x[index]!))}</td>}
          </tr>
        ))}
      </tbody>
    </table>
  );
}

function summary({ x, y }: Points): string {
  if (x.length === 0) return "no points yet";
  let [least, greatest] = [0, 0];
  y.forEach((each, index) => {
    if (each < y[least]!) least = index;
    if (each > y[greatest]!) greatest = index;
  });
  return (
    `${x.length} points to step ${x.at(-1)}, from ${short(y[0])} to ${short(y.at(-1))}; ` +
    `least ${short(y[least])} at step ${x[least]}, greatest ${short(y[greatest])} at step ${x[greatest]}`
  );
}
