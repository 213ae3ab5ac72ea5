/* The three charts. Frontiers come computed with the data; nothing is ranked here. */
const PALETTE = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"]; // Okabe and Ito
const SHAPES = ["circle", "square", "diamond", "triangle-up", "cross"]; // one more for every six methods
const MARKERS = { floor: "square-open", ceiling: "triangle-up-open", oracle: "star-diamond-open" };
const KIND_NAMES = { floor: "floor", ceiling: "ceiling", oracle: "oracle: not real-time" };
const PARTS = {
  noise_floor: ["noise of the reference", "#999999"], projection: ["projection", "#0072b2"],
  coefficient: ["coefficient", "#e69f00"], storage: ["storage", "#009e73"], runtime: ["runtime", "#cc79a7"],
};
const SIZE_MARKERS = { relative_rmse: { symbol: "line-ns-open", size: 15, line: { width: 2 } }, measurement: { symbol: "x-thin-open", size: 7, line: { width: 1.4 } } };
const METHODS = [...new Set(data.groups.flatMap((each) => each.rows.filter((row) => row.kind === "method").map((row) => row.method)))];
const colour = (row) => (row.kind === "method" ? PALETTE[METHODS.indexOf(row.method) % PALETTE.length] : css("--soft"));
const symbol = (row) => MARKERS[row.kind] ?? SHAPES[Math.floor(METHODS.indexOf(row.method) / PALETTE.length) % SHAPES.length];
const plain = (text) => text.replaceAll("&", "&amp;").replaceAll("<", "&lt;");
const named = (metric) => data.metrics[metric].label + (data.metrics[metric].unit ? ` [${data.metrics[metric].unit}]` : "");
const CONFIG = { displaylogo: false, responsive: true, modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"],
  toImageButtonOptions: { format: "svg", filename: "prt-bench" }, displayModeBar: false };

function layout(changes) {
  const axis = { gridcolor: css("--hair"), linecolor: css("--rule"), zeroline: false, tickcolor: css("--rule"), ticks: "outside", ticklen: 4 };
  return {
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", font: { family: css("--sans"), size: 12.5, color: css("--soft") },
    margin: { l: 66, r: 18, t: 12, b: 52 }, hoverlabel: { bgcolor: css("--paper"), bordercolor: css("--rule"), font: { color: css("--ink"), size: 12.5 }, align: "left" },
    hovermode: "closest", dragmode: false, ...changes,
    ...Object.fromEntries(["xaxis", "xaxis2", "yaxis"].filter((name) => changes[name]).map((name) => [name, { ...axis, ...changes[name] }])),
  };
}

/* A log axis is labelled 1-2-5 over a short range, by decades over a long one. */
function axis(title, values, log, extra = {}) {
  const low = Math.min(...values), high = Math.max(...values);
  if (!values.length) return { title: { text: title }, range: [0, 1], ...extra };
  if (log) {
    const [from, to] = [Math.log10(low), Math.log10(high)];
    const pad = Math.max(0.09 * (to - from), 0.05);
    const ticks = [];
    for (let power = Math.floor(from - pad); power <= to + pad; power++) {
      for (const step of to - from > 2.5 ? [1] : to - from > 1.2 ? [1, 2, 5] : to - from > 0.5 ? [1, 1.5, 2, 3, 5, 7] : [1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 7, 8, 9]) ticks.push(step * 10 ** power);
    }
    return { title: { text: title }, type: "log", range: [from - pad, to + pad], tickvals: ticks, ticktext: ticks.map(short), ...extra };
  }
  const pad = Math.max(0.07 * (high - low), 1e-9);
  return { title: { text: title }, range: [low >= 0 ? Math.max(low - pad, low === 0 ? -pad : 0) : low - pad, high + pad], ...extra };
}

function short(value) {
  for (const [size, suffix] of [[1e9, "G"], [1e6, "M"], [1e3, "k"]]) if (value >= size) return `${+(value / size).toPrecision(3)}${suffix}`;
  return value < 1e-4 ? value.toExponential(0) : String(+value.toPrecision(3));
}

let frontiersDrawn = 0; // counts requests: labels are placed when the last one is on the page

