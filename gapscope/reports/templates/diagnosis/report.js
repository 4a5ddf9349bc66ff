/* Draws the figures of the report from the curves that the page carries. */
"use strict";

const curves = JSON.parse(document.getElementById("curves").textContent);
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
const font = () => ({ family: getComputedStyle(document.body).fontFamily, size: 13, color: colour("ink") });
const shown = { joint: curves.worst, recording: 0, time: null };
const drawn = new Set();
let arm = null;

/* Unit of what drives a joint, from 0. */
function force(joint) {
  return curves.slides[joint] ? "N" : "N m";
}

function decode(text) {
  return new Float32Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
}

function axis(title, more) {
  return { title: { text: title, standoff: 8 }, gridcolor: colour("grid"), zerolinecolor: colour("zero"), automargin: true, ...more };
}

function draw(element, traces, layout, buttons = ["zoom2d", "pan2d", "resetScale2d", "toImage"]) {
  const common = {
    font: font(), margin: { l: 62, r: 14, t: 34, b: 46 }, paper_bgcolor: colour("card"), plot_bgcolor: colour("card"),
    hovermode: "closest", hoverlabel: { font: font(), bgcolor: colour("ground") }, legend: { orientation: "h", x: 0, y: 1, yanchor: "bottom", xanchor: "left" },
  };
  // Named one by one: by default there is a button that sends the data to a server.
  const config = { responsive: true, displaylogo: false, plotlyServerURL: "", modeBarButtons: [buttons] };
  return Plotly.react(element, traces, { ...common, ...layout }, config);
}

function line(x, y, name, colourName, more) {
  return { type: "scatter", mode: "lines", x, y, name, line: { color: colour(colourName), width: 1.6 }, ...more };
}

function drawTorque() {
  const recording = curves.recordings[shown.recording];
  const raw = recording.joints[shown.joint];
  const [t, measured, nominal, corrected] = ["t", "measured", "nominal", "corrected"].map((key) => decode(raw[key]));
  const gap = (predicted) => measured.map((value, i) => value - predicted[i]);
  const hover = (unit) => ({ hovertemplate: "%{y:.4~g} " + unit + "<extra>%{fullData.name}</extra>" });
  const below = { yaxis: "y2", ...hover(force(shown.joint)) };
  draw("torque-figure", [
    line(t, measured, "recorded", "measured", { ...hover(force(shown.joint)), line: { color: colour("measured"), width: 2 } }),
    line(t, nominal, "nominal arm", "nominal", hover(force(shown.joint))),
    line(t, corrected, "corrected arm", "corrected", { ...hover(force(shown.joint)), line: { color: colour("corrected"), width: 1.6, dash: "5px,2px" } }),
    line(t, gap(nominal), "gap before", "nominal", { ...below, showlegend: false }),
    line(t, gap(corrected), "gap after", "corrected", { ...below, showlegend: false }),
  ], {
    hovermode: "x unified",
    xaxis: axis("time [s]", { anchor: "y2", range: [t[0], t[t.length - 1]], hoverformat: ".3f", uirevision: recording.name }),
    yaxis: axis(`torque [${force(shown.joint)}]`, { domain: [0.44, 1], uirevision: shown.joint }),
    yaxis2: axis(`gap [${force(shown.joint)}]`, { domain: [0, 0.37], anchor: "x", uirevision: shown.joint }),
    shapes: cursor(recording.name),
  });
}

/* The moment at which the arm stands, if the arm moves as this recording did. */
function cursor(name) {
  if (!arm || shown.time === null || curves.arm.motion.recording !== name) return [];
  return [{ type: "line", xref: "x", yref: "paper", x0: shown.time, x1: shown.time, y0: 0, y1: 1, line: { color: colour("measured"), width: 1 } }];
}

function drawSpectrum() {
  const element = document.getElementById("spectrum-figure");
  if (!element) return;
  const frequency = decode(curves.spectrum.frequency);
  const hover = { hovertemplate: `%{y:.3~g} ${force(shown.joint)}/√Hz<extra>%{fullData.name}</extra>` };
  draw(element, [
    line(frequency, decode(curves.spectrum.before[shown.joint]), "gap before", "nominal", hover),
    line(frequency, decode(curves.spectrum.after[shown.joint]), "gap after", "corrected", hover),
  ], {
    hovermode: "x unified",
    xaxis: axis("frequency [Hz]", { rangemode: "tozero" }),
    yaxis: axis(`amplitude [${force(shown.joint)}/√Hz]`, { type: "log", tickformat: "~g" }),
  });
}

