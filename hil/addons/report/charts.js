// Draws the charts of a page with plotly; shows all charts over time at the same range; measures between two instants.
(async () => {
  const element = (id) => document.getElementById(id);
  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const unpacked = async (id) => {
    const stream = new Blob([bytes(element(id).textContent)]).stream();
    return new Response(stream.pipeThrough(new DecompressionStream("gzip"))).text();
  };
  const numbers = ({ dtype, bdata }) => new { f4: Float32Array, f8: Float64Array }[dtype](bytes(bdata).buffer);
  const is_touched = matchMedia("(pointer: coarse)").matches;
  const options = {
    responsive: true, displaylogo: false, displayModeBar: is_touched ? true : "hover",
    // Named one by one: plotly's own list has a button that sends the values to its makers.
    modeBarButtons: [["toImage"], ["zoom2d", "pan2d"], ["zoomIn2d", "zoomOut2d", "resetScale2d"]],
    toImageButtonOptions: { format: "svg" },
  };
  const drawn = [];
  let cursors = [];
  let is_linking = false;

  const nearest = (x, at) => {
    let [low, high] = [0, x.length - 1];
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (x[middle] <= at) low = middle; else high = middle;
    }
    return at - x[low] <= x[high] - at ? low : high;
  };
  const digits = (value) => Number.isFinite(value) ? String(Number(value.toPrecision(6))) : "-";

  const measure = (chart) => {
    const lines = cursors.map((t, number) => ({
      type: "line", x0: t, x1: t, yref: "paper", y0: 0, y1: 1, line: { color: "#1b4f9c", width: 1.5 },
      label: { text: String(number + 1), textposition: "start", font: { color: "#1b4f9c" } },
    }));
    Plotly.relayout(chart.div, { shapes: [...chart.layout.shapes, ...lines] });
    const table = chart.measured;
    table.replaceChildren();
    if (!cursors.length) {
      table.append(`${is_touched ? "Tap" : "Click"} two instants to measure between them.`);
      return;
    }
    const row = (cells, kind = "td") => {
      const line = table.lastChild.insertRow();
      cells.forEach((cell) => { line.append(Object.assign(document.createElement(kind), { textContent: cell })); });
    };
    table.append(document.createElement("table"));
    const [first, second] = cursors;
    const both = second !== undefined;
    const later = both ? [`2: ${digits(second)} s`, `Δt ${digits(second - first)} s`] : [];
    row(["", `1: ${digits(first)} s`, ...later], "th");
    for (const trace of chart.data.filter((one) => one.mode === "lines")) {
      const values = cursors.map((t) => trace.y[nearest(trace.x, t)]);
      row([trace.meta, ...values.map(digits), ...(both ? [`Δ ${digits(values[1] - values[0])}`] : [])]);
    }
  };

  const linked = (chart, change) => {
    if (is_linking) return;
    const keys = Object.keys(change).filter((key) => key.startsWith("xaxis."));
    if (!keys.length) return;
    is_linking = true;
    const same = Object.fromEntries(keys.map((key) => [key, change[key]]));
    Promise.all(drawn.filter((other) => other !== chart && other.time).map((other) => Plotly.relayout(other.div, same)))
      .finally(() => { is_linking = false; });
  };

  try {
    const script = document.createElement("script");
    script.textContent = await unpacked("plotly");
    document.head.append(script);
    const { xs, charts } = JSON.parse(await unpacked("values"));
    const arrays = xs.map(numbers);
    for (const [number, chart] of charts.entries()) {
      chart.div = element(`chart-${number}`);
      chart.measured = element(`measured-${number}`);
      for (const trace of chart.data) Object.assign(trace, { x: arrays[trace.x], y: numbers(trace.y) });
      if (is_touched) chart.layout.dragmode = false; // a finger that moves scrolls the page
      chart.layout.shapes = chart.layout.shapes || [];
      await Plotly.newPlot(chart.div, chart.data, structuredClone(chart.layout), options); // plotly changes it
      drawn.push(chart);
      if (!chart.time) continue;
      measure(chart);
      chart.div.on("plotly_relayout", (change) => linked(chart, change));
      chart.div.on("plotly_click", ({ points }) => {
        cursors = cursors.length === 2 ? [points[0].x] : [...cursors, points[0].x];
        drawn.filter((one) => one.time).forEach(measure);
      });
    }
    const over_time = drawn.filter((one) => one.time);
    for (const button of document.querySelectorAll("button.at")) {
      button.title = "show this instant in the plots";
      button.addEventListener("click", () => {
        const [low, high] = over_time[0].layout.xaxis.range;
        const half = Math.max((high - low) / 100, 0.5);
        const t = Number(button.dataset.t);
        over_time.forEach(({ div }) => Plotly.relayout(div, { "xaxis.range": [t - half, t + half] }));
        over_time[0].div.scrollIntoView();
      });
    }
    const to_width = (width) =>
      drawn.forEach(({ div }) => Plotly.relayout(div, width ? { width } : { autosize: true, width: null }));
    addEventListener("beforeprint", () => to_width(855)); // A4 without its margins, at the zoom of the print style
    addEventListener("afterprint", () => to_width(null));
    document.body.dataset.drawn = "yes";
  } catch (error) {
    element("undrawn").textContent = `The plots could not be drawn: ${error}`;
  }
})();
