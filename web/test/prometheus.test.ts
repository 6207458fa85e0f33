import assert from "node:assert/strict";
import { test } from "node:test";
import { parseMetrics, quantile, sum } from "../src/panels/services/prometheus";

const TEXT = `# HELP calls Completed calls.
calls_total{code="ok",method="Act"} 8.0
calls_total{code="overloaded",method="Act"} 2.0
seconds_bucket{le="0.1",method="Act"} 50.0
seconds_bucket{le="0.2",method="Act"} 90.0
seconds_bucket{le="+Inf",method="Act"} 100.0
queued 3
`;

test("samples are summed by their labels", () => {
  const samples = parseMetrics(TEXT);
  assert.equal(sum(samples, "calls_total"), 10);
  assert.equal(
    sum(samples, "calls_total", (labels) => labels.code === "overloaded"),
    2,
  );
  assert.equal(sum(samples, "queued"), 3);
});

test("quantiles lie within their buckets, and beyond the last bound at it", () => {
  const samples = parseMetrics(TEXT);
  assert.equal(quantile(samples, "seconds", 0.5), 0.1);
  assert.ok(Math.abs(quantile(samples, "seconds", 0.7)! - 0.15) < 1e-9);
  assert.equal(quantile(samples, "seconds", 0.99), 0.2);
  assert.equal(quantile(samples, "nothing", 0.5), null);
});