function drawSignature(element) {
  const signature = curves.signatures[Number(element.dataset.signature)];
  const [x, gap, explained] = [signature.x, signature.gap, signature.explained].map(decode);
  const unit = signature.unit && signature.unit !== "1" ? " [" + signature.unit + "]" : "";
  const points = (y, name, colourName, size, opacity) => ({
    type: "scatter", mode: "markers", x, y, name, marker: { color: colour(colourName), size, opacity },
    hovertemplate: `%{x:.3~g}, %{y:.3~g} ${force(signature.joint)}<extra>${name}</extra>`,
  });
  const overlay = signature.line ? line(x, explained, "explained", "corrected") : points(explained, "explained", "corrected", 4, 0.9);
  draw(element, [points(gap, "gap", "nominal", 4, 0.45), overlay], {
    title: { text: "J" + (signature.joint + 1), x: 1, xanchor: "right", xref: "paper", y: 0.98, yanchor: "top", font: { size: 14 } },
    xaxis: axis(signature.axis + unit), yaxis: axis(`torque gap [${force(signature.joint)}]`),
  }, []);
}

/* Floor of a healthy arm as a dashed line, and what a rule speaks of as a shaded part. */
function marks(place, shaded) {
  const floor = {
    type: "line", xref: "paper", x0: 0, x1: 1, y0: place.floor, y1: place.floor,
    line: { color: colour("floor"), width: 1.5, dash: "dash" },
  };
  const part = shaded && {
    type: "rect", yref: "paper", y0: 0, y1: 1, x0: shaded[0], x1: shaded[1], layer: "below", line: { width: 0 },
    fillcolor: "rgba(213, 94, 0, 0.13)",
  };
  return part ? [part, floor] : [floor];
}

function drawPlace(element) {
  const place = curves.places[Number(element.dataset.place)];
  const x = decode(place.x);
  const hover = { hovertemplate: `%{x:.3~g}: %{y:.3~g} ${force(place.joint - 1)}<extra>%{fullData.name}</extra>` };
  const margin = { l: 62, r: 14, t: 30, b: 46 };
  if (place.kind === "rule") {
    const step = x.length > 1 ? x[1] - x[0] : 1;
    const ends = [x[0] - step / 2, x[x.length - 1] + step / 2];
    const shaded = [place.above === null ? ends[0] : place.above, place.below === null ? ends[1] : place.below];
    draw(element, [line(x, decode(place.rms), "RMS of the gap", "nominal", { mode: "lines+markers", ...hover })], {
      margin, shapes: marks(place, shaded), xaxis: axis(place.axis, { range: ends }),
      yaxis: axis(`RMS of the gap [${force(place.joint - 1)}]`, { rangemode: "tozero" }),
    }, []);
  } else if (place.kind === "time") {
    draw(element, [
      line(x, decode(place.rms), "RMS of the gap", "nominal", hover),
      line(x, decode(place.steps), "level", "measured", { ...hover, line: { color: colour("measured"), width: 2, shape: "hvh" } }),
    ], { margin, shapes: marks(place), xaxis: axis(place.axis), yaxis: axis(`RMS of the gap [${force(place.joint - 1)}]`, { rangemode: "tozero" }) }, []);
  } else {
    const colours = ["#0072b2", "#009e73", "#cc79a7"];
    const share = { hovertemplate: "%{x:.3~g} Hz: %{y:.2f}<extra>%{fullData.name}</extra>" };
    draw(element, [
      line(x, decode(place.gap), "gap, power over its peak", "nominal", { ...share, fill: "tozeroy", fillcolor: "rgba(213, 94, 0, 0.13)" }),
      ...place.coherence.map((row, i) => line(x, decode(row.y), "with " + row.name, "measured", { ...share, line: { color: colours[i], width: 1.6 } })),
    ], { margin: { ...margin, t: 48 }, xaxis: axis("frequency [Hz]", { range: [0, 12] }), yaxis: axis("coherence", { range: [0, 1.03] }) }, []);
  }
}

function drawGuess(element) {
  const guess = curves.guesses[Number(element.dataset.guess)];
  const hover = { hovertemplate: `%{x:.3~g}: %{y:.3~g} ${force(guess.joint)}<extra></extra>` };
  const mode = guess.amplitude ? "lines" : "lines+markers";
  draw(element, [line(decode(guess.x), decode(guess.y), "gap", "nominal", { mode, ...hover })], {
    margin: { l: 62, r: 14, t: 30, b: 46 }, xaxis: axis(guess.axis),
    yaxis: axis(`${guess.amplitude ? "amplitude of the gap" : "gap"} [${force(guess.joint)}]`, guess.amplitude ? { rangemode: "tozero" } : {}),
  }, []);
}

function select(change) {
  Object.assign(shown, change);
  const buttons = [...document.querySelectorAll("#joint-tabs button")];
  buttons.forEach((button, i) => button.setAttribute("aria-pressed", i === shown.joint));
  drawTorque();
  drawSpectrum();
}

