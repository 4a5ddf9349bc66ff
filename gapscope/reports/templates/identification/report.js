/* Draws torque over time, what is left over the speed, and the singular values. */
"use strict";

const curves = JSON.parse(document.getElementById("curves").textContent);
const style = getComputedStyle(document.documentElement);
const colour = (name) => style.getPropertyValue("--" + name).trim();
const font = { family: getComputedStyle(document.body).fontFamily, size: 13, color: colour("ink") };
const shown = { joint: curves.worst, group: 0 };

function decode(text) {
  return new Float32Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
}

function axis(title, more) {
  return { title: { text: title, standoff: 8 }, gridcolor: "#e6e9ed", zerolinecolor: "#aab2bc", automargin: true, ...more };
}

function draw(id, traces, layout) {
  const common = {
    font, margin: { l: 62, r: 14, t: 34, b: 46 }, paper_bgcolor: "#fff", plot_bgcolor: "#fff", hovermode: "closest",
    hoverlabel: { font }, legend: { orientation: "h", x: 0, y: 1, yanchor: "bottom", xanchor: "left" },
  };
  // Named one by one: by default there is a button that sends the data to a server.
  const config = { responsive: true, displaylogo: false, plotlyServerURL: "", modeBarButtons: [["zoom2d", "pan2d", "resetScale2d", "toImage"]] };
  return Plotly.react(document.getElementById(id), traces, { ...common, ...layout }, config);
}

function line(x, y, name, colourName, more) {
  return { type: "scatter", mode: "lines", x, y, name, line: { color: colour(colourName), width: 1.6 }, hovertemplate: `%{y:.4~g} ${force()}<extra>%{fullData.name}</extra>`, ...more };
}

/* Unit of what drives the joint that is shown. */
function force() {
  return curves.slides[shown.joint] ? "N" : "N m";
}

function drawAll() {
  const speedUnit = curves.slides[shown.joint] ? "m/s" : "rad/s";
  const group = curves.groups[shown.group];
  const raw = group.joints[shown.joint];
  const [t, recorded, identified, nominal, speed, left] = ["t", "recorded", "identified", "nominal", "speed", "left"].map((key) => decode(raw[key]));
  const rest = (model) => recorded.map((value, i) => value - model[i]);
  draw("torque-figure", [
    line(t, recorded, "recorded", "measured", { line: { color: colour("measured"), width: 2 } }),
    line(t, nominal, "nominal arm", "nominal"),
    line(t, identified, "identified arm", "corrected", { line: { color: colour("corrected"), width: 1.6, dash: "5px,2px" } }),
    line(t, rest(nominal), "left by the nominal arm", "nominal", { yaxis: "y2", showlegend: false }),
    line(t, rest(identified), "left by the identified arm", "corrected", { yaxis: "y2", showlegend: false }),
  ], {
    hovermode: "x unified",
    xaxis: axis("time [s]", { anchor: "y2", range: [t[0], t[t.length - 1]], hoverformat: ".3f", uirevision: group.name }),
    yaxis: axis(`torque [${force()}]`, { domain: [0.44, 1], uirevision: shown.joint }),
    yaxis2: axis(`left [${force()}]`, { domain: [0, 0.37], anchor: "x", uirevision: shown.joint }),
  });
  draw("speed-figure", [{
    type: "scatter", mode: "markers", x: speed, y: left, name: "left", showlegend: false,
    marker: { color: colour("corrected"), size: 4, opacity: 0.5 },
    hovertemplate: `%{x:.3~g} ${speedUnit}, %{y:.3~g} ${force()}<extra></extra>`,
  }], { xaxis: axis(`speed [${speedUnit}]`), yaxis: axis(`left [${force()}]`) });
}

function drawSpectrum() {
  const place = curves.spectrum.map((_, i) => i + 1);
  const ends = [1, Math.max(2, place.length)];
  draw("spectrum-figure", [{
    type: "scatter", mode: "markers", x: place, y: curves.spectrum, name: "singular value", showlegend: false,
    marker: { color: colour("corrected"), size: 5 }, hovertemplate: "%{x}: %{y:.2~e}<extra></extra>",
  }, {
    type: "scatter", mode: "lines", x: ends, y: [curves.limit, curves.limit], name: "limit of the condition number", hoverinfo: "skip",
    line: { color: colour("floor"), width: 1.5, dash: "dash" },
  }], { xaxis: axis("singular value, number"), yaxis: axis("over the largest", { type: "log", dtick: 1, exponentformat: "power" }) });
}