function drawFrontier() {
  const request = ++frontiersDrawn;
  const [x, y] = [$("axis-x").value, $("axis-y").value];
  const [logX, logY] = [$("log-x").checked, $("log-y").checked];
  const fits = (value, log) => value !== null && (!log || value > 0);
  const drawable = group.rows.filter((row) => fits(row.values[y], logY) && (row.values[x] === null || fits(row.values[x], logX)));
  const timed = drawable.filter((row) => row.values[x] !== null);
  const untimed = drawable.filter((row) => row.values[x] === null);
  const best = new Set(group.frontiers[`${x} ${y}`].map((index) => group.rows[index]));
  const hover = (row) => `<b>${plain(row.label)}</b><br>${data.metrics[y].label} ${row.shown[y]}<br>${data.metrics[x].label} ${row.shown[x]} ${data.metrics[x].unit.replace("bytes", "")}`
    + `<br>${row.place === "–" ? plain(row.status) : `rank ${row.place}`}${best.has(row) ? ", on the frontier" : ""}`;

  const family = (row) => (row.kind === "method" ? row.method : row.kind);
  const families = [...new Map(drawable.map((row) => [family(row), row]))];
  const legend = families.map(([name, row]) => ({ type: "scatter", mode: "markers", name: plain(KIND_NAMES[name] ?? name), x: [null], y: [null], hoverinfo: "skip",
    marker: { symbol: symbol(row), color: colour(row), size: 9 } }));
  const scatter = (rows, on) => families.map(([name]) => {
    const members = rows.filter((row) => family(row) === name);
    return {
      type: "scatter", mode: "markers", showlegend: false, xaxis: on,
      x: members.map((row) => (on === "x" ? row.values[x] : 0)), y: members.map((row) => row.values[y]),
      marker: {
        symbol: members.map(symbol), color: members.map(colour), size: members.map((row) => (best.has(row) ? 11 : 9)),
        opacity: members.map((row) => (best.has(row) || row.kind !== "method" ? 1 : 0.35)), line: { width: members[0]?.kind === "method" ? 0 : 1.6, color: colour(members[0] ?? { kind: "" }) },
      },
      text: members.map(hover), hovertemplate: "%{text}<extra></extra>",
    };
  }).filter((trace) => trace.x.length);

  const steps = group.frontiers[`${x} ${y}`].map((index) => group.rows[index]).filter((row) => timed.includes(row));
  const line = { type: "scatter", mode: "lines", x: steps.map((row) => row.values[x]), y: steps.map((row) => row.values[y]),
    line: { shape: "hv", color: css("--ink"), width: 1.2 }, name: "frontier", hoverinfo: "skip", showlegend: steps.length > 1 };
  const spreads = { type: "scatter", mode: "markers", x: timed.map((row) => row.values[x]), y: timed.map((row) => row.values[y]), marker: { opacity: 0 },
    error_x: { type: "data", array: timed.map((row) => row.spread[x] ?? 0), thickness: 1, width: 0, color: css("--rule") }, hoverinfo: "skip", showlegend: false };
  const noise = y === "relative_rmse" && fits(group.noise, logY) ? group.noise : null;
  const heights = [...drawable.map((row) => row.values[y]), ...(noise === null ? [] : [noise])];
  const yaxis = axis(named(y), heights, logY, { anchor: "free", position: 0 });
  const shapes = noise === null ? [] : [
    { type: "rect", xref: "paper", x0: 0, x1: 1, y0: logY ? 10 ** yaxis.range[0] : yaxis.range[0], y1: noise, fillcolor: css("--band"), line: { width: 0 }, layer: "below" },
    { type: "line", xref: "paper", x0: 0, x1: 1, y0: noise, y1: noise, line: { color: css("--soft"), width: 1, dash: "dash" } },
  ];
  const noiseText = noise === null ? [] : [{ xref: "paper", x: 1, xanchor: "right", y: logY ? Math.log10(noise) : noise, yanchor: "top", yshift: 1, showarrow: false,
    text: `noise floor ${short(+noise.toPrecision(2))}${$("chart-frontier").clientWidth > 600 ? ": rows below it are tied" : ""}`, font: { size: 11.5, color: css("--soft") } }];
  const gutter = untimed.length > 0;
  const ends = timed.flatMap((row) => [-1, 1].map((sign) => row.values[x] + sign * (row.spread[x] ?? 0)));
  const chart = layout({
    xaxis: axis(named(x), ends.filter((value) => fits(value, logX)), logX, { domain: [gutter ? 0.13 : 0, 1], ...(gutter ? { anchor: "y" } : {}) }), yaxis, shapes, annotations: noiseText,
    legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0, font: { size: 12.5 } }, margin: { l: 70, r: 18, t: 40, b: 56 },
    ...(gutter ? { xaxis2: { domain: [0, 0.1], range: [-1, 1], tickvals: [0], ticktext: [`no ${data.metrics[x].unit === "ms" ? "time" : "figure"}`], showgrid: false } } : {}),
  });
  const frame = $("chart-frontier");
  Plotly.react(frame, [spreads, line, ...legend, ...scatter(timed, "x"), ...scatter(untimed, "x2")], chart, CONFIG).then(() => {
    if (request !== frontiersDrawn) return;
    const named = [...timed.filter((row) => best.has(row) || row.kind !== "method"), ...untimed];
    Plotly.relayout(frame, { annotations: [...noiseText, ...labels(frame, named, timed, drawable, x, y)] });
  });

  const hidden = group.rows.filter((row) => !drawable.includes(row));
  const sentences = [`${best.size} of ${group.rows.filter((row) => row.place !== "–").length} ranked rows are on the frontier; no other row is at once cheaper and more accurate. Faded rows are dominated. Bars span the interquartile range.`];
  if (hidden.length) sentences.push(`Not on this chart: ${hidden.map((row) => `${row.label} (${row.values[y] === null && row.status !== "ok" ? row.status : row.values[y] === null ? "not measured" : "zero or negative on a log axis"})`).join("; ")}.`);
  $("note-frontier").textContent = sentences.join(" ");
}

