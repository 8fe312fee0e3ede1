// Curves by uPlot: each .chart holds its data as JSON, {x, xlabel, ylabel, series: [{label, color, dash, x, y}]}.
"use strict";

{
  const HEIGHT = 260;
  const FONT = "12px system-ui, sans-serif";
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const color = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const shown = (value) => (value === null || value === undefined ? "–" : Number(value).toPrecision(4).replace(/\.?0+$/, ""));

  const draw = (element) => {
    const data = element.chart ??= JSON.parse(element.querySelector("script").textContent);
    element.plot?.destroy();
    const axis = { stroke: color("--quiet"), font: FONT, labelFont: FONT, labelSize: 20, size: 48,
      grid: { stroke: color("--line"), width: 1 }, ticks: { stroke: color("--line"), width: 1, size: 5 } };
    const tables = data.series.map((one) => [one.x, one.y]);
    element.plot = new uPlot({
      width: element.clientWidth,
      height: HEIGHT,
      scales: { x: { time: false } },
      axes: [{ ...axis, label: data.xlabel, size: 34 }, { ...axis, label: data.ylabel }],
      cursor: { drag: { x: true, y: false } },
      series: [
        { label: data.xlabel, value: (_, value) => shown(value) },
        ...data.series.map((one) => ({
          label: one.label, stroke: color(one.color), width: 1.6, dash: one.dash ? [6, 4] : undefined,
          points: { show: false }, value: (_, value) => shown(value),
        })),
      ],
    }, uPlot.join(tables), element);
  };

  const charts = [...document.querySelectorAll(".chart")];
  const width = new ResizeObserver((entries) => {
    for (const { target } of entries) {
      if (target.plot && Math.abs(target.plot.width - target.clientWidth) > 1) {
        target.plot.setSize({ width: target.clientWidth, height: HEIGHT });
      }
    }
  });
  for (const element of charts) {
    draw(element);
    width.observe(element);
  }
  dark.addEventListener("change", () => charts.forEach(draw));
}