/* What a partial update moved and held. */
function drawUpdate() {
  const trace = (name, colourName, rows) => ({
    type: "scatter", mode: "markers", name, showlegend: true, x: rows.map((p) => p.name), y: rows.map((p) => p.change),
    marker: { color: colour(colourName), size: 7 }, error_y: { type: "data", array: rows.map((p) => 2 * p.std), thickness: 1, width: 2 },
    hovertemplate: "%{x}: %{y:.3~g} N m<extra>%{fullData.name}</extra>",
  });
  const groups = [true, false].map((moved) => curves.update.filter((p) => p.moved === moved));
  draw("update-figure", [trace("moved", "corrected", groups[0]), trace("held", "nominal", groups[1])], {
    xaxis: axis("", { categoryorder: "array", categoryarray: curves.update.map((p) => p.name), tickangle: -90 }),
    yaxis: axis("change [N m]"),
  });
}

function select(change) {
  Object.assign(shown, change);
  document.querySelectorAll("#joint-tabs button").forEach((button, i) => button.setAttribute("aria-pressed", i === shown.joint));
  drawAll();
}

/* Vertical lines at moments of the elapsed time, with a word each. */
function moments() {
  const filter = curves.filter;
  const marks = [
    ...filter.starts.map((start) => [start.elapsed, start.name, "nominal"]),
    ...filter.changes.map((change) => [change.elapsed, change.text.split(" at ")[0], "measured"]),
  ];
  if (filter.converged !== null) marks.push([filter.converged, "converged", "floor"]);
  const shapes = marks.map(([x, , name]) => ({ type: "line", x0: x, x1: x, yref: "paper", y0: 0, y1: 1, line: { color: colour(name), width: 1.5, dash: "dot" } }));
  const annotations = marks.map(([x, text, name]) => ({ x, yref: "paper", y: 0.99, text, showarrow: false, xanchor: "left", yanchor: "top", textangle: 90, font: { size: 11, color: colour(name) } }));
  return { shapes, annotations };
}

function drawFilter(place) {
  const filter = curves.filter;
  const chosen = filter.parameters[place];
  const [t, value, std] = [filter.elapsed, chosen.value, chosen.std].map(decode);
  const ends = [t[0], t[t.length - 1]];
  const edge = (sign) => value.map((x, i) => x + 2 * sign * std[i]);
  /* the first estimates know next to nothing: the axis shows the later ones */
  const settled = Array.from(value.keys()).slice(Math.floor(value.length / 4));
  const low = Math.min(chosen.batch, ...settled.map((i) => value[i] - 2 * std[i]));
  const high = Math.max(chosen.batch, ...settled.map((i) => value[i] + 2 * std[i]));
  const margin = 0.15 * (high - low) || 1e-6;
  const flat = (y, name, colourName, dash) => line(ends, [y, y], name, colourName, { line: { color: colour(colourName), width: 1.6, dash }, hovertemplate: "%{y:.4~g}<extra>%{fullData.name}</extra>" });
  const band = { type: "scatter", mode: "lines", x: t, line: { width: 0 }, hoverinfo: "skip", showlegend: false };
  draw("filter-figure", [
    { ...band, y: edge(-1) },
    { ...band, y: edge(1), fill: "tonexty", fillcolor: "rgba(0, 90, 141, 0.15)" },
    line(t, value, "filter", "corrected", { hovertemplate: "%{y:.4~g}<extra>%{fullData.name}</extra>" }),
    flat(chosen.batch, "all samples at once", "measured", "5px,3px"),
    flat(chosen.nominal, "nominal arm", "nominal", "2px,2px"),
  ], {
    ...moments(),
    xaxis: axis("time of the fitted samples [s]"),
    yaxis: axis(chosen.name, { range: [low - margin, high + margin] }),
  });
}

function drawInnovations(joint) {
  document.querySelectorAll("#innovation-tabs button").forEach((button, i) => button.setAttribute("aria-pressed", i === joint));
  const raw = curves.filter.innovations[joint];
  const { shapes } = moments();
  draw("innovation-figure", [
    line(decode(raw.t), decode(raw.value), "innovation", "corrected", { showlegend: false, line: { color: colour("corrected"), width: 1 }, hovertemplate: "%{y:.3~g}<extra></extra>" }),
  ], { shapes, xaxis: axis("time of the fitted samples [s]"), yaxis: axis("innovation [1]", { range: [-8, 8] }) });
}

function tabs(id, action) {
  curves.joints.forEach((label, joint) => {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = label;
    button.addEventListener("click", () => action(joint));
    document.getElementById(id).append(button);
  });
}

tabs("joint-tabs", (joint) => select({ joint }));
tabs("innovation-tabs", drawInnovations);
const parameter = document.getElementById("parameter");
curves.filter.parameters.forEach((entry, i) => parameter.add(new Option(entry.expression, String(i), false, i === curves.filter.first)));
parameter.addEventListener("change", () => drawFilter(Number(parameter.value)));
const list = document.getElementById("recording");
curves.groups.forEach((group, i) => list.add(new Option(group.name, String(i))));
list.addEventListener("change", () => select({ group: Number(list.value) }));
drawSpectrum();
if (curves.update.length) drawUpdate();
drawFilter(curves.filter.first);
drawInnovations(curves.worst);
select({});