/* Names the rows whose label finds room beside its marker; the others keep theirs for the pointer. */
function labels(frame, wanted, timed, drawable, x, y) {
  const full = frame._fullLayout;
  const at = (row) => {
    const across = timed.includes(row) ? full.xaxis : full.xaxis2;
    return [across._offset + across.d2p(timed.includes(row) ? row.values[x] : 0), full.yaxis._offset + full.yaxis.d2p(row.values[y])];
  };
  const taken = drawable.map((row) => { const [px, py] = at(row); return [px - 7, py - 7, px + 7, py + 7]; });
  const right = full.width - 8;
  return wanted.flatMap((row) => {
    const [px, py] = at(row);
    const width = 6.6 * row.label.length + 4;
    for (const [anchor, dx, dy] of [["left", 10, -10], ["left", 10, 10], ["right", -10, 10], ["right", -10, -10], ["left", 12, 0], ["center", 0, -16], ["center", 0, 16]]) {
      const from = px + dx - (anchor === "left" ? 0 : anchor === "right" ? width : width / 2);
      const box = [from, py + dy - 8, from + width, py + dy + 8];
      const free = box[0] > 4 && box[2] < right && box[3] < full.yaxis._offset + full.yaxis._length && taken.every((other) => box[2] < other[0] || box[0] > other[2] || box[3] < other[1] || box[1] > other[3]);
      if (free) {
        taken.push(box);
        return [{ xref: "paper", yref: "paper", showarrow: false, text: plain(row.label), font: { size: 11.5, color: row.kind === "method" ? css("--ink") : css("--soft") }, xanchor: anchor, yanchor: "middle",
          x: (px + dx - full._size.l) / full._size.w, y: 1 - (py + dy - full._size.t) / full._size.h }];
      }
    }
    return [];
  });
}

function drawErrors() {
  const rows = group.rows.filter((row) => row.errors.projection !== null && row.errors.relative_rmse !== null).reverse();
  $("errors").hidden = rows.length === 0;
  if (!rows.length) return;
  const stacked = $("errors-mode").value === "stack";
  const whole = (row) => data.parts.reduce((sum, part) => sum + (row.errors[part] ?? 0) ** 2, 0);
  const parts = stacked ? PARTS : { ...PARTS, measurement: ["shadow-mapped measurement", css("--ink")], relative_rmse: ["relative RMSE", css("--ink")] };
  const traces = Object.entries(parts).map(([part, [name, fill]]) => ({
    name, y: rows.map((row) => plain(row.label)), customdata: rows.map((row) => short(row.errors[part] ?? 0)), hovertemplate: `<b>%{y}</b><br>${name} %{customdata}<extra></extra>`,
    ...(stacked
      ? { type: "bar", orientation: "h", x: rows.map((row) => 100 * (row.errors[part] ?? 0) ** 2 / whole(row)), marker: { color: fill, line: { color: css("--paper"), width: 0.5 } } }
      : { type: "scatter", mode: "markers", x: rows.map((row) => row.errors[part] || null), marker: { color: fill, ...SIZE_MARKERS[part] ?? { symbol: "circle", size: 9 } } }),
  }));
  const frame = $("chart-errors");
  const room = Math.min(Math.max(...rows.map((row) => row.label.length)), Math.floor(0.4 * frame.clientWidth / 6.8));
  const clipped = (label) => (label.length > room ? `${label.slice(0, room - 1)}…` : label);
  const sizes = rows.flatMap((row) => Object.keys(parts).map((part) => row.errors[part]).filter((value) => value > 0));
  const across = stacked ? { title: { text: "share of the squared error" }, range: [0, 100.5], ticksuffix: " %" } : axis("error relative to the reference", sizes, true);
  const wholes = stacked ? rows.map((row) => ({ xref: "paper", x: 1, xanchor: "left", xshift: 8, y: plain(row.label), text: row.shown.relative_rmse, showarrow: false, font: { color: css("--ink") } })) : [];
  frame.style.height = `${110 + 25 * rows.length}px`;
  Plotly.react(frame, traces, layout({ barmode: "stack", bargap: 0.35, xaxis: across, yaxis: { ticks: "", showgrid: !stacked, type: "category", range: [-0.7, rows.length - 0.3],
      tickvals: rows.map((row) => plain(row.label)), ticktext: rows.map((row) => plain(clipped(row.label))) },
    annotations: wholes, legend: { orientation: "h", y: 1, yanchor: "bottom", x: 0, traceorder: "normal" }, margin: { l: 6.8 * room + 18, r: stacked ? 70 : 18, t: 46, b: 50 } }), CONFIG);
  $("note-errors").textContent = stacked
    ? "Errors add in squares, so a bar shows each part's share of the squared sum; the relative RMSE stands at its end. Noise is how far the reference itself may be off, and is partly counted again in what follows. Projection is the best the basis could do; coefficient is what the transfer adds to it; storage is the shipped asset against the fitted model; runtime is OpenGL against JAX on the same measured light. Methods without a basis are left out."
    : "The same parts, each at its own size, beside the whole relative RMSE. Shadow-mapped measurement is the error of the light that the renderer measures, before any transfer.";
}