function addSelectors() {
  const tabs = document.getElementById("joint-tabs");
  curves.joints.forEach((label, joint) => {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = label;
    button.addEventListener("click", () => select({ joint }));
    tabs.append(button);
  });
  tabs.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!step) return;
    const joint = (shown.joint + step + curves.joints.length) % curves.joints.length;
    select({ joint });
    tabs.children[joint].focus();
  });
  const list = document.getElementById("recording");
  curves.recordings.forEach((recording, i) => {
    const role = { fit: " (fitted)", judge: " (unseen)" }[recording.role] || "";
    list.add(new Option(recording.name + role, String(i)));
  });
  const unseen = curves.recordings.findIndex((recording) => recording.role === "judge");
  shown.recording = Math.max(0, unseen);
  list.value = String(shown.recording);
  list.addEventListener("change", () => select({ recording: Number(list.value) }));
}

function drawOne(element) {
  if ("place" in element.dataset) drawPlace(element);
  else if ("guess" in element.dataset) drawGuess(element);
  else drawSignature(element);
  drawn.add(element);
}

function drawSignaturesWhenSeen() {
  const pending = new Set(document.querySelectorAll(".signature"));
  const drawOnce = (element) => pending.delete(element) && drawOne(element);
  const observer = new IntersectionObserver((entries) => {
    entries.filter((entry) => entry.isIntersecting).forEach((entry) => drawOnce(entry.target));
  }, { rootMargin: "400px" });
  pending.forEach((element) => observer.observe(element));
  window.addEventListener("beforeprint", () => pending.forEach(drawOnce));
}

function redraw() {
  if (curves.recordings.length) select({});
  drawn.forEach(drawOne);
  if (arm) arm.repaint();
}

/* Figures take their colours from the page: again when it turns dark or light, and light on paper. */
function followTheme() {
  const root = document.documentElement.dataset;
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  window.addEventListener("beforeprint", () => { root.theme = "light"; redraw(); });
  window.addEventListener("afterprint", () => { delete root.theme; redraw(); });
}

function copyButtons() {
  document.querySelectorAll("button[data-copy]").forEach((button) => {
    button.addEventListener("click", async () => {
      await navigator.clipboard.writeText(button.dataset.copy);
      const said = button.textContent;
      button.textContent = "copied";
      button.classList.add("copied");
      setTimeout(() => { button.textContent = said; button.classList.remove("copied"); }, 1500);
    });
  });
}

/* The arm, its controls, and the moment that it shares with the torque over time. */
function addArm() {
  const element = document.getElementById("arm-view");
  if (!element || !curves.arm) return;
  const [play, slider, label] = ["arm-play", "arm-time", "arm-now"].map((id) => document.getElementById(id));
  let last = 0;
  const moved = (time) => {
    label.value = time.toFixed(2) + " s";
    shown.time = time;
    // a plot takes longer to draw than the arm: ten times a second will do
    if (performance.now() - last < 100) return;
    last = performance.now();
    const recording = curves.recordings[shown.recording];
    if (recording) Plotly.relayout("torque-figure", { shapes: cursor(recording.name) });
  };
  try {
    arm = ArmView(element, curves.arm, moved);
  } catch (error) {
    element.textContent = "This browser draws no 3D: " + error.message;
    return;
  }
  slider.max = String(arm.frames - 1);
  slider.addEventListener("input", () => arm.show(Number(slider.value)));
  let playing = null;
  const stop = () => { cancelAnimationFrame(playing); playing = null; play.textContent = "play"; };
  play.addEventListener("click", () => {
    if (playing !== null) return stop();
    play.textContent = "pause";
    const from = Number(slider.value) >= arm.frames - 1 ? 0 : Number(slider.value);
    const start = performance.now() - 1000 * (arm.timeAt(from) - arm.timeAt(0));
    const step = () => {
      const frame = arm.frameAt(arm.timeAt(0) + (performance.now() - start) / 1000);
      if (frame < 0) return stop();
      slider.value = String(frame);
      arm.show(frame);
      playing = requestAnimationFrame(step);
    };
    playing = requestAnimationFrame(step);
  });
  document.getElementById("arm-stage").addEventListener("change", (event) => arm.setStage(event.target.value));
  document.querySelectorAll("[data-arm]").forEach((box) => {
    box.addEventListener("change", () => arm.setVisible(box.dataset.arm, box.checked));
  });
  const figure = document.getElementById("torque-figure");
  if (figure && figure.on) {
    figure.on("plotly_click", (event) => {
      const frame = arm.frameAt(event.points[0].x);
      if (frame >= 0) { slider.value = String(frame); arm.show(frame); }
    });
  }
}

if (curves.recordings.length) {
  addSelectors();
  select({});
}
drawSignaturesWhenSeen();
followTheme();
copyButtons();
addArm();