function drawSpectrum() {
  $("spectrum").hidden = group.curves.length === 0;
  if (!group.curves.length) return;
  const traces = [...group.curves].reverse().map((curve) => { // the best-placed method is drawn last, on top
    const hue = colour(curve);
    return { type: "scatter", mode: "lines+markers", name: plain(curve.method), x: curve.values.map((_, index) => index + 1), y: curve.values.map((value) => (value > 0 ? value : null)),
      line: { width: 1.4, color: hue }, marker: { size: 4, color: hue }, hovertemplate: `<b>${plain(curve.label)}</b><br>σ<sub>%{x}</sub> / σ<sub>1</sub> = %{y:.3g}<extra></extra>` };
  });
  const positive = group.curves.flatMap((curve) => curve.values.filter((value) => value > 1e-7)); // below: rounding
  const frame = $("chart-spectrum");
  frame.style.height = "320px";
  Plotly.react(frame, traces, layout({ xaxis: { title: { text: "index" }, rangemode: "tozero" }, yaxis: axis("σ / σ₁", positive, true), showlegend: true,
    legend: { orientation: "h", y: 1, yanchor: "bottom", x: 0, traceorder: "reversed" }, margin: { l: 76, r: 18, t: 36, b: 50 } }), CONFIG);
}

function drawTraining() {
  $("training").hidden = group.trainings.length === 0;
  if (!group.trainings.length) return;
  const traces = [...group.trainings].reverse().map((training) => {
    const hue = colour(training);
    return { type: "scatter", mode: "lines+markers", name: plain(training.label), x: training.steps, y: training.error,
      line: { width: 1.4, color: hue }, marker: { color: hue, symbol: training.steps.map((_, index) => (index === training.best ? "circle-open" : "circle")),
        size: training.steps.map((_, index) => (index === training.best ? 11 : 3)) },
      hovertemplate: `<b>${plain(training.label)}</b><br>%{x} steps: %{y:.3g}<extra></extra>` };
  });
  const frame = $("chart-training");
  frame.style.height = "320px";
  Plotly.react(frame, traces, layout({ xaxis: { title: { text: "steps" }, rangemode: "tozero" }, yaxis: axis("error held out / at the start", group.trainings.flatMap((training) => training.error), true), showlegend: true,
    legend: { orientation: "h", y: 1, yanchor: "bottom", x: 0, traceorder: "reversed" }, margin: { l: 76, r: 18, t: 36, b: 50 } }), CONFIG);
}

function drawCharts() {
  drawFrontier();
  drawErrors();
  drawSpectrum();
  drawTraining();
}

function startCharts() {
  for (const [id, names] of [["axis-x", data.axes.x], ["axis-y", data.axes.y]]) {
    const measured = names.filter((name) => data.groups.some((each) => each.rows.some((row) => row.values[name] !== null)));
    $(id).append(...(measured.length ? measured : names).map((name) => element("option", { value: name, textContent: named(name) })));
    const log = $(`log-${id.at(-1)}`);
    $(id).onchange = () => { log.checked = data.metrics[$(id).value].log; drawFrontier(); };
    log.onchange = drawFrontier;
  }
  $("errors-mode").onchange = drawErrors;
  let pause = 0;
  addEventListener("resize", () => { clearTimeout(pause); pause = setTimeout(drawCharts, 200); });
}
